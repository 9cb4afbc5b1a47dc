//! Rows of cells, one after the other, of one test or of many tests.

use std::ops::Range;

use crate::ensemble::{Label, Source};

/// Rows of cells, with the source of each row.
#[derive(Debug, Clone, Default)]
pub(super) struct RowStore {
    columns: usize,
    text_columns: usize,
    numbers: Vec<f64>,
    texts: Vec<Label>,
    rows: usize,
    /// (first row, source of the first row) of each run of rows that follow each other in a file; a run may extend over
    /// several tests.
    sources: Vec<(usize, Source)>,
}

impl RowStore {
    /// An empty store for rows with `columns` numeric cells and `text_columns` text cells.
    pub(super) fn new(columns: usize, text_columns: usize) -> RowStore {
        RowStore { columns, text_columns, ..RowStore::default() }
    }

    pub(super) fn widths(&self) -> (usize, usize) {
        (self.columns, self.text_columns)
    }

    pub(super) fn rows(&self) -> usize {
        self.rows
    }

    #[inline]
    pub(super) fn numbers(&self, rows: Range<usize>) -> &[f64] {
        &self.numbers[rows.start * self.columns..rows.end * self.columns]
    }

    #[inline]
    pub(super) fn texts(&self, rows: Range<usize>) -> &[Label] {
        &self.texts[rows.start * self.text_columns..rows.end * self.text_columns]
    }

    pub(super) fn set_number(&mut self, row: usize, column: usize, value: f64) {
        assert!(column < self.columns, "column {column} of {}", self.columns);
        self.numbers[row * self.columns + column] = value;
    }

    /// Appends `rows` rows; row k = 0, 1, … of the new rows has source (`source.file`, `source.row` + k). Panics if the
    /// number of cells does not fit `rows` rows.
    pub(super) fn push(&mut self, rows: usize, numbers: &[f64], texts: &[Label], source: Source) {
        let expected = (rows * self.columns, rows * self.text_columns);
        assert_eq!((numbers.len(), texts.len()), expected, "cells of {rows} rows");
        if rows == 0 {
            return;
        }
        self.numbers.extend_from_slice(numbers);
        self.texts.extend_from_slice(texts);
        if self.next_source() != Some(source) {
            self.sources.push((self.rows, source));
        }
        self.rows += rows;
    }

    /// Appends the rows `rows` of another store, with equal numbers of cells in a row.
    pub(super) fn push_from(&mut self, others: &RowStore, rows: Range<usize>) {
        let mut start = rows.start;
        while start < rows.end {
            let end = others.run_end(start).min(rows.end);
            self.push(end - start, others.numbers(start..end), others.texts(start..end), others.source(start));
            start = end;
        }
    }

    /// The rows `rows` with `more` further numeric cells in each row, which `write` writes from the cells of the row.
    pub(super) fn widened(
        &self,
        rows: Range<usize>,
        more: usize,
        mut write: impl FnMut(&[f64], &mut [f64]),
    ) -> RowStore {
        let mut wide = RowStore::new(self.columns + more, self.text_columns);
        wide.numbers.reserve_exact(rows.len() * wide.columns);
        for row in rows.clone() {
            let own = self.numbers(row..row + 1);
            wide.numbers.extend_from_slice(own);
            let end = wide.numbers.len();
            wide.numbers.resize(end + more, f64::NAN);
            write(own, &mut wide.numbers[end..]);
        }
        wide.texts.extend_from_slice(self.texts(rows.clone()));
        let mut start = rows.start;
        while start < rows.end {
            wide.sources.push((start - rows.start, self.source(start)));
            start = self.run_end(start);
        }
        wide.rows = rows.len();
        wide
    }

    /// Frees unused memory of each list, if more than an eighth of the used memory is unused.
    pub(super) fn shrink(&mut self) {
        shrink(&mut self.numbers);
        shrink(&mut self.texts);
        shrink(&mut self.sources);
    }

    /// File and line of a row.
    pub(super) fn source(&self, row: usize) -> Source {
        let run = self.sources.partition_point(|(first, _)| *first <= row) - 1;
        let (first, source) = self.sources[run];
        Source { row: source.row + (row - first) as u64, ..source }
    }

    /// End of the run of rows that contains this row and follows the order of the file.
    fn run_end(&self, row: usize) -> usize {
        let next = self.sources.partition_point(|(first, _)| *first <= row);
        self.sources.get(next).map_or(self.rows, |(first, _)| *first)
    }

    /// Source of a row that would follow the last row in the file; `None` if there are no rows.
    fn next_source(&self) -> Option<Source> {
        let (first, source) = self.sources.last()?;
        Some(Source { row: source.row.checked_add((self.rows - first) as u64)?, ..*source })
    }
}

/// Frees the unused memory of a list, if more than an eighth of the used memory is unused.
fn shrink<T>(list: &mut Vec<T>) {
    if list.capacity() - list.len() > list.len() / 8 {
        list.shrink_to_fit();
    }
}
