//! Posteriors of all tests and phases, in columns.

use serde::{Serialize, Serializer};

use crate::{OwnRecord, PosteriorRecord, SquareRecord};
use kalfit_model::SparseColumn;

/// Posteriors of each phase of each test, in the order of the tests.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct PosteriorColumns {
    /// Names of phases, each once.
    names: Vec<String>,
    parts: Vec<PosteriorPart>,
    /// End of each test's range in `parts`.
    ends: Vec<usize>,
    /// Mean, then covariance by rows, of each part.
    numbers: Vec<f64>,
    /// Estimates from tests alone, by index of the part.
    own: SparseColumn<OwnRecord>,
}

/// Sizes of the posterior of one phase of one test, and index of the first stored value.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PosteriorPart {
    name: u32,
    /// Length of the mean, and number of rows of the covariance.
    mean: u32,
    size: u32,
    /// Index in `numbers` of the first value.
    start: usize,
}

/// Posteriors of one test, phase by phase.
#[derive(Clone, Copy)]
pub struct PosteriorRecords<'a> {
    of: &'a PosteriorColumns,
    start: usize,
    end: usize,
}

impl PosteriorColumns {
    /// An empty list with room for `tests` tests; `states`: number of states of each phase.
    pub(super) fn with_room(tests: usize, states: impl Iterator<Item = usize>) -> PosteriorColumns {
        let (phases, numbers) = states.fold((0, 0), |(phases, all), p| (phases + 1, all + p + p * p));
        PosteriorColumns {
            parts: Vec::with_capacity(tests * phases),
            ends: Vec::with_capacity(tests),
            numbers: Vec::with_capacity(tests * numbers),
            ..PosteriorColumns::default()
        }
    }

    /// Adds a test, of which [`PosteriorColumns::push`] then adds phases.
    pub(super) fn begin(&mut self) {
        self.ends.push(self.parts.len());
    }

    /// Adds a phase of the last test; `covariance` is by rows.
    pub(super) fn push(&mut self, name: &str, (mean, covariance): (&[f64], &[f64]), own: Option<OwnRecord>) {
        let known = self.names.iter().position(|other| other == name);
        let name = known.unwrap_or_else(|| {
            self.names.push(name.to_owned());
            self.names.len() - 1
        });
        let [name, mean_size, size] = [name, mean.len(), covariance.len().isqrt()].map(|n| n as u32);
        self.own.set(self.parts.len(), own);
        self.parts.push(PosteriorPart { name, mean: mean_size, size, start: self.numbers.len() });
        self.numbers.extend_from_slice(mean);
        self.numbers.extend_from_slice(covariance);
        if let Some(end) = self.ends.last_mut() {
            *end = self.parts.len();
        }
    }

    /// Posteriors of the test with index `test`.
    pub(super) fn get(&self, test: usize) -> PosteriorRecords<'_> {
        let start = test.checked_sub(1).map_or(0, |before| self.ends[before]);
        PosteriorRecords { of: self, start, end: self.ends[test] }
    }

    fn part(&self, number: usize) -> PosteriorRecord<'_> {
        let PosteriorPart { name, mean, size, start } = self.parts[number];
        let (size, numbers) = (size as usize, &self.numbers[start..]);
        let (mean, numbers) = numbers.split_at(mean as usize);
        PosteriorRecord {
            name: &self.names[name as usize],
            mean,
            covariance: SquareRecord::view(&numbers[..size * size], size),
            own: self.own.get(number),
        }
    }
}

impl<'a> PosteriorRecords<'a> {
    /// Number of phases of the test.
    pub fn len(&self) -> usize {
        self.end - self.start
    }

    /// Whether the test has no phases.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The phase with index `phase`. Panics when the test has no such phase.
    pub fn get(&self, phase: usize) -> PosteriorRecord<'a> {
        assert!(phase < self.len(), "phase {phase} of {}", self.len());
        self.of.part(self.start + phase)
    }

    /// Iterates over the phases.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = PosteriorRecord<'a>> + use<'a> {
        let own = *self;
        (0..own.len()).map(move |phase| own.get(phase))
    }
}

impl std::fmt::Debug for PosteriorRecords<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

impl PartialEq for PosteriorRecords<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.iter().eq(other.iter())
    }
}

impl Serialize for PosteriorRecords<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter())
    }
}
