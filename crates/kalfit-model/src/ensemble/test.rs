//! One test: rows in time order.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use crate::ensemble::records::RowStore;
use crate::ensemble::{Label, TestId};

/// File and line of a row, for messages only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Source {
    /// Index of the file.
    pub file: u32,
    /// Number of the row in the file, as a person counts (the header of a CSV file is line 1).
    pub row: u64,
}

/// The rows of one test with the columns that a model reads. A missing number is NaN, a missing text is
/// [`Label::MISSING`].
///
/// Tests that were read together share one memory of cells ([`TestBatch`](crate::TestBatch)): a copy of a test, or of
/// some rows of a test, copies no cell. A change to a test first makes a separate copy of the cells of the test, unless
/// no other test uses the memory.
#[derive(Clone)]
pub struct Test {
    /// Id of the test.
    pub id: TestId,
    records: Arc<RowStore>,
    /// First row of the test in `records`.
    first: usize,
    rows: usize,
}

impl Test {
    /// An empty test whose rows have `columns` numeric cells and `text_columns` text cells.
    pub fn new(id: impl Into<TestId>, columns: usize, text_columns: usize) -> Test {
        Test { id: id.into(), records: Arc::new(RowStore::new(columns, text_columns)), first: 0, rows: 0 }
    }

    /// The test with rows `rows` of `records`.
    pub(super) fn part(id: TestId, records: &Arc<RowStore>, rows: Range<usize>) -> Test {
        Test { id, records: records.clone(), first: rows.start, rows: rows.len() }
    }

    /// Appends a row. Panics if the number of cells does not fit the columns of the test.
    pub fn push(&mut self, numbers: &[f64], texts: &[Label], source: Source) {
        self.push_rows(1, numbers, texts, source);
    }

    /// Appends `rows` rows; row k = 0, 1, … of the new rows has source (`source.file`, `source.row` + k). Cells are row
    /// by row. Panics if the number of cells does not fit `rows` rows of the test.
    pub fn push_rows(&mut self, rows: usize, numbers: &[f64], texts: &[Label], source: Source) {
        self.unshared_records().push(rows, numbers, texts, source);
        self.rows += rows;
    }

    /// Appends the rows `rows` of another test. Panics if the other test lacks some of the rows, or has other numbers
    /// of cells in a row.
    pub(crate) fn push_from(&mut self, other: &Test, rows: Range<usize>) {
        assert!(rows.end <= other.rows, "rows {rows:?} of {}", other.rows);
        if self.rows == 0 {
            (self.records, self.first, self.rows) = (other.records.clone(), other.first + rows.start, rows.len());
            return;
        }
        let (unshared_records, other_first) = (self.unshared_records(), other.first);
        unshared_records.push_from(&other.records, other_first + rows.start..other_first + rows.end);
        self.rows += rows.len();
    }

    /// The test with the first `rows` rows only; with all rows if there are fewer.
    pub fn first(&self, rows: usize) -> Test {
        Test { rows: rows.min(self.rows), ..self.clone() }
    }

    /// The test with `more` further numeric columns, which `write` writes for each row from the cells of the row.
    #[must_use]
    pub fn widened(&self, more: usize, write: impl FnMut(&[f64], &mut [f64])) -> Test {
        let records = Arc::new(self.records.widened(self.first..self.first + self.rows, more, write));
        Test { id: self.id.clone(), records, first: 0, rows: self.rows }
    }

    /// The records of this test for writing, copied first if another test shares the records or if the records contain
    /// rows of another test.
    fn unshared_records(&mut self) -> &mut RowStore {
        let (first, rows) = (self.first, self.rows);
        let is_unshared = Arc::get_mut(&mut self.records).is_some_and(|records| first == 0 && records.rows() == rows);
        if !is_unshared {
            let (columns, text_columns) = self.records.widths();
            let mut unshared_records = RowStore::new(columns, text_columns);
            unshared_records.push_from(&self.records, first..first + rows);
            (self.records, self.first) = (Arc::new(unshared_records), 0);
        }
        Arc::get_mut(&mut self.records).expect("nobody else has them")
    }

