//! Rows into tests.

use std::collections::BTreeMap;
use std::ops::Range;

use hashbrown::HashTable;
use kalfit::{Label, Source, Test, TestBatch};

use crate::block::RowBlock;
use crate::moment::Moment;

/// Gathers rows by test. Streaming, a test is complete when the next one begins; holding, when all is read.
pub(crate) struct TestGatherer {
    numbers: usize,
    texts: usize,
    /// Text cell with the phase of the row.
    phase_cell: Option<usize>,
    open: OpenTests,
    /// Complete tests, to be handed over.
    complete: Option<Vec<Test>>,
    /// Bytes of the rows of tests that may still get some.
    held: u64,
    /// When the tests were, if it was asked for.
    spans: Option<TestSpans>,
}

/// Tests that may still get rows, and those handed over with them.
enum OpenTests {
    /// The last test alone, after complete ones that are not handed over yet; and hashes of the ids seen.
    Last { batch: Box<TestBatch>, times: Option<TestTimes>, seen: HashTable<u64> },
    /// All tests, in order of first appearance, and the number of that of the last row; hashes of their ids, with their numbers.
    All { tests: Vec<(Test, Option<TestTimes>)>, current: usize, seen: HashTable<(u64, usize)> },
}

/// Times of a test: the first of all, and the last of each phase, since times may start again with a phase.
struct TestTimes {
    first: Moment,
    /// Phase of the last row, and its time.
    phase: Label,
    last: Moment,
    /// Last times of the other phases seen.
    others: BTreeMap<Label, Moment>,
}

impl TestTimes {
    fn new(phase: Label, first: Moment) -> TestTimes {
        TestTimes { first, phase, last: first, others: BTreeMap::new() }
    }

    /// Takes the time of the next row; the time before it in its phase, when that is later.
    fn advance(&mut self, phase: Label, now: Moment) -> Result<(), Moment> {
        if phase != self.phase {
            self.others.insert(self.phase, self.last);
            (self.phase, self.last) = (phase, self.others.get(&phase).copied().unwrap_or(now));
        }
        if now < self.last {
            return Err(self.last);
        }
        self.last = now;
        Ok(())
    }
}

/// First and last times of tests, since the first row of all.
#[derive(Default)]
pub(crate) struct TestSpans {
    origin: Option<Moment>,
    /// Nanoseconds in the unit that date-times are read in.
    unit: i128,
    all: Vec<[f64; 2]>,
}

impl TestSpans {
    fn push(&mut self, times: Option<&TestTimes>) {
        let own = times.zip(self.origin).map(|(times, origin)| {
            let last = times.others.values().fold(times.last, |last, other| if *other > last { *other } else { last });
            [times.first, last].map(|time| time.value(origin, self.unit) - origin.value(origin, self.unit))
        });
        self.all.push(own.unwrap_or([f64::NAN; 2]));
    }
}

/// Whose turn it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TestTurn {
    /// A test that was not seen before.
    New,
    /// One that was.
    Known,
    /// One that was complete already (streaming only): everything must be read again, holding.
    Returned,
}

/// A batch is handed over when it has this many tests or cells.
const BATCH_TESTS: usize = 1024;
const BATCH_CELLS: usize = 1_000_000;

impl TestGatherer {
    pub(crate) fn new(
        holds: bool,
        (numbers, texts): (usize, usize),
        phase_cell: Option<usize>,
        spans: Option<TestSpans>,
    ) -> TestGatherer {
        let open = match holds {
            true => OpenTests::All { tests: Vec::new(), current: 0, seen: HashTable::new() },
            false => {
                OpenTests::Last { batch: Box::new(TestBatch::new(numbers, texts)), times: None, seen: HashTable::new() }
            }
        };
        TestGatherer { numbers, texts, phase_cell, open, complete: None, held: 0, spans }
    }

    /// Turns to the test of the next rows, by its id and the hash of that.
    pub(crate) fn turn(&mut self, id: &str, hash: u64) -> TestTurn {
        if self.has_test() && self.current() == id {
            return TestTurn::Known;
        }
        // while streaming, two ids with one hash are taken for one: all is read again then, and ids are compared
        let found = match &mut self.open {
            OpenTests::Last { seen, .. } => seen.find(hash, |other| *other == hash).map(|_| TestTurn::Returned),
            OpenTests::All { tests, current, seen } => {
                let same = |&(other, at): &(u64, usize)| other == hash && tests[at].0.id == id;
                seen.find(hash, same).map(|&(_, known)| {
                    *current = known;
                    TestTurn::Known
                })
            }
        };
        found.unwrap_or_else(|| {
            self.begin(id, hash);
            TestTurn::New
        })
    }

    /// Whether there is a test whose turn it is.
    fn has_test(&self) -> bool {
        match &self.open {
            OpenTests::Last { batch, .. } => !batch.is_empty(),
            OpenTests::All { tests, .. } => !tests.is_empty(),
        }
    }

    /// The texts of the first row of the test whose turn it is.
    pub(crate) fn first_texts(&self) -> Option<&[Label]> {
        match &self.open {
            OpenTests::Last { batch, .. } => batch.last_texts(),
            OpenTests::All { tests, current, .. } => {
                tests.get(*current).filter(|(test, _)| test.rows() > 0).map(|(test, _)| test.texts(0))
            }
        }
    }

