//! Tests that are read together.

use std::sync::Arc;

use crate::ensemble::records::RowStore;
use crate::ensemble::{Label, Source, Test, TestId};

/// Tests that are read from a table, one after the other. The ids and cells of all tests are stored in a few pieces of
/// memory.
///
/// ```
/// # use kalfit_model as kalfit;
/// use kalfit::{Source, TestBatch};
/// let mut batch = TestBatch::new(1, 0);
/// for (id, row) in [("a", 2), ("b", 3)] {
///     batch.begin(id);
///     batch.push_rows(1, &[0.5], &[], Source { file: 0, row });
/// }
/// let tests = batch.finish();
/// assert_eq!((&*tests[1].id, tests[1].numbers(0), tests[1].source(0).row), ("b", &[0.5][..], 3));
/// ```
#[derive(Debug, Clone, Default)]
pub struct TestBatch {
    ids: String,
    records: RowStore,
    /// (start of the id in `ids`, first row in `records`) of each test.
    starts: Vec<(usize, usize)>,
}

impl TestBatch {
    /// An empty batch for tests whose rows have `columns` numeric cells and `text_columns` text cells.
    pub fn new(columns: usize, text_columns: usize) -> TestBatch {
        TestBatch { records: RowStore::new(columns, text_columns), ..TestBatch::default() }
    }

    /// Begins another test.
    pub fn begin(&mut self, id: &str) {
        self.starts.push((self.ids.len(), self.records.rows()));
        self.ids.push_str(id);
    }

    /// Appends `rows` rows to the test that was begun last; row k = 0, 1, … of the new rows has source (`source.file`,
    /// `source.row` + k). Cells are row by row.
    ///
    /// # Panics
    /// If the number of cells does not fit `rows` rows, or if no test was begun.
    pub fn push_rows(&mut self, rows: usize, numbers: &[f64], texts: &[Label], source: Source) {
        assert!(!self.starts.is_empty(), "rows of no test");
        self.records.push(rows, numbers, texts, source);
    }

    /// Number of tests.
    pub fn len(&self) -> usize {
        self.starts.len()
    }

    /// Whether no test was begun.
    pub fn is_empty(&self) -> bool {
        self.starts.is_empty()
    }

    /// Number of rows of all tests.
    pub fn rows(&self) -> usize {
        self.records.rows()
    }

    /// Id of the test that was begun last.
    pub fn last_id(&self) -> Option<&str> {
        self.starts.last().map(|&(id, _)| &self.ids[id..])
    }

    /// Text cells of the first row of the test that was begun last; `None` if this test has no rows.
    pub fn last_texts(&self) -> Option<&[Label]> {
        let &(_, first) = self.starts.last()?;
        (first < self.rows()).then(|| self.records.texts(first..first + 1))
    }

    /// The tests of the batch.
    pub fn finish(mut self) -> Vec<Test> {
        self.records.shrink();
        let (all_ids, rows) = (Arc::new(self.ids.into_boxed_str()), self.records.rows());
        let records = Arc::new(self.records);
        let ends = self.starts.iter().skip(1).copied().chain([(all_ids.len(), rows)]);
        let test = |(&(id, row), (id_end, end)): (&(usize, usize), (usize, usize))| {
            Test::part(TestId::part(&all_ids, id..id_end), &records, row..end)
        };
        self.starts.iter().zip(ends).map(test).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tests_of_a_batch_are_those_that_stand_by_themselves_and_are_changed_apart() {
        let (mut batch, mut alone) = (TestBatch::new(2, 1), Vec::new());
        let sources = [(0, 2), (0, 5), (1, 1), (0, 6), (0, 9)];
        for (k, rows) in [3, 0, 2, 4, 1].into_iter().enumerate() {
            let (file, row) = sources[k];
            let (id, source) = (format!("test {k}"), Source { file, row });
            let numbers: Vec<f64> = (0..2 * rows).map(|cell| (10 * k + cell) as f64).collect();
            let texts: Vec<Label> = (0..rows).map(|row| Label::literal(k + row)).collect();
            let mut test = Test::new(id.as_str(), 2, 1);
            test.push_rows(rows, &numbers, &texts, source);
            batch.begin(&id);
            batch.push_rows(rows, &numbers, &texts, source);
            assert_eq!((batch.last_id(), batch.last_texts()), (Some(id.as_str()), texts.chunks(1).next()));
            alone.push(test);
        }
        assert_eq!((batch.len(), batch.rows()), (5, 10));
        let mut tests = batch.finish();
        assert_eq!(tests, alone);
        for test in [&mut tests[2], &mut alone[2]] {
            test.set_number(1, 0, 77.0);
            test.push(&[5.0, 6.0], &[Label::MISSING], Source { file: 0, row: 6 });
        }
        assert_eq!(tests, alone, "the others are what they were");
        assert_eq!((tests[2].rows(), tests[2].numbers(1)[0], tests[3].numbers(0)[0]), (3, 77.0, 30.0));
    }
}