    /// (number of numeric cells, number of text cells) of a row.
    pub fn widths(&self) -> (usize, usize) {
        self.records.widths()
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Numeric cells of a row.
    #[inline]
    pub fn numbers(&self, row: usize) -> &[f64] {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        self.records.numbers(self.first + row..self.first + row + 1)
    }

    /// Numeric cells of all rows.
    pub fn all_numbers(&self) -> &[f64] {
        self.records.numbers(self.first..self.first + self.rows)
    }

    /// Sets a numeric cell. Panics if there is no such cell.
    pub fn set_number(&mut self, row: usize, column: usize, value: f64) {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        self.unshared_records().set_number(row, column, value);
    }

    /// Text cells of a row.
    #[inline]
    pub fn texts(&self, row: usize) -> &[Label] {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        self.records.texts(self.first + row..self.first + row + 1)
    }

    /// Text cells of all rows.
    fn all_texts(&self) -> &[Label] {
        self.records.texts(self.first..self.first + self.rows)
    }

    /// File and line of a row.
    pub fn source(&self, row: usize) -> Source {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        self.records.source(self.first + row)
    }
}

/// Shows only the cells of this test, not all cells of the shared memory.
impl fmt::Debug for Test {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sources: Vec<Source> = (0..self.rows).map(|row| self.source(row)).collect();
        f.debug_struct("Test")
            .field("id", &self.id)
            .field("widths", &self.widths())
            .field("numbers", &self.all_numbers())
            .field("texts", &self.all_texts())
            .field("sources", &sources)
            .finish()
    }
}

impl PartialEq for Test {
    fn eq(&self, other: &Test) -> bool {
        self.id == other.id
            && (self.widths(), self.rows) == (other.widths(), other.rows)
            && self.all_numbers() == other.all_numbers()
            && self.all_texts() == other.all_texts()
            && (0..self.rows).all(|row| self.source(row) == other.source(row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_remembers_where_it_came_from() {
        let sources = [(0, 2), (0, 3), (0, 4), (0, 7), (1, 8), (1, 9), (1, 9), (1, u64::MAX), (1, 0), (0, 1)];
        let mut test = Test::new("t", 0, 0);
        sources.iter().for_each(|&(file, row)| test.push(&[], &[], Source { file, row }));
        for (k, &(file, row)) in sources.iter().enumerate() {
            assert_eq!(test.source(k), Source { file, row }, "row {k}");
        }
        assert_eq!(test.rows(), 10);
    }

    #[test]
    fn rows_appended_together_are_the_rows_one_by_one() {
        let runs = [(0, 2, 3), (0, 5, 2), (1, 7, 1), (1, 8, 0), (1, 8, 4), (0, 1, 1)];
        let (mut one_by_one, mut together) = (Test::new("t", 2, 1), Test::new("t", 2, 1));
        for (file, first, rows) in runs {
            let source = |k: u64| Source { file, row: first + k };
            let numbers: Vec<f64> = (0..2 * rows).map(|k| (first * 10 + k) as f64).collect();
            let texts: Vec<Label> = (0..rows).map(|k| Label::literal((first + k) as usize)).collect();
            together.push_rows(rows as usize, &numbers, &texts, source(0));
            let rows = numbers.chunks(2).zip(texts.chunks(1)).zip(0..);
            rows.for_each(|((numbers, texts), k)| one_by_one.push(numbers, texts, source(k)));
        }
        assert_eq!(together, one_by_one);
        let wide = together.widened(1, |own, more| more[0] = own[1]);
        let mut wide_by_row = Test::new("t", 3, 1);
        for row in 0..together.rows() {
            let &[first, second] = together.numbers(row) else { panic!("two cells") };
            wide_by_row.push(&[first, second, second], together.texts(row), together.source(row));
        }
        assert_eq!(wide, wide_by_row);
        for rows in [0..10, 2..7, 4..5, 9..10, 3..3] {
            let (mut parts, mut whole) = (Test::new("t", 2, 1), Test::new("t", 2, 1));
            rows.clone().for_each(|row| parts.push(together.numbers(row), together.texts(row), together.source(row)));
            whole.push_from(&together, rows.clone());
            assert_eq!(whole, parts, "rows {rows:?}");
        }
    }
}