    /// Id of the test whose turn it is.
    pub(crate) fn current(&self) -> &str {
        match &self.open {
            OpenTests::Last { batch, .. } => batch.last_id().unwrap_or_default(),
            OpenTests::All { tests, current, .. } => tests.get(*current).map_or("", |(test, _)| &test.id),
        }
    }

    /// Puts rows of a block into the test whose turn it is. `unit`: nanoseconds in the unit that date-times are read in.
    ///
    /// # Errors
    /// A row whose time is before this one, of the row before it in its test and phase.
    pub(crate) fn take(
        &mut self,
        block: &mut RowBlock,
        rows: Range<usize>,
        file: u32,
        unit: i128,
    ) -> Result<(), (usize, Moment)> {
        self.held += (rows.len() * (8 * self.numbers + 4 * self.texts)) as u64;
        let times = match &mut self.open {
            OpenTests::Last { times, .. } => times,
            OpenTests::All { tests, current, .. } => &mut tests[*current].1,
        };
        for row in rows.clone() {
            let Some(now) = block.time(row) else { break };
            let phase = self.phase_cell.map_or(Label::MISSING, |cell| block.texts[row * self.texts + cell]);
            let times = times.get_or_insert_with(|| TestTimes::new(phase, now));
            if let Some(spans) = &mut self.spans {
                (spans.origin, spans.unit) = (spans.origin.or(Some(now)), unit);
            }
            times.advance(phase, now).map_err(|last| (row, last))?;
            if !block.moments.is_empty() {
                block.set_time(row, now.value(times.first, unit));
            }
        }
        for (part, row) in block.numbering.parts(rows) {
            let numbers = &block.numbers[part.start * self.numbers..part.end * self.numbers];
            let texts = &block.texts[part.start * self.texts..part.end * self.texts];
            let source = Source { file, row };
            match &mut self.open {
                OpenTests::Last { batch, .. } => batch.push_rows(part.len(), numbers, texts, source),
                OpenTests::All { tests, current, .. } => {
                    tests[*current].0.push_rows(part.len(), numbers, texts, source)
                }
            }
        }
        Ok(())
    }

    fn begin(&mut self, id: &str, hash: u64) {
        match &mut self.open {
            OpenTests::Last { batch, times, seen } => {
                if let Some(spans) = self.spans.as_mut().filter(|_| !seen.is_empty()) {
                    spans.push(times.as_ref());
                }
                seen.insert_unique(hash, hash, |hash| *hash);
                (*times, self.held) = (None, 0);
                let cells = batch.rows() * (self.numbers + self.texts).max(1);
                if batch.len() >= BATCH_TESTS || cells >= BATCH_CELLS {
                    let whole = std::mem::replace(&mut **batch, TestBatch::new(self.numbers, self.texts));
                    self.complete = Some(whole.finish());
                }
                batch.begin(id);
            }
            OpenTests::All { tests, current, seen } => {
                *current = tests.len();
                seen.insert_unique(hash, (hash, *current), |(hash, _)| *hash);
                tests.push((Test::new(id, self.numbers, self.texts), None));
            }
        }
    }

    /// The complete tests, once there are enough of them to hand over.
    pub(crate) fn batch(&mut self) -> Option<Vec<Test>> {
        self.complete.take()
    }

    /// Bytes of the rows of tests that may still get some.
    pub(crate) fn held(&self) -> u64 {
        self.held
    }

    /// Number of tests seen.
    pub(crate) fn tests(&self) -> usize {
        match &self.open {
            OpenTests::Last { seen, .. } => seen.len(),
            OpenTests::All { tests, .. } => tests.len(),
        }
    }

    /// When each test was, in the order of the tests; empty unless it was asked for.
    pub(crate) fn spans(&mut self) -> Vec<[f64; 2]> {
        let Some(mut spans) = self.spans.take() else { return Vec::new() };
        match &self.open {
            OpenTests::Last { times, seen, .. } if !seen.is_empty() => spans.push(times.as_ref()),
            OpenTests::Last { .. } => {}
            OpenTests::All { tests, .. } => tests.iter().for_each(|(_, times)| spans.push(times.as_ref())),
        }
        spans.all
    }

    /// All that is left, in batches.
    pub(crate) fn finish(self) -> Vec<Vec<Test>> {
        let tests = match self.open {
            OpenTests::Last { batch, .. } if batch.is_empty() => return Vec::new(),
            OpenTests::Last { batch, .. } => return vec![batch.finish()],
            OpenTests::All { tests, .. } => tests,
        };
        let width = (self.numbers + self.texts).max(1);
        let (mut batches, mut batch, mut cells) = (Vec::new(), Vec::new(), 0);
        for (test, _) in tests {
            cells += test.rows() * width;
            batch.push(test);
            if batch.len() >= BATCH_TESTS || cells >= BATCH_CELLS {
                batches.push(std::mem::take(&mut batch));
                cells = 0;
            }
        }
        if !batch.is_empty() {
            batches.push(batch);
        }
        batches
    }
}
