//! Small dense matrices by rows, for kernels that work on square roots: products, and triangular factors of sums of rows.

use std::ops::{Index, IndexMut};

use nalgebra::DMatrix;

use crate::linalg::fold::Rotation;

/// A matrix by rows.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Rows {
    rows: usize,
    columns: usize,
    data: Vec<f64>,
}

impl Index<(usize, usize)> for Rows {
    type Output = f64;
    fn index(&self, (i, k): (usize, usize)) -> &f64 {
        &self.data[i * self.columns + k]
    }
}

impl IndexMut<(usize, usize)> for Rows {
    fn index_mut(&mut self, (i, k): (usize, usize)) -> &mut f64 {
        &mut self.data[i * self.columns + k]
    }
}

impl From<&DMatrix<f64>> for Rows {
    fn from(matrix: &DMatrix<f64>) -> Rows {
        Rows { rows: matrix.nrows(), columns: matrix.ncols(), data: matrix.transpose().as_slice().to_vec() }
    }
}

impl Rows {
    pub(crate) fn zeros(rows: usize, columns: usize) -> Rows {
        Rows { rows, columns, data: vec![0.0; rows * columns] }
    }

    pub(crate) fn from_fn(rows: usize, columns: usize, entry: impl Fn(usize, usize) -> f64) -> Rows {
        let mut all = Rows::zeros(rows, columns);
        if columns > 0 {
            for (i, row) in all.data.chunks_exact_mut(columns).enumerate() {
                row.iter_mut().enumerate().for_each(|(k, x)| *x = entry(i, k));
            }
        }
        all
    }

    pub(crate) fn nrows(&self) -> usize {
        self.rows
    }

    pub(crate) fn ncols(&self) -> usize {
        self.columns
    }

    pub(crate) fn row(&self, i: usize) -> &[f64] {
        &self.data[i * self.columns..][..self.columns]
    }

    pub(crate) fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.data[i * self.columns..][..self.columns]
    }

    /// Puts rows below.
    pub(crate) fn append(&mut self, below: &Rows) {
        debug_assert_eq!(self.columns, below.columns, "one width");
        self.rows += below.rows;
        self.data.extend_from_slice(&below.data);
    }

    /// The first columns of it.
    pub(crate) fn first_columns(&self, columns: usize) -> Rows {
        self.some_columns(0, columns)
    }

    /// The last columns of it.
    pub(crate) fn last_columns(&self, columns: usize) -> Rows {
        self.some_columns(self.columns - columns, columns)
    }

    fn some_columns(&self, from: usize, columns: usize) -> Rows {
        let mut some = Rows::zeros(self.rows, columns);
        for i in 0..self.rows {
            some.row_mut(i).copy_from_slice(&self.row(i)[from..from + columns]);
        }
        some
    }

    /// The first rows of it.
    pub(crate) fn first_rows(&self, rows: usize) -> Rows {
        Rows { rows, columns: self.columns, data: self.data[..rows * self.columns].to_vec() }
    }

    /// [A B].
    pub(crate) fn beside(&self, other: &Rows) -> Rows {
        let own = self.columns;
        let mut both = Rows::zeros(self.rows, own + other.columns);
        for i in 0..self.rows {
            let (left, right) = both.row_mut(i).split_at_mut(own);
            left.copy_from_slice(self.row(i));
            right.copy_from_slice(other.row(i));
        }
        both
    }

    /// AB.
    pub(crate) fn times(&self, other: &Rows) -> Rows {
        let mut product = Rows::zeros(self.nrows(), other.columns);
        for i in 0..self.nrows() {
            for (k, &a) in self.row(i).iter().enumerate() {
                add(product.row_mut(i), a, other.row(k));
            }
        }
        product
    }

    /// A'B.
    pub(crate) fn transpose_times(&self, other: &Rows) -> Rows {
        let mut product = Rows::zeros(self.columns, other.columns);
        for k in 0..self.nrows() {
            for (i, &a) in self.row(k).iter().enumerate() {
                add(product.row_mut(i), a, other.row(k));
            }
        }
        product
    }

    /// AB'.
    pub(crate) fn times_transpose(&self, other: &Rows) -> Rows {
        let mut product = Rows::zeros(self.rows, other.rows);
        for i in 0..self.rows {
            let own = self.row(i);
            for (k, x) in product.row_mut(i).iter_mut().enumerate() {
                *x = own.iter().zip(other.row(k)).fold(0.0, |sum, (a, b)| sum + a * b);
            }
        }
        product
    }

    /// A - B.
    pub(crate) fn less(mut self, other: &Rows) -> Rows {
        self.data.iter_mut().zip(&other.data).for_each(|(a, b)| *a -= b);
        self
    }

    /// A + B.
    pub(crate) fn plus(mut self, other: &Rows) -> Rows {
        self.data.iter_mut().zip(&other.data).for_each(|(a, b)| *a += b);
        self
    }

    /// The largest entry by magnitude.
    pub(crate) fn amax(&self) -> f64 {
        self.data.iter().fold(0.0, |most: f64, x| most.max(x.abs()))
    }

    /// U⁻ᵀB, U upper triangular.
    pub(crate) fn solved_below(upper: &Rows, mut b: Rows) -> Rows {
        for i in 0..b.nrows() {
            let (done, rest) = b.data.split_at_mut(i * b.columns);
            let row = &mut rest[..b.columns];
            for k in 0..i {
                add(row, -upper[(k, i)], &done[k * b.columns..][..b.columns]);
            }
            row.iter_mut().for_each(|x| *x /= upper[(i, i)]);
        }
        b
    }
}

