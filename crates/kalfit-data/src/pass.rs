//! One pass over all inputs.

use std::hash::BuildHasher;
use std::ops::Range;

use kalfit::{Label, Labels, PhasedModel, Test, time_unit};

use crate::block::RowBlock;
use crate::cell::shown;
use crate::error::DataError;
use crate::gather::{TestGatherer, TestTurn};
use crate::input::Input;
use crate::moment::Moment;
use crate::place::CellPlace;
use crate::room::MemoryWatch;
use crate::sink::{DataReading, ReadError, TestSink};
use crate::spool::StdinSpool;
use crate::table;
use crate::table::ahead::{Demand, TableProgress, each};
use crate::wanted::WantedColumns;

/// What a pass must know, the same for every pass.
pub(crate) struct PassInput<'a> {
    inputs: &'a [Input],
    wanted: &'a WantedColumns,
    /// Id of the test of each input; none when a column tells tests apart, or each row is a test.
    ids: Vec<String>,
    /// Whether each row is a test, whose id is its number.
    by_row: bool,
    model: &'a PhasedModel,
}

/// How a pass ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PassEnd {
    /// Everything was handed over.
    Complete,
    /// A test came back after it was complete.
    MustHold,
}

/// Times seen so far, which must be of one kind and have a unit if they are date-times.
struct TimeChecker<'a> {
    wanted: &'a WantedColumns,
    time_unit: Option<&'a str>,
    first: Option<(Moment, Box<CellPlace>)>,
    /// Nanoseconds in a time unit; 1 when times are numbers.
    unit: i128,
}

impl<'a> PassInput<'a> {
    pub(crate) fn new(
        inputs: &'a [Input],
        wanted: &'a WantedColumns,
        (ids, by_row): (Vec<String>, bool),
        model: &'a PhasedModel,
    ) -> PassInput<'a> {
        PassInput { inputs, wanted, ids, by_row, model }
    }
}

/// Bytes of the inputs, for whoever waits.
struct InputSizes {
    /// Of each input; none of what is no file.
    each: Vec<Option<u64>>,
    all: Option<u64>,
}

impl InputSizes {
    fn of(inputs: &[Input]) -> InputSizes {
        let size = |input: &Input| std::fs::metadata(input.path()?).ok().filter(|found| found.is_file());
        let each: Vec<Option<u64>> = inputs.iter().map(|input| size(input).map(|found| found.len())).collect();
        let all = each.iter().copied().collect::<Option<Vec<u64>>>().map(|sizes| sizes.iter().sum());
        InputSizes { each, all }
    }

    /// Bytes read, once so much of an input is.
    fn read(&self, input: usize, done: TableProgress) -> u64 {
        let before: u64 = self.each[..input].iter().flatten().sum();
        let own = |size: u64| match done {
            TableProgress::Bytes(bytes) => bytes.min(size),
            TableProgress::Share(share) => (share * size as f64) as u64,
        };
        before + self.each[input].map_or(0, own)
    }
}

/// Reads every input once.
pub(crate) fn run<S: TestSink>(
    job: &PassInput<'_>,
    mut gather: TestGatherer,
    reading: &mut DataReading,
    sink: &mut S,
    spool: &mut StdinSpool<'_>,
) -> Result<PassEnd, ReadError<S::Error>> {
    let (sizes, mut watch) = (InputSizes::of(job.inputs), MemoryWatch::default());
    let clock = &job.model.shared().clock;
    let mut times = TimeChecker { wanted: job.wanted, time_unit: clock.unit.as_deref(), first: None, unit: 1 };
    for (index, input) in job.inputs.iter().enumerate() {
        let file = input.name();
        let mut table = table::open(input, &file, job.wanted, spool)?;
        let before = reading.rows;
        let number = u32::try_from(index).expect("fewer than 2^32 files");
        let mut taker = BlockTaker { job, file: (&file, number), gather: &mut gather, times: &mut times };
        let demand = each::<RowBlock, ReadError<S::Error>>(&mut *table, &mut |mut block, done| {
            block.relabel(&mut reading.labels);
            let demand = taker.take(&mut block, reading, sink)?;
            if let Some((taken, left)) = watch.short(reading.rows, taker.gather.held()) {
                return Err(DataError::Memory { file: file.clone(), rows: reading.rows, taken, left }.into());
            }
            tell(sink, (sizes.read(index, done), sizes.all), reading)?;
            block.end.take().map_or(Ok(demand), |error| Err(error.into()))
        })?;
        if demand == Demand::NoMore {
            return Ok(PassEnd::MustHold);
        }
        if reading.rows == before {
            return Err(DataError::NoRows { file: file.clone() }.into());
        }
    }
    reading.tests = gather.tests();
    reading.spans = gather.spans();
    for batch in gather.finish() {
        hand_over(sink, batch, reading)?;
    }
    Ok(PassEnd::Complete)
}

