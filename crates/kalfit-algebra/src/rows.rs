//! Small dense row-major matrices, for kernels that work on square roots; one source for every kind of [`Real`].

use std::ops::{Index, IndexMut};

use nalgebra::DMatrix;

use kalfit_lanes::Real;

/// A row-major matrix.
#[derive(Debug, Clone, PartialEq)]
pub struct Rows<T = f64> {
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) data: Vec<T>,
}

impl<T> Index<(usize, usize)> for Rows<T> {
    type Output = T;
    #[inline(always)]
    fn index(&self, (i, k): (usize, usize)) -> &T {
        &self.data[i * self.columns + k]
    }
}

impl<T> IndexMut<(usize, usize)> for Rows<T> {
    #[inline(always)]
    fn index_mut(&mut self, (i, k): (usize, usize)) -> &mut T {
        &mut self.data[i * self.columns + k]
    }
}

impl From<&DMatrix<f64>> for Rows {
    fn from(matrix: &DMatrix<f64>) -> Rows {
        Rows { rows: matrix.nrows(), columns: matrix.ncols(), data: matrix.transpose().as_slice().to_vec() }
    }
}

impl<T: Real> Rows<T> {
    /// A matrix of zeros, rows × columns.
    #[inline(always)]
    pub fn zeros(rows: usize, columns: usize) -> Rows<T> {
        Rows { rows, columns, data: vec![T::splat(0.0); rows * columns] }
    }

    /// The matrix with elements `entry(i, k)` in row i and column k, rows × columns.
    #[inline(always)]
    pub fn from_fn(rows: usize, columns: usize, entry: impl Fn(usize, usize) -> T) -> Rows<T> {
        let mut filled = Rows::zeros(rows, columns);
        if columns > 0 {
            for (i, row) in filled.data.chunks_exact_mut(columns).enumerate() {
                for (k, x) in row.iter_mut().enumerate() {
                    *x = entry(i, k);
                }
            }
        }
        filled
    }

    /// The identity matrix, size × size.
    #[inline(always)]
    pub fn identity(size: usize) -> Rows<T> {
        let mut identity = Rows::zeros(size, size);
        for i in 0..size {
            identity[(i, i)] = T::splat(1.0);
        }
        identity
    }

    /// Number of rows.
    #[inline(always)]
    pub fn nrows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    #[inline(always)]
    pub fn ncols(&self) -> usize {
        self.columns
    }

    /// All elements, row by row.
    #[inline(always)]
    pub fn as_slice(&self) -> &[T] {
        &self.data
    }

    /// The matrix with elements `data`, row-major, rows × columns.
    #[inline(always)]
    pub(crate) fn from_vec(rows: usize, columns: usize, data: Vec<T>) -> Rows<T> {
        debug_assert_eq!(data.len(), rows * columns, "numbers of a matrix");
        Rows { rows, columns, data }
    }

    /// The elements of row i.
    #[inline(always)]
    pub fn row(&self, i: usize) -> &[T] {
        &self.data[i * self.columns..][..self.columns]
    }

    /// The elements of row i for writing.
    #[inline(always)]
    pub fn row_mut(&mut self, i: usize) -> &mut [T] {
        &mut self.data[i * self.columns..][..self.columns]
    }

    /// The elements of rows 0..i, and the elements of row i for writing.
    #[inline(always)]
    pub(crate) fn split_at_row(&mut self, i: usize) -> (&[T], &mut [T]) {
        let (above, rest) = self.data.split_at_mut(i * self.columns);
        (above, &mut rest[..self.columns])
    }

    /// Appends the rows of `below`.
    #[inline(always)]
    pub fn append(&mut self, below: &Rows<T>) {
        debug_assert_eq!(self.columns, below.columns, "one width");
        self.rows += below.rows;
        self.data.extend_from_slice(&below.data);
    }

    /// The first `columns` columns of the matrix.
    #[inline(always)]
    pub fn first_columns(&self, columns: usize) -> Rows<T> {
        self.column_range(0, columns)
    }

    /// The last `columns` columns of the matrix.
    #[inline(always)]
    pub fn last_columns(&self, columns: usize) -> Rows<T> {
        self.column_range(self.columns - columns, columns)
    }

    #[inline(always)]
    fn column_range(&self, from: usize, columns: usize) -> Rows<T> {
        let mut selected = Rows::zeros(self.rows, columns);
        for i in 0..self.rows {
            selected.row_mut(i).copy_from_slice(&self.row(i)[from..from + columns]);
        }
        selected
    }

    /// The first `rows` rows of the matrix.
    #[inline(always)]
    pub(crate) fn first_rows(&self, rows: usize) -> Rows<T> {
        Rows { rows, columns: self.columns, data: self.data[..rows * self.columns].to_vec() }
    }

    /// [A B].
    #[inline(always)]
    pub fn joined_columns(&self, other: &Rows<T>) -> Rows<T> {
        let left_width = self.columns;
        let mut joined = Rows::zeros(self.rows, left_width + other.columns);
        for i in 0..self.rows {
            let (left, right) = joined.row_mut(i).split_at_mut(left_width);
            left.copy_from_slice(self.row(i));
            right.copy_from_slice(other.row(i));
        }
        joined
    }

    /// A'.
    #[inline(always)]
    pub fn transposed(&self) -> Rows<T> {
        let mut turned = Rows::zeros(self.columns, self.rows);
        for i in 0..self.rows {
            for (k, &x) in self.row(i).iter().enumerate() {
                turned[(k, i)] = x;
            }
        }
        turned
    }

    /// A - B.
    #[inline(always)]
    pub fn less(mut self, other: &Rows<T>) -> Rows<T> {
        for (a, &b) in self.data.iter_mut().zip(&other.data) {
            *a = *a - b;
        }
        self
    }

    /// A + B.
    #[inline(always)]
    pub fn plus(mut self, other: &Rows<T>) -> Rows<T> {
        for (a, &b) in self.data.iter_mut().zip(&other.data) {
            *a = *a + b;
        }
        self
    }

    /// Whether |a_ik| ≤ `bound` for every element a_ik; false if an element is NaN.
    #[inline(always)]
    pub(crate) fn is_within(&self, bound: f64) -> bool {
        let bound = T::splat(bound);
        let mut within = true;
        for x in &self.data {
            within &= x.magnitude().at_most(bound);
        }
        within
    }
}
