//! Rows of a table, decoded, on their way into tests.

use std::hash::{BuildHasher, RandomState};
use std::ops::Range;

use hashbrown::HashTable;
use kalfit::{Label, Labels};

use crate::error::DataError;
use crate::moment::Moment;
use crate::numbering::RowNumbering;

/// Rows that stand one after the other in a table: the cells that the model and the layout name. Blocks are made by many
/// threads and taken in by one, in the order of the table.
#[derive(Debug, Default)]
pub(crate) struct RowBlock {
    /// Number of rows.
    pub(crate) rows: usize,
    /// Numeric cells, row after row, NaN where missing; date-times are filled in when the first row of their test is known.
    pub(crate) numbers: Vec<f64>,
    /// Text cells, row after row: labels of `labels`, and of the whole reading after [`RowBlock::relabel`].
    pub(crate) texts: Vec<Label>,
    /// Texts, in order of first appearance.
    pub(crate) labels: Labels,
    /// Number of numeric cells of a row, and those of them that are its time.
    pub(crate) width: usize,
    pub(crate) clock: Vec<usize>,
    /// Times, where some are date-times.
    pub(crate) moments: Vec<Moment>,
    pub(crate) ids: TestIds,
    /// Numbers of the rows in the file.
    pub(crate) numbering: RowNumbering,
    /// What is wrong with the row after the last one.
    pub(crate) end: Option<DataError>,
}

/// Ids of tests, in runs of rows of one test that follow each other. Each id stands there once, however often it comes.
#[derive(Debug, Default)]
pub(crate) struct TestIds {
    texts: String,
    /// Hashes and places of all ids.
    known: HashTable<HashedId>,
    /// The first row of each run, and its id.
    runs: Vec<(usize, HashedId)>,
}

/// An id: its hash, and where it stands among the texts.
#[derive(Debug, Clone, Copy)]
struct HashedId {
    hash: u64,
    start: usize,
    end: usize,
}

impl TestIds {
    /// Says the id of a row after those before, and of the rows that follow; `hasher` is the same for all blocks.
    pub(crate) fn push(&mut self, row: usize, id: &str, hasher: &RandomState) {
        let TestIds { texts, known, runs } = self;
        if runs.last().is_some_and(|(_, last)| texts[last.start..last.end] == *id) {
            return;
        }
        let hash = hasher.hash_one(id);
        let same = |other: &HashedId| other.hash == hash && texts[other.start..other.end] == *id;
        let place = match known.find(hash, same) {
            Some(place) => *place,
            None => {
                let place = HashedId { hash, start: texts.len(), end: texts.len() + id.len() };
                texts.push_str(id);
                *known.insert_unique(hash, place, |id| id.hash).get()
            }
        };
        runs.push((row, place));
    }

    /// Leaves the rows before this one.
    pub(crate) fn truncate(&mut self, row: usize) {
        self.runs.truncate(self.runs.partition_point(|(first, _)| *first < row));
    }
}

impl RowBlock {
    /// A block of no rows that ends with an error.
    pub(crate) fn failed(error: DataError) -> RowBlock {
        RowBlock { end: Some(error), ..RowBlock::default() }
    }

    /// Turns the labels of the block into those of the whole reading.
    pub(crate) fn relabel(&mut self, labels: &mut Labels) {
        let known: Vec<Label> = self.labels.texts().iter().map(|text| labels.intern(text)).collect();
        let of = |label: Label| if label.is_missing() { label } else { known[label.index()] };
        self.texts.iter_mut().for_each(|label| *label = of(*label));
    }

    /// The time of a row.
    pub(crate) fn time(&self, row: usize) -> Option<Moment> {
        let cell = self.clock.first()?;
        let number = || Moment::Number(self.numbers[row * self.width + cell]);
        Some(self.moments.get(row).copied().unwrap_or_else(number))
    }

    /// Sets the cells with the time of a row.
    pub(crate) fn set_time(&mut self, row: usize, value: f64) {
        self.clock.iter().for_each(|cell| self.numbers[row * self.width + cell] = value);
    }

    /// Says the time of a row after those before.
    #[inline]
    pub(crate) fn push_time(&mut self, row: usize, time: Moment) {
        match time {
            Moment::Number(value) if self.moments.is_empty() => self.set_time(row, value),
            _ => {
                let numbers: Vec<Moment> = (self.moments.len()..row).filter_map(|row| self.time(row)).collect();
                self.moments.extend(numbers.into_iter().chain([time]));
            }
        }
    }

    /// Number of runs of rows of one test.
    pub(crate) fn runs(&self) -> usize {
        if self.ids.runs.is_empty() { usize::from(self.rows > 0) } else { self.ids.runs.len() }
    }

    /// A run of rows of one test, and its id with its hash; `None` where no column holds ids.
    pub(crate) fn run(&self, run: usize) -> (Range<usize>, Option<(&str, u64)>) {
        let Some(&(first, id)) = self.ids.runs.get(run) else { return (0..self.rows, None) };
        let next = self.ids.runs.get(run + 1).map_or(self.rows, |(next, _)| *next);
        (first..next, Some((&self.ids.texts[id.start..id.end], id.hash)))
    }
}