/// y ← y + a x.
fn add(y: &mut [f64], a: f64, x: &[f64]) {
    if a != 0.0 {
        y.iter_mut().zip(x).for_each(|(y, x)| *y += a * x);
    }
}

/// How triangular factors are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Care {
    /// From cross products and reflections: fast.
    Plain,
    /// By plane rotations, row by row: rows of very different size do no harm.
    Rotations,
}

/// U, upper triangular w × w, with U'U = I + rows'rows; rows any number × w. No diagonal element is below one.
pub(crate) fn identity_plus(rows: &Rows, care: Care) -> Rows {
    let w = rows.columns;
    let mut upper = Rows::from_fn(w, w, |i, k| f64::from(u8::from(i == k)));
    match care {
        Care::Rotations => rotate(&mut upper, rows.clone(), w),
        Care::Plain => {
            for row in 0..rows.nrows() {
                for i in 0..w {
                    let (a, from) = (rows[(row, i)], row * w);
                    add(&mut upper.row_mut(i)[i..], a, &rows.data[from + i..from + w]);
                }
            }
            cholesky(&mut upper);
        }
    }
    for i in 0..w {
        upper[(i, i)] = upper[(i, i)].max(1.0); // rounding must not make it less
    }
    upper
}

/// The upper triangle of a matrix ⪰ I turned into its Cholesky factor.
fn cholesky(upper: &mut Rows) {
    let w = upper.columns;
    for i in 0..w {
        let (done, rest) = upper.data.split_at_mut(i * w);
        let row = &mut rest[..w];
        for k in 0..i {
            let above = &done[k * w..][..w];
            add(&mut row[i..], -above[i], &above[i..]);
        }
        let pivot = row[i].max(1.0).sqrt();
        row[i] = pivot;
        row[i + 1..].iter_mut().for_each(|x| *x /= pivot);
    }
}

/// Folds rows into [R | d], R upper triangular (first `width` columns) with a diagonal that is not negative. What is left of
/// the rows in the other columns is returned: R takes no part of it.
pub(crate) fn absorb(upper: &mut Rows, mut rows: Rows, width: usize, care: Care) -> Rows {
    match care {
        Care::Rotations => {
            rotate_keeping(upper, &mut rows, width);
            rows
        }
        Care::Plain => {
            let mut along = vec![0.0; upper.columns];
            (0..width).for_each(|k| reflect(upper, &mut rows, k, &mut along));
            rows
        }
    }
}