/// Takes in the blocks of one file.
struct BlockTaker<'t, 'a> {
    job: &'t PassInput<'a>,
    /// Its name and number.
    file: (&'t str, u32),
    gather: &'t mut TestGatherer,
    times: &'t mut TimeChecker<'a>,
}

impl BlockTaker<'_, '_> {
    fn take<S: TestSink>(
        &mut self,
        block: &mut RowBlock,
        reading: &mut DataReading,
        sink: &mut S,
    ) -> Result<Demand, ReadError<S::Error>> {
        if self.job.by_row {
            return self.take_by_row(block, reading, sink);
        }
        for run in 0..block.runs() {
            let (rows, id) = block.run(run);
            self.times.check(block, rows.start, self.file.0)?; // before anything else is said of the row
            let (id, hash) = id.unwrap_or_else(|| {
                let id = self.job.ids.get(self.file.1 as usize).map_or("", String::as_str);
                (id, self.job.wanted.hasher.hash_one(id))
            });
            match self.gather.turn(id, hash) {
                TestTurn::Returned => return Ok(Demand::NoMore),
                TestTurn::Known => {}
                // the tests before it go before what may be wrong with its rows
                TestTurn::New => self.gather.batch().map_or(Ok(()), |batch| hand_over(sink, batch, reading))?,
            }
            self.rows(block, rows, reading)?;
        }
        Ok(Demand::More)
    }

    /// Takes in a block of which each row is a test.
    fn take_by_row<S: TestSink>(
        &mut self,
        block: &mut RowBlock,
        reading: &mut DataReading,
        sink: &mut S,
    ) -> Result<Demand, ReadError<S::Error>> {
        for row in 0..block.rows {
            self.times.check(block, row, self.file.0)?;
            let id = (reading.rows + 1).to_string();
            self.gather.turn(&id, self.job.wanted.hasher.hash_one(&id));
            if let Some(batch) = self.gather.batch() {
                hand_over(sink, batch, reading)?;
            }
            self.rows(block, row..row + 1, reading)?;
        }
        Ok(Demand::More)
    }

    /// Puts rows into the test whose turn it is.
    fn rows(&mut self, block: &mut RowBlock, rows: Range<usize>, reading: &mut DataReading) -> Result<(), DataError> {
        let file = self.file.0;
        // times are checked row by row, each against the first of all and then against the one before it
        let mut sound = rows.clone();
        let mut failed = None;
        if !block.moments.is_empty() {
            for row in rows {
                if let Err(error) = self.times.check(block, row, file) {
                    (sound.end, failed) = (row, Some(error));
                    break;
                }
            }
        }
        if let Some((row, error)) = self.astray(block, sound.clone(), &reading.labels) {
            (sound.end, failed) = (row, Some(error));
        }
        reading.rows += sound.len() as u64;
        if let Err((row, previous)) = self.gather.take(block, sound, self.file.1, self.times.unit) {
            let phase = self.phase(block, row, &reading.labels);
            return Err(self.times.decrease(block, row, (file, self.gather.current()), phase, previous));
        }
        failed.map_or(Ok(()), Err)
    }

