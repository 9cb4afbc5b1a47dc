//! Results of each test, in columns: the list `tests` of fit.json.

use std::collections::HashMap;
use std::ops::Range;

use serde::de::{SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::posteriors::PosteriorColumns;
use crate::test::TestFigures;
use crate::{DeletionRecord, FitRecord, InnovationRecord, SeriesKeeper, TestRecord, TestRow};
use kalfit_model::{SparseColumn, TestId, Texts};

/// Results of each test. Results of one kind are stored together for all tests, so that the results of a million tests
/// are in a few pieces of memory; a row is a [`TestRecord`], and a row that owns its data a [`TestRow`].
///
/// ```
/// # mod kalfit { pub mod record { pub use kalfit_record::*; } }
/// use kalfit::record::{TestRecords, TestRow};
///
/// # fn read(json: &str) -> serde_json::Result<()> {
/// let tests: TestRecords = serde_json::from_str(json)?;
/// for test in tests.iter() {
///     println!("{}: {:?}", test.id, test.p_value);
/// }
/// let mut rows: Vec<TestRow> = tests.iter().map(TestRow::from).collect();
/// rows.retain(|test| test.observations > 2);
/// let fewer: TestRecords = rows.into_iter().collect();
/// # assert_eq!((tests.len(), fewer.len()), (1, 0));
/// # Ok(())
/// # }
/// # read(r#"[{"id": "a", "log_likelihood": -1.0, "observations": 1, "phases": [], "distance": null, "degrees_of_freedom": 0, "p_value": null}]"#).unwrap();
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TestRecords {
    ids: Texts,
    figures: Vec<TestFigures>,
    pub(super) phases: PosteriorColumns,
    pub(super) group: SparseColumn<String>,
    pub(super) groups: SparseColumn<Vec<String>>,
    deletions: SparseColumn<Box<DeletionRecord>>,
    innovations: InnovationRecords,
}

/// Innovations of tests, by index of the test.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct InnovationRecords(SparseColumn<InnovationRecord>);

impl TestRecords {
    /// Number of tests.
    pub fn len(&self) -> usize {
        self.figures.len()
    }

    /// Whether there are no tests.
    pub fn is_empty(&self) -> bool {
        self.figures.is_empty()
    }

    /// The test with index `number`. Panics when there is no such test.
    pub fn get(&self, number: usize) -> TestRecord<'_> {
        TestRecord::with(
            self.figures[number],
            self.ids.get(number),
            self.group.get(number),
            self.groups.get(number).map_or(&[], Vec::as_slice),
            self.phases.get(number),
            self.deletions.get(number).map(Box::as_ref),
            self.innovations.0.get(number),
        )
    }

    /// Iterates over all tests.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = TestRecord<'_>> + DoubleEndedIterator + Clone {
        self.part(0..self.len())
    }

    /// Iterates over the tests with the indices `numbers`. Panics when there is no such test.
    pub fn part(
        &self,
        numbers: Range<usize>,
    ) -> impl ExactSizeIterator<Item = TestRecord<'_>> + DoubleEndedIterator + Clone {
        numbers.map(|number| self.get(number))
    }

    /// Index of each test, by id; of several tests with one id, the index of the last.
    pub fn by_id(&self) -> HashMap<&str, usize> {
        (0..self.len()).map(|number| (self.ids.get(number), number)).collect()
    }

    /// An empty list with room for `tests` tests; `states`: number of states of each phase.
    pub(super) fn with_room(tests: usize, states: impl Iterator<Item = usize>) -> TestRecords {
        TestRecords {
            figures: Vec::with_capacity(tests),
            phases: PosteriorColumns::with_room(tests, states),
            ..TestRecords::default()
        }
    }

    /// Adds a test without phases.
    pub(super) fn push(&mut self, id: &str, figures: TestFigures, deletion: Option<DeletionRecord>) {
        self.deletions.set(self.len(), deletion.map(Box::new));
        self.ids.push(id);
        self.figures.push(figures);
        self.phases.begin();
    }

    fn push_row(&mut self, row: TestRow) {
        let number = self.len();
        self.push(&row.id, row.figures(), row.deletion);
        for part in row.phases {
            self.phases.push(&part.name, (&part.mean, part.covariance.entries()), part.own);
        }
        self.group.set(number, row.group);
        self.groups.set(number, Some(row.groups).filter(|groups| !groups.is_empty()));
        self.innovations.0.set(number, row.innovations);
    }
}

impl InnovationRecords {
    /// An empty list with room for `tests` tests.
    pub fn with_room(tests: usize) -> InnovationRecords {
        InnovationRecords(SparseColumn::with_room(tests))
    }

    /// Innovations of the test with index `number`; `None` without innovations.
    pub fn get(&self, number: usize) -> Option<&InnovationRecord> {
        self.0.get(number)
    }

    /// Sets the innovations of the test with index `number`.
    pub fn put(&mut self, number: usize, innovations: InnovationRecord) {
        self.0.set(number, Some(innovations));
    }
}

impl FitRecord {
    /// Sets the innovations of all tests; a test without innovations in `found` then has no innovations.
    pub fn set_innovations(&mut self, found: InnovationRecords) {
        self.tests.innovations = found;
    }

    /// Sets the square sums of tests' innovations under the law of the whole model, given with ids and numbers of
    /// innovations; a test with another number of innovations gets none.
    pub(super) fn set_whitened(&mut self, whitened: &[(TestId, usize, f64)]) {
        let numbers: Vec<Option<usize>> = {
            let by_id = self.tests.by_id();
            whitened.iter().map(|(id, ..)| by_id.get(&**id).copied()).collect()
        };
        for ((_, count, nis), number) in whitened.iter().zip(numbers) {
            let own = number.and_then(|number| self.tests.innovations.0.get_mut(number));
            if let Some(own) = own.filter(|own| own.count == *count) {
                own.whitened_nis = Some(*nis).filter(|nis| nis.is_finite());
            }
        }
    }

    /// Adds the retained series to the tests that have innovations.
    pub fn add_series(&mut self, keeper: SeriesKeeper) {
        let mut retained_series = keeper.into_series();
        for number in 0..self.tests.len() {
            if let Some(innovations) = self.tests.innovations.0.get_mut(number) {
                innovations.series = retained_series.remove(self.tests.ids.get(number)).map(Box::new);
            }
        }
    }
}

impl FromIterator<TestRow> for TestRecords {
    fn from_iter<I: IntoIterator<Item = TestRow>>(rows: I) -> TestRecords {
        let mut all = TestRecords::default();
        rows.into_iter().for_each(|row| all.push_row(row));
        all
    }
}

impl Serialize for TestRecords {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter())
    }
}

impl<'de> Deserialize<'de> for TestRecords {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<TestRecords, D::Error> {
        deserializer.deserialize_seq(TestList)
    }
}

/// Visitor that collects tests as they are read.
struct TestList;

impl<'de> Visitor<'de> for TestList {
    type Value = TestRecords;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a sequence")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut rows: A) -> Result<TestRecords, A::Error> {
        let mut all = TestRecords::default();
        while let Some(row) = rows.next_element()? {
            all.push_row(row);
        }
        Ok(all)
    }
}
