//! Rows into tests.

use std::collections::BTreeMap;
use std::hash::{BuildHasher, RandomState};
use std::ops::Range;

use hashbrown::HashTable;
use kalfit::{Label, Source, Test};

use crate::block::Block;
use crate::moment::Moment;

/// Gathers rows by test. Streaming, a test is complete when the next one begins; holding, when all is read.
pub(crate) struct Gather {
    holds: bool,
    numbers: usize,
    texts: usize,
    /// Text cell with the phase of the row.
    phase_cell: Option<usize>,
    /// Hashes of the ids seen, with the place of the test in `open` (holding).
    seen: HashTable<(u64, usize)>,
    hasher: RandomState,
    /// Tests that may still get rows, in order of first appearance: one while streaming.
    open: Vec<Open>,
    /// The test of the last row.
    current: usize,
    /// Complete tests, to be handed over.
    complete: Vec<Test>,
    /// Cells in `complete`.
    cells: usize,
    /// Bytes of the rows in `open`.
    held: u64,
}

/// A test that may still get rows.
struct Open {
    test: Test,
    /// Times of its rows so far.
    times: Option<Times>,
}

/// Times of a test: the first of all, and the last of each phase, since times may start again with a phase.
struct Times {
    first: Moment,
    /// Phase of the last row, and its time.
    phase: Label,
    last: Moment,
    /// Last times of the other phases seen.
    others: BTreeMap<Label, Moment>,
}

impl Times {
    fn new(phase: Label, first: Moment) -> Times {
        Times { first, phase, last: first, others: BTreeMap::new() }
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

/// Whose turn it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Turn {
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

impl Gather {
    pub(crate) fn new(holds: bool, (numbers, texts): (usize, usize), phase_cell: Option<usize>) -> Gather {
        Gather {
            holds,
            numbers,
            texts,
            phase_cell,
            seen: HashTable::new(),
            hasher: RandomState::new(),
            open: Vec::new(),
            current: 0,
            complete: Vec::new(),
            cells: 0,
            held: 0,
        }
    }

    /// Turns to the test of the next rows.
    pub(crate) fn turn(&mut self, id: &str) -> Turn {
        if self.open.get(self.current).is_some_and(|open| open.test.id == id) {
            return Turn::Known;
        }
        let hash = self.hasher.hash_one(id);
        // while streaming, two ids with one hash are taken for one: all is read again then, and ids are compared
        let same = |&(other, at): &(u64, usize)| other == hash && (!self.holds || self.open[at].test.id == id);
        match self.seen.find(hash, same) {
            Some(_) if !self.holds => Turn::Returned,
            Some(&(_, known)) => {
                self.current = known;
                Turn::Known
            }
            None => {
                self.begin(id, hash);
                Turn::New
            }
        }
    }

    /// The texts of the first row of the test whose turn it is.
    pub(crate) fn first_texts(&self) -> Option<&[Label]> {
        self.open.get(self.current).filter(|open| open.test.rows() > 0).map(|open| open.test.texts(0))
    }

    /// Id of the test whose turn it is.
    pub(crate) fn current(&self) -> &str {
        self.open.get(self.current).map_or("", |open| &open.test.id)
    }

    /// Puts rows of a block into the test whose turn it is. `unit`: nanoseconds in the unit that date-times are read in.
    ///
    /// # Errors
    /// A row whose time is before this one, of the row before it in its test and phase.
    pub(crate) fn take(
        &mut self,
        block: &mut Block,
        rows: Range<usize>,
        file: u32,
        unit: i128,
    ) -> Result<(), (usize, Moment)> {
        self.held += (rows.len() * (8 * self.numbers + 4 * self.texts)) as u64;
        let Open { test, times } = &mut self.open[self.current];
        for row in rows.clone() {
            let Some(now) = block.time(row) else { break };
            let phase = self.phase_cell.map_or(Label::MISSING, |cell| block.texts[row * self.texts + cell]);
            let times = times.get_or_insert_with(|| Times::new(phase, now));
            times.advance(phase, now).map_err(|last| (row, last))?;
            if !block.moments.is_empty() {
                block.set_time(row, now.value(times.first, unit));
            }
        }
        for (part, row) in block.numbering.parts(rows) {
            let numbers = &block.numbers[part.start * self.numbers..part.end * self.numbers];
            let texts = &block.texts[part.start * self.texts..part.end * self.texts];
            test.push_rows(part.len(), numbers, texts, Source { file, row });
        }
        Ok(())
    }

    fn begin(&mut self, id: &str, hash: u64) {
        if !self.holds {
            self.close();
        }
        self.current = self.open.len();
        self.seen.insert_unique(hash, (hash, self.current), |(hash, _)| *hash);
        self.open.push(Open { test: Test::new(id, self.numbers, self.texts), times: None });
    }

    fn close(&mut self) {
        self.held = 0;
        for open in self.open.drain(..) {
            self.cells += open.test.rows() * (self.numbers + self.texts).max(1);
            self.complete.push(open.test);
        }
    }

    /// The complete tests, once there are enough of them to hand over.
    pub(crate) fn batch(&mut self) -> Option<Vec<Test>> {
        if self.complete.len() < BATCH_TESTS && self.cells < BATCH_CELLS {
            return None;
        }
        self.cells = 0;
        Some(std::mem::take(&mut self.complete))
    }

    /// Bytes of the rows of tests that may still get some.
    pub(crate) fn held(&self) -> u64 {
        self.held
    }

    /// Number of tests seen.
    pub(crate) fn tests(&self) -> usize {
        self.seen.len()
    }

    /// All that is left, in batches.
    pub(crate) fn finish(mut self) -> Vec<Vec<Test>> {
        self.close();
        let width = (self.numbers + self.texts).max(1);
        let (mut batches, mut batch, mut cells) = (Vec::new(), Vec::new(), 0);
        for test in self.complete {
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