    /// The first row whose groups are not those of the first row of its test.
    fn astray(&self, block: &RowBlock, rows: Range<usize>, labels: &Labels) -> Option<(usize, DataError)> {
        let wanted = self.job.wanted;
        if wanted.groups.is_empty() || rows.is_empty() {
            return None;
        }
        let texts = |row: usize| &block.texts[row * wanted.texts..(row + 1) * wanted.texts];
        let first = self.gather.first_texts().unwrap_or_else(|| texts(rows.start));
        let differs = |cell: usize, row: usize| texts(row)[cell].is_missing() || texts(row)[cell] != first[cell];
        let bad = |row: usize| wanted.groups.iter().find(|(cell, _)| differs(*cell, row)).map(|group| (row, *group));
        let (row, (cell, column)) = rows.into_iter().find_map(bad)?;
        let at = wanted.columns[column].place(self.file.0, block.numbering.of(row));
        if texts(row)[cell].is_missing() {
            return Some((row, DataError::MissingGroup { at }));
        }
        let group = |label: Label| shown(labels.text(label).as_bytes());
        let (found, expected) = (group(texts(row)[cell]), group(first[cell]));
        let (test, joined) = (shown(self.gather.current().as_bytes()), wanted.ids.contains(&column));
        Some((row, DataError::TwoGroups { at, test, found, expected, joined }))
    }

    /// The phase of a row, by the text of its cell: that it is none of the model's is for others to say.
    fn phase(&self, block: &RowBlock, row: usize, labels: &Labels) -> Option<String> {
        let label = block.texts[row * self.job.wanted.texts + self.job.model.column?];
        (!label.is_missing()).then(|| shown(labels.text(label).as_bytes()))
    }
}

fn tell<S: TestSink>(
    sink: &mut S,
    (done, of): (u64, Option<u64>),
    reading: &mut DataReading,
) -> Result<(), ReadError<S::Error>> {
    sink.bytes(done, of).map_err(|error| ReadError::Sink { error, reading: Box::new(std::mem::take(reading)) })
}

fn hand_over<S: TestSink>(
    sink: &mut S,
    batch: Vec<Test>,
    reading: &mut DataReading,
) -> Result<(), ReadError<S::Error>> {
    sink.tests(batch, &reading.labels)
        .map_err(|error| ReadError::Sink { error, reading: Box::new(std::mem::take(reading)) })
}

impl TimeChecker<'_> {
    /// Refuses a time of another kind than the first, and date-times without a unit.
    fn check(&mut self, block: &RowBlock, row: usize, file: &str) -> Result<(), DataError> {
        let Some(now) = block.time(row) else { return Ok(()) };
        match &self.first {
            Some((first, _)) if first.same_kind(now) => Ok(()),
            Some((first, place)) => Err(DataError::MixedTimes {
                at: self.place(block, row, file),
                found: now.kind(),
                expected: first.kind(),
                first: place.clone(),
            }),
            None => {
                let at = self.place(block, row, file);
                if !now.same_kind(Moment::Number(0.0)) {
                    let Some(unit) = self.time_unit.and_then(time_unit::nanoseconds) else {
                        return Err(DataError::TimeUnit { at, found: self.time_unit.map(str::to_owned) });
                    };
                    self.unit = unit;
                }
                self.first = Some((now, at));
                Ok(())
            }
        }
    }

    fn decrease(
        &self,
        block: &RowBlock,
        row: usize,
        (file, test): (&str, &str),
        phase: Option<String>,
        previous: Moment,
    ) -> DataError {
        DataError::TimeDecreases {
            at: self.place(block, row, file),
            test: shown(test.as_bytes()),
            phase: phase.map(String::into_boxed_str),
            found: block.time(row).map(|time| time.to_string()).unwrap_or_default().into(),
            previous: previous.to_string().into(),
        }
    }

    fn place(&self, block: &RowBlock, row: usize, file: &str) -> Box<CellPlace> {
        self.wanted.time().expect("a row has a time only with a time column").place(file, block.numbering.of(row))
    }
}
