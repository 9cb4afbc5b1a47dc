//! One pass over all inputs.

use kalfit::{Labels, PhasedModel, Source, Test};

use crate::error::{DataError, Place, ReadError, shown};
use crate::gather::{Gather, Outcome};
use crate::input::Input;
use crate::moment::{Moment, unit_nanoseconds};
use crate::reading::{Reading, Sink};
use crate::row::Row;
use crate::spool::Spool;
use crate::table::Table;
use crate::wanted::Wanted;

/// What a pass must know, the same for every pass.
pub(crate) struct Job<'a> {
    inputs: &'a [Input],
    wanted: &'a Wanted,
    /// Id of the test of each input; none when a column tells tests apart.
    ids: Vec<String>,
    model: &'a PhasedModel,
}

/// How a pass ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ended {
    /// Everything was handed over.
    Complete,
    /// A test came back after it was complete.
    MustHold,
}

/// Times seen so far, which must be of one kind and have a unit if they are date-times.
struct Times<'a> {
    wanted: &'a Wanted,
    time_unit: Option<&'a str>,
    first: Option<(Moment, Box<Place>)>,
    /// Nanoseconds in a time unit; 1 when times are numbers.
    unit: i128,
}

impl<'a> Job<'a> {
    pub(crate) fn new(inputs: &'a [Input], wanted: &'a Wanted, ids: Vec<String>, model: &'a PhasedModel) -> Job<'a> {
        Job { inputs, wanted, ids, model }
    }
}

/// The sink hears of the bytes read once in so many rows.
const TELL_ROWS: u64 = 4096;

/// Bytes of the inputs, for whoever waits.
struct Sizes {
    /// Of each input; none of what is no file.
    each: Vec<Option<u64>>,
    all: Option<u64>,
}

impl Sizes {
    fn of(inputs: &[Input]) -> Sizes {
        let size = |input: &Input| std::fs::metadata(input.path()?).ok().filter(|found| found.is_file());
        let each: Vec<Option<u64>> = inputs.iter().map(|input| size(input).map(|found| found.len())).collect();
        let all = each.iter().copied().collect::<Option<Vec<u64>>>().map(|sizes| sizes.iter().sum());
        Sizes { each, all }
    }

    /// Bytes read, once so much of an input is.
    fn read(&self, input: usize, table: &Table<'_>) -> u64 {
        let before: u64 = self.each[..input].iter().flatten().sum();
        before + self.each[input].map_or(0, |size| table.read(size).min(size))
    }
}

/// Reads every input once.
pub(crate) fn run<S: Sink>(
    job: &Job<'_>,
    mut gather: Gather,
    reading: &mut Reading,
    sink: &mut S,
    spool: &mut Spool<'_>,
) -> Result<Ended, ReadError<S::Error>> {
    let mut row = Row::new(job.wanted.numbers, job.wanted.texts);
    let sizes = Sizes::of(job.inputs);
    let clock = &job.model.shared().clock;
    let mut times = Times { wanted: job.wanted, time_unit: clock.unit.as_deref(), first: None, unit: 1 };
    for (index, input) in job.inputs.iter().enumerate() {
        let file = input.name();
        let mut table = Table::open(input, &file, job.wanted, spool)?;
        if let Some(id) = job.ids.get(index) {
            row.set_id(id);
        }
        let before = reading.rows;
        while table.next(&mut row, &mut reading.labels)? {
            times.check(&row, &file)?;
            let source = Source { file: u32::try_from(index).expect("fewer than 2^32 files"), row: row.number };
            match gather.push(&mut row, source, times.unit) {
                Outcome::Gathered => reading.rows += 1,
                Outcome::Returned => return Ok(Ended::MustHold),
                Outcome::Before(previous) => {
                    let phase = phase(job.model, &row, &reading.labels);
                    return Err(times.decrease(&row, &file, phase, previous).into());
                }
            }
            if reading.rows.is_multiple_of(TELL_ROWS) {
                tell(sink, (sizes.read(index, &table), sizes.all), reading)?;
            }
            if let Some(batch) = gather.batch() {
                hand_over(sink, batch, reading)?;
            }
        }
        if reading.rows == before {
            return Err(DataError::NoRows { file: file.clone() }.into());
        }
    }
    reading.tests = gather.tests();
    for batch in gather.finish() {
        hand_over(sink, batch, reading)?;
    }
    Ok(Ended::Complete)
}

/// The phase of a row, by the text of its cell: that it is none of the model's is for others to say.
fn phase(model: &PhasedModel, row: &Row, labels: &Labels) -> Option<String> {
    let label = row.texts[model.column?];
    (!label.is_missing()).then(|| shown(labels.text(label).as_bytes()))
}

fn tell<S: Sink>(
    sink: &mut S,
    (done, of): (u64, Option<u64>),
    reading: &mut Reading,
) -> Result<(), ReadError<S::Error>> {
    sink.bytes(done, of).map_err(|error| ReadError::Sink { error, reading: Box::new(std::mem::take(reading)) })
}

fn hand_over<S: Sink>(sink: &mut S, batch: Vec<Test>, reading: &mut Reading) -> Result<(), ReadError<S::Error>> {
    sink.tests(batch, &reading.labels)
        .map_err(|error| ReadError::Sink { error, reading: Box::new(std::mem::take(reading)) })
}

impl Times<'_> {
    /// Refuses a time of another kind than the first, and date-times without a unit.
    fn check(&mut self, row: &Row, file: &str) -> Result<(), DataError> {
        let Some(now) = row.time else { return Ok(()) };
        match &self.first {
            Some((first, _)) if first.same_kind(now) => Ok(()),
            Some((first, place)) => Err(DataError::MixedTimes {
                at: self.place(row, file),
                found: now.kind(),
                expected: first.kind(),
                first: place.clone(),
            }),
            None => {
                let at = self.place(row, file);
                if !matches!(now, Moment::Number(_)) {
                    let Some(unit) = self.time_unit.and_then(unit_nanoseconds) else {
                        return Err(DataError::TimeUnit { at, found: self.time_unit.map(str::to_owned) });
                    };
                    self.unit = unit;
                }
                self.first = Some((now, at));
                Ok(())
            }
        }
    }

    fn decrease(&self, row: &Row, file: &str, phase: Option<String>, previous: Moment) -> DataError {
        DataError::TimeDecreases {
            at: self.place(row, file),
            test: shown(row.id.as_bytes()),
            phase: phase.map(String::into_boxed_str),
            found: row.time.map(|time| time.to_string()).unwrap_or_default().into(),
            previous: previous.to_string().into(),
        }
    }

    fn place(&self, row: &Row, file: &str) -> Box<Place> {
        self.wanted.time().expect("a row has a time only with a time column").place(file, row.number)
    }
}
