//! One test: its rows, in time order.

use std::ops::Range;

use crate::ensemble::Label;

/// Where a row came from. The core only carries it, for messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Source {
    /// Number of the file.
    pub file: u32,
    /// Number of the row in the file, as a person counts (a CSV file's header is line 1).
    pub row: u64,
}

/// The rows of one test with the columns a model reads. Missing numbers are NaN, missing texts [`Label::MISSING`].
#[derive(Debug, Clone, PartialEq)]
pub struct Test {
    /// Its id, as text.
    pub id: String,
    columns: usize,
    text_columns: usize,
    numbers: Vec<f64>,
    texts: Vec<Label>,
    rows: usize,
    /// (row of the test, where it came from): the first of rows that follow each other in a file.
    sources: Vec<(usize, Source)>,
}

impl Test {
    /// An empty test whose rows have this many numeric and text cells.
    pub fn new(id: impl Into<String>, columns: usize, text_columns: usize) -> Test {
        let (numbers, texts, sources) = (Vec::new(), Vec::new(), Vec::new());
        Test { id: id.into(), columns, text_columns, numbers, texts, rows: 0, sources }
    }

    /// Appends a row. Panics when the number of cells is not that of the test.
    pub fn push(&mut self, numbers: &[f64], texts: &[Label], source: Source) {
        assert_eq!((numbers.len(), texts.len()), (self.columns, self.text_columns), "cells of a row");
        self.numbers.extend_from_slice(numbers);
        self.texts.extend_from_slice(texts);
        if self.rows == 0 || self.next_source() != Some(source) {
            self.sources.push((self.rows, source));
        }
        self.rows += 1;
    }

    /// Appends rows, the k-th of them from row `source.row + k` of its file. Panics when the number of cells is not that of so
    /// many rows of the test.
    pub fn push_rows(&mut self, rows: usize, numbers: &[f64], texts: &[Label], source: Source) {
        assert_eq!(
            (numbers.len(), texts.len()),
            (rows * self.columns, rows * self.text_columns),
            "cells of {rows} rows"
        );
        if rows == 0 {
            return;
        }
        if self.rows == 0 {
            // most tests come whole: no more memory than they need
            self.numbers.reserve_exact(numbers.len());
            self.texts.reserve_exact(texts.len());
            self.sources.reserve_exact(1);
        }
        self.numbers.extend_from_slice(numbers);
        self.texts.extend_from_slice(texts);
        if self.rows == 0 || self.next_source() != Some(source) {
            self.sources.push((self.rows, source));
        }
        self.rows += rows;
    }

    /// Appends rows of another test. Panics where it has no such rows, or other numbers of cells.
    pub(crate) fn push_from(&mut self, other: &Test, rows: Range<usize>) {
        let mut start = rows.start;
        while start < rows.end {
            let end = other.follow(start).min(rows.end);
            let numbers = &other.numbers[start * other.columns..end * other.columns];
            let texts = &other.texts[start * other.text_columns..end * other.text_columns];
            self.push_rows(end - start, numbers, texts, other.source(start));
            start = end;
        }
    }

    /// The first rows, at most as many as there are.
    pub(crate) fn first(&self, rows: usize) -> Test {
        let mut test = Test::new(self.id.clone(), self.columns, self.text_columns);
        test.push_from(self, 0..rows.min(self.rows()));
        test
    }

    /// Numeric and text cells of a row.
    pub(crate) fn widths(&self) -> (usize, usize) {
        (self.columns, self.text_columns)
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Numeric cells of a row.
    pub fn numbers(&self, row: usize) -> &[f64] {
        &self.numbers[row * self.columns..][..self.columns]
    }

    /// Numeric cells of all rows.
    pub(crate) fn all_numbers(&self) -> &[f64] {
        &self.numbers
    }

    /// Sets a numeric cell. Panics when there is no such cell.
    pub fn set_number(&mut self, row: usize, column: usize, value: f64) {
        assert!(column < self.columns, "column {column} of {}", self.columns);
        self.numbers[row * self.columns + column] = value;
    }

    /// Text cells of a row.
    pub fn texts(&self, row: usize) -> &[Label] {
        &self.texts[row * self.text_columns..][..self.text_columns]
    }

    /// Where a row came from.
    pub fn source(&self, row: usize) -> Source {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        let run = self.sources.partition_point(|(first, _)| *first <= row) - 1;
        let (first, source) = self.sources[run];
        Source { row: source.row + (row - first) as u64, ..source }
    }

    /// The end of the rows that follow this one in its file.
    fn follow(&self, row: usize) -> usize {
        let next = self.sources.partition_point(|(first, _)| *first <= row);
        self.sources.get(next).map_or(self.rows, |(first, _)| *first)
    }

    /// Where the next row comes from, if it follows the last one in its file.
    fn next_source(&self) -> Option<Source> {
        let (first, source) = self.sources.last()?;
        Some(Source { row: source.row.checked_add((self.rows - first) as u64)?, ..*source })
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
        assert_eq!((test.rows(), test.sources.len()), (10, 7));
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
        for rows in [0..10, 2..7, 4..5, 9..10, 3..3] {
            let (mut parts, mut whole) = (Test::new("t", 2, 1), Test::new("t", 2, 1));
            rows.clone().for_each(|row| parts.push(together.numbers(row), together.texts(row), together.source(row)));
            whole.push_from(&together, rows.clone());
            assert_eq!(whole, parts, "rows {rows:?}");
        }
    }
}
