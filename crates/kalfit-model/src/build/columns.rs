//! One test as columns of numbers and texts.

use crate::ensemble::{Label, Labels, Source, Test};
use crate::evidence::PhasedTest;
pub(super) use crate::evidence::SplitError;
use crate::model::{Column, PhasedModel};

/// The data of one test: columns of equal length, each row a time step. NaN marks a missing number, an empty text a
/// missing text.
///
/// ```
/// # use kalfit_model as kalfit;
/// use kalfit::build::Columns;
///
/// let test = Columns::new("g07")
///     .numbers("hours", [0.0, 0.5, 1.0])
///     .numbers("rate", [0.71, f64::NAN, 0.68]) // the second value is missing
///     .every_text("station", "A");
/// assert_eq!(test.id(), "g07");
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Columns {
    id: String,
    numbers: Vec<(String, Cells<f64>)>,
    texts: Vec<(String, Cells<String>)>,
}

#[derive(Debug, Clone, PartialEq)]
enum Cells<T> {
    Each(Vec<T>),
    Every(T),
}

/// Reason why columns are not data of a model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ColumnsError {
    /// The model reads a column that the test does not have.
    #[error("test `{test}` has no column `{column}`, which {used_in} reads; it has {}", has(found))]
    NoColumn {
        /// Id of the test.
        test: String,
        /// The column.
        column: String,
        /// Where the model uses the column.
        used_in: String,
        /// The columns of this kind that the test has.
        found: Vec<String>,
    },
    /// A column is longer or shorter than the columns before.
    #[error("column `{column}` of test `{test}` has {found} rows, expected {expected} as in the columns before it")]
    Length {
        /// Id of the test.
        test: String,
        /// The column.
        column: String,
        /// Number of rows of the column.
        found: usize,
        /// Number of rows of the columns before.
        expected: usize,
    },
    /// Two columns have one name.
    #[error("test `{test}` has two columns `{column}`")]
    Twice {
        /// Id of the test.
        test: String,
        /// The column.
        column: String,
    },
    /// A number is infinite.
    #[error(
        "column `{column}` of test `{test}` is {value} at row {row}, expected a finite number, or NaN for a missing one"
    )]
    Infinite {
        /// Id of the test.
        test: String,
        /// The column.
        column: String,
        /// The row, from 1.
        row: usize,
        /// The number.
        value: f64,
    },
    /// The rows do not fit the phases of the model.
    #[error(transparent)]
    Split(#[from] SplitError),
}

fn has(found: &[String]) -> String {
    if found.is_empty() { "none of its kind".to_owned() } else { found.join(", ") }
}

impl<T> Cells<T> {
    fn rows(&self) -> Option<usize> {
        match self {
            Cells::Each(cells) => Some(cells.len()),
            Cells::Every(_) => None,
        }
    }

    fn at(&self, row: usize) -> &T {
        match self {
            Cells::Each(cells) => &cells[row],
            Cells::Every(cell) => cell,
        }
    }
}

impl Columns {
    /// A test without columns.
    pub fn new(id: impl Into<String>) -> Columns {
        Columns { id: id.into(), numbers: Vec::new(), texts: Vec::new() }
    }

    /// Id of the test.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Adds a column of numbers.
    #[must_use]
    pub fn numbers(mut self, name: impl Into<String>, cells: impl IntoIterator<Item = f64>) -> Self {
        self.numbers.push((name.into(), Cells::Each(cells.into_iter().collect())));
        self
    }

    /// Adds a column with the number `cell` in every row.
    #[must_use]
    pub fn every_number(mut self, name: impl Into<String>, cell: f64) -> Self {
        self.numbers.push((name.into(), Cells::Every(cell)));
        self
    }

    /// Adds a column of texts.
    #[must_use]
    pub fn texts<T: Into<String>>(mut self, name: impl Into<String>, cells: impl IntoIterator<Item = T>) -> Self {
        self.texts.push((name.into(), Cells::Each(cells.into_iter().map(Into::into).collect())));
        self
    }

    /// Adds a column with the text `cell` in every row.
    #[must_use]
    pub fn every_text(mut self, name: impl Into<String>, cell: impl Into<String>) -> Self {
        self.texts.push((name.into(), Cells::Every(cell.into())));
        self
    }

    /// Makes the test of `model` from the columns; the texts of the test get labels in `labels`.
    ///
    /// # Errors
    /// Columns that the model reads and the test lacks, columns that do not fit together, infinite numbers, and phases
    /// that the model does not have.
    pub fn test(&self, model: &PhasedModel, labels: &mut Labels) -> Result<PhasedTest, ColumnsError> {
        let rows = self.rows()?;
        let shared = model.shared();
        let numbers = self.read_columns(&self.numbers, &shared.columns)?;
        let texts = self.read_columns(&self.texts, &shared.text_columns)?;
        let mut test = Test::new(self.id.clone(), numbers.len(), texts.len());
        let mut row_numbers = vec![0.0; numbers.len()];
        for row in 0..rows {
            for (cell, (column, cells)) in row_numbers.iter_mut().zip(numbers.iter().zip(&shared.columns).map(swapped))
            {
                *cell = *cells.at(row);
                if cell.is_infinite() {
                    let (test, column) = (self.id.clone(), column.name.clone());
                    return Err(ColumnsError::Infinite { test, column, row: row + 1, value: *cell });
                }
            }
            let label = |cells: &&Cells<String>| match cells.at(row).as_str() {
                "" => Label::MISSING,
                text => labels.intern(text),
            };
            let row_texts: Vec<Label> = texts.iter().map(label).collect();
            test.push(&row_numbers, &row_texts, Source { file: 0, row: row as u64 + 1 });
        }
        Ok(model.split(test, labels)?)
    }

    /// The number of rows; 1 where every column has one cell for all rows.
    fn rows(&self) -> Result<usize, ColumnsError> {
        let all = self.numbers.iter().map(|(name, cells)| (name, cells.rows()));
        let all: Vec<_> = all.chain(self.texts.iter().map(|(name, cells)| (name, cells.rows()))).collect();
        let mut expected = None;
        for (i, (name, rows)) in all.iter().enumerate() {
            let (test, column) = (self.id.clone(), (*name).clone());
            if all[..i].iter().any(|(other, _)| other == name) {
                return Err(ColumnsError::Twice { test, column });
            }
            match (expected, rows) {
                (None, Some(rows)) => expected = Some(*rows),
                (Some(expected), Some(found)) if *found != expected => {
                    return Err(ColumnsError::Length { test, column, found: *found, expected });
                }
                _ => {}
            }
        }
        Ok(expected.unwrap_or(1))
    }

    /// The columns that the model reads, in the order of the model.
    fn read_columns<'a, T>(
        &self,
        given: &'a [(String, Cells<T>)],
        wanted: &[Column],
    ) -> Result<Vec<&'a Cells<T>>, ColumnsError> {
        let find = |column: &Column| {
            given.iter().find(|(name, _)| *name == column.name).map(|(_, cells)| cells).ok_or_else(|| {
                ColumnsError::NoColumn {
                    test: self.id.clone(),
                    column: column.name.clone(),
                    used_in: column.used_in.clone(),
                    found: given.iter().map(|(name, _)| name.clone()).collect(),
                }
            })
        };
        wanted.iter().map(find).collect()
    }
}

fn swapped<A, B>((a, b): (A, B)) -> (B, A) {
    (b, a)
}
