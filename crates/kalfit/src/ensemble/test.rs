//! One test: its rows, in time order.

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
    sources: Vec<Source>,
}

impl Test {
    /// An empty test whose rows have this many numeric and text cells.
    pub fn new(id: impl Into<String>, columns: usize, text_columns: usize) -> Test {
        Test { id: id.into(), columns, text_columns, numbers: Vec::new(), texts: Vec::new(), sources: Vec::new() }
    }

    /// Appends a row. Panics when the number of cells is not that of the test.
    pub fn push(&mut self, numbers: &[f64], texts: &[Label], source: Source) {
        assert_eq!((numbers.len(), texts.len()), (self.columns, self.text_columns), "cells of a row");
        self.numbers.extend_from_slice(numbers);
        self.texts.extend_from_slice(texts);
        self.sources.push(source);
    }

    /// The first rows, at most as many as there are.
    pub(crate) fn first(&self, rows: usize) -> Test {
        let mut test = Test::new(self.id.clone(), self.columns, self.text_columns);
        (0..rows.min(self.rows())).for_each(|row| test.push(self.numbers(row), self.texts(row), self.source(row)));
        test
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.sources.len()
    }

    /// Numeric cells of a row.
    pub fn numbers(&self, row: usize) -> &[f64] {
        &self.numbers[row * self.columns..][..self.columns]
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
        self.sources[row]
    }
}
