//! A square matrix in a record.

use std::ops::Index;

use nalgebra::DMatrix;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A square matrix, written as the list of its rows. Entries are stored in one piece of memory, which a view borrows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SquareRecord<E = Vec<f64>> {
    size: usize,
    entries: E,
}

impl<E: AsRef<[f64]>> SquareRecord<E> {
    /// Number of rows, and of columns.
    pub fn size(&self) -> usize {
        self.size
    }

    /// The rows of the matrix.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        (0..self.size).map(|i| &self[i])
    }

    /// All entries, row after row.
    pub fn entries(&self) -> &[f64] {
        self.entries.as_ref()
    }
}

impl<'a> SquareRecord<&'a [f64]> {
    /// View of the square matrix with `entries`, row after row.
    pub(super) fn view(entries: &'a [f64], size: usize) -> SquareRecord<&'a [f64]> {
        debug_assert_eq!(entries.len(), size * size);
        SquareRecord { size, entries }
    }

    /// A copy that owns the entries.
    pub fn to_owned(self) -> SquareRecord {
        SquareRecord { size: self.size, entries: self.entries.to_vec() }
    }
}

/// The rows of any matrix.
pub(super) fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// Row `i` of the matrix.
impl<E: AsRef<[f64]>> Index<usize> for SquareRecord<E> {
    type Output = [f64];

    fn index(&self, i: usize) -> &[f64] {
        &self.entries.as_ref()[i * self.size..][..self.size]
    }
}

/// Conversion of a symmetric matrix, whose columns equal the rows.
impl From<&DMatrix<f64>> for SquareRecord {
    fn from(symmetric: &DMatrix<f64>) -> SquareRecord {
        SquareRecord { size: symmetric.nrows(), entries: symmetric.as_slice().to_vec() }
    }
}

impl<E: AsRef<[f64]>> Serialize for SquareRecord<E> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.rows())
    }
}

/// Rows of a matrix that is not square.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a square matrix of {size} rows has {found} numbers in row {row}")]
pub struct NotSquare {
    /// Number of rows.
    pub size: usize,
    /// Number of the first row of a different length, from 1.
    pub row: usize,
    /// Length of row `row`.
    pub found: usize,
}

/// Conversion from a list of rows.
impl TryFrom<Vec<Vec<f64>>> for SquareRecord {
    type Error = NotSquare;

    fn try_from(rows: Vec<Vec<f64>>) -> Result<SquareRecord, NotSquare> {
        let size = rows.len();
        match rows.iter().position(|row| row.len() != size) {
            None => Ok(SquareRecord { size, entries: rows.concat() }),
            Some(at) => Err(NotSquare { size, row: at + 1, found: rows[at].len() }),
        }
    }
}

impl<'de> Deserialize<'de> for SquareRecord {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<SquareRecord, D::Error> {
        Vec::<Vec<f64>>::deserialize(deserializer)?.try_into().map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_made_of_rows_as_long_as_there_are_rows() {
        let square = SquareRecord::from(&DMatrix::from_row_slice(2, 2, &[1.0, 0.5, 0.5, 2.0]));
        assert_eq!(SquareRecord::try_from(vec![vec![1.0, 0.5], vec![0.5, 2.0]]), Ok(square.clone()));
        assert_eq!((&square[1], square.size()), (&[0.5, 2.0][..], 2));
        let ragged = SquareRecord::try_from(vec![vec![1.0, 2.0], vec![2.0, 3.0, 4.0]]).unwrap_err();
        assert_eq!(ragged.to_string(), "a square matrix of 2 rows has 3 numbers in row 2");
    }
}