/// One reflection, which takes column k of the rows into row k of the triangle.
fn reflect(upper: &mut Rows, rows: &mut Rows, k: usize, along: &mut [f64]) {
    let below: f64 = (0..rows.nrows()).map(|i| rows[(i, k)].powi(2)).sum();
    if below == 0.0 {
        return;
    }
    let head = upper[(k, k)];
    let length = (head * head + below).sqrt();
    // head ≥ 0: the reflection to -length cancels nothing; the row's sign is turned afterwards
    let first = head + length;
    let scale = 1.0 / (length * first);
    let along = &mut along[k..];
    along.iter_mut().zip(&upper.row(k)[k..]).for_each(|(s, x)| *s = x * first);
    for i in 0..rows.nrows() {
        let a = rows[(i, k)];
        add(along, a, &rows.row(i)[k..]);
    }
    along.iter_mut().for_each(|x| *x *= scale);
    for (x, s) in upper.row_mut(k)[k..].iter_mut().zip(along.iter()) {
        *x = first * s - *x;
    }
    for i in 0..rows.nrows() {
        let a = rows[(i, k)];
        add(&mut rows.row_mut(i)[k..], -a, along);
        rows[(i, k)] = 0.0;
    }
    upper[(k, k)] = length;
}

fn rotate(upper: &mut Rows, mut rows: Rows, width: usize) {
    rotate_keeping(upper, &mut rows, width);
}

fn rotate_keeping(upper: &mut Rows, rows: &mut Rows, width: usize) {
    for i in 0..rows.nrows() {
        let row = rows.row_mut(i);
        for k in 0..width {
            let pivot = upper.row_mut(k);
            let rotation = Rotation::of(pivot[k], row[k]);
            if rotation.s == 0.0 {
                continue;
            }
            (pivot[k], row[k]) = (rotation.length, 0.0);
            for (a, b) in pivot[k + 1..].iter_mut().zip(&mut row[k + 1..]) {
                (*a, *b) = rotation.turn(*a, *b);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(rows: usize, columns: usize, seed: f64) -> Rows {
        Rows::from_fn(rows, columns, |i, k| (seed + 3.0 * i as f64 + 7.0 * k as f64).sin() * 10f64.powi(k as i32))
    }

    fn gram(rows: &Rows) -> Rows {
        rows.transpose_times(rows)
    }

    fn close(found: &Rows, expected: &Rows, tolerance: f64) {
        let size = |i: usize| expected[(i, i)].abs().sqrt();
        for i in 0..expected.nrows() {
            for k in 0..expected.ncols() {
                let off = (found[(i, k)] - expected[(i, k)]).abs() / (size(i) * size(k));
                assert!(off <= tolerance, "({i}, {k}): {} {}", found[(i, k)], expected[(i, k)]);
            }
        }
    }

    #[test]
    fn both_ways_to_a_factor_have_the_same_cross_products() {
        let rows = sample(5, 3, 0.3);
        let mut expected = gram(&rows);
        (0..3).for_each(|i| expected[(i, i)] += 1.0);
        for care in [Care::Plain, Care::Rotations] {
            let upper = identity_plus(&rows, care);
            close(&gram(&upper), &expected, 1e-14);
            assert!((0..3).all(|i| (0..i).all(|k| upper[(i, k)] == 0.0)), "{upper:?}");
        }
    }

    #[test]
    fn absorbing_rows_keeps_the_cross_products_and_tells_what_is_left() {
        let (own, below) = (sample(3, 5, 1.0), sample(4, 5, 2.0));
        for care in [Care::Plain, Care::Rotations] {
            let mut upper = Rows::zeros(3, 5);
            let left_first = absorb(&mut upper, own.clone(), 3, care);
            let left = absorb(&mut upper, below.clone(), 3, care);
            let found = gram(&upper).plus(&gram(&left)).plus(&gram(&left_first));
            close(&found, &gram(&own).plus(&gram(&below)), 1e-13);
            assert!((0..3).all(|i| upper[(i, i)] >= 0.0 && (0..i).all(|k| upper[(i, k)] == 0.0)), "{upper:?}");
        }
    }

    #[test]
    fn rotations_keep_small_rows_beside_huge_ones() {
        let rows = Rows::from_fn(1, 2, |_, _| 1e12);
        let upper = identity_plus(&rows, Care::Rotations);
        // |I + xx'| = 1 + |x|²
        let (found, expected) = (upper[(0, 0)] * upper[(1, 1)], (1.0 + 2e24_f64).sqrt());
        assert!((found / expected - 1.0).abs() < 1e-14, "{found} {expected}");
    }
}
