//! Rows of cells, one after the other, of one test or of many.

use std::ops::Range;

use crate::ensemble::{Label, Source};

/// Rows of cells, and where they came from.
#[derive(Debug, Clone, Default)]
pub(super) struct RowStore {
    columns: usize,
    text_columns: usize,
    numbers: Vec<f64>,
    texts: Vec<Label>,
    rows: usize,
    /// (first row, its source) of each run of rows that follow each other in a file, be they of one test or of many.
    sources: Vec<(usize, Source)>,
}

impl RowStore {
    /// An empty store for rows with this many numeric and text cells.
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

    /// Appends rows, the k-th of them from row `source.row + k` of its file. Panics when the number of cells is not
    /// that of `rows` rows.
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

    /// Appends rows of another store.
    pub(super) fn push_from(&mut self, others: &RowStore, rows: Range<usize>) {
        let mut start = rows.start;
        while start < rows.end {
            let end = others.follow(start).min(rows.end);
            self.push(end - start, others.numbers(start..end), others.texts(start..end), others.source(start));
            start = end;
        }
    }

    /// Gives back memory that the rows do not need, except for a small part.
    pub(super) fn fit(&mut self) {
        fit(&mut self.numbers);
        fit(&mut self.texts);
        fit(&mut self.sources);
    }

    /// Where a row came from.
    pub(super) fn source(&self, row: usize) -> Source {
        let run = self.sources.partition_point(|(first, _)| *first <= row) - 1;
        let (first, source) = self.sources[run];
        Source { row: source.row + (row - first) as u64, ..source }
    }

    /// End of the run of rows that follow this row in its file.
    fn follow(&self, row: usize) -> usize {
        let next = self.sources.partition_point(|(first, _)| *first <= row);
        self.sources.get(next).map_or(self.rows, |(first, _)| *first)
    }

    /// Source of the next row, if it follows the last row in its file.
    fn next_source(&self) -> Option<Source> {
        let (first, source) = self.sources.last()?;
        Some(Source { row: source.row.checked_add((self.rows - first) as u64)?, ..*source })
    }
}

/// Gives back the unused memory of a list, if it is more than an eighth of the used.
fn fit<T>(list: &mut Vec<T>) {
    if list.capacity() - list.len() > list.len() / 8 {
        list.shrink_to_fit();
    }
}
