//! Small dense matrices by rows, for kernels that work on square roots: products, and triangular factors of sums of rows. One
//! source for every kind of [`Real`].

use std::marker::PhantomData;
use std::ops::{Index, IndexMut};

use nalgebra::DMatrix;

use kalfit_lanes::Real;

use crate::linalg::fold::Rotation;
use crate::linalg::products::{Absorb, Combine, IdentityPlus, SolveBelow, TimesTranspose};

/// A matrix by rows.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Rows<T = f64> {
    rows: usize,
    columns: usize,
    data: Vec<T>,
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
    #[inline(always)]
    pub(crate) fn zeros(rows: usize, columns: usize) -> Rows<T> {
        Rows { rows, columns, data: vec![T::splat(0.0); rows * columns] }
    }

    #[inline(always)]
    pub(crate) fn from_fn(rows: usize, columns: usize, entry: impl Fn(usize, usize) -> T) -> Rows<T> {
        let mut all = Rows::zeros(rows, columns);
        if columns > 0 {
            for (i, row) in all.data.chunks_exact_mut(columns).enumerate() {
                for (k, x) in row.iter_mut().enumerate() {
                    *x = entry(i, k);
                }
            }
        }
        all
    }

    #[inline(always)]
    pub(crate) fn identity(size: usize) -> Rows<T> {
        let mut identity = Rows::zeros(size, size);
        for i in 0..size {
            identity[(i, i)] = T::splat(1.0);
        }
        identity
    }

    #[inline(always)]
    pub(crate) fn nrows(&self) -> usize {
        self.rows
    }

    #[inline(always)]
    pub(crate) fn ncols(&self) -> usize {
        self.columns
    }

    #[inline(always)]
    pub(crate) fn as_slice(&self) -> &[T] {
        &self.data
    }

    /// A matrix of these numbers, by rows.
    #[inline(always)]
    pub(crate) fn from_vec(rows: usize, columns: usize, data: Vec<T>) -> Rows<T> {
        debug_assert_eq!(data.len(), rows * columns, "numbers of a matrix");
        Rows { rows, columns, data }
    }

    #[inline(always)]
    pub(crate) fn row(&self, i: usize) -> &[T] {
        &self.data[i * self.columns..][..self.columns]
    }

    #[inline(always)]
    pub(crate) fn row_mut(&mut self, i: usize) -> &mut [T] {
        &mut self.data[i * self.columns..][..self.columns]
    }

    /// The rows above one, and this one.
    #[inline(always)]
    pub(crate) fn rows_above_and(&mut self, i: usize) -> (&[T], &mut [T]) {
        let (above, rest) = self.data.split_at_mut(i * self.columns);
        (above, &mut rest[..self.columns])
    }

    /// Puts rows below.
    #[inline(always)]
    pub(crate) fn append(&mut self, below: &Rows<T>) {
        debug_assert_eq!(self.columns, below.columns, "one width");
        self.rows += below.rows;
        self.data.extend_from_slice(&below.data);
    }

    /// The first columns of it.
    #[inline(always)]
    pub(crate) fn first_columns(&self, columns: usize) -> Rows<T> {
        self.some_columns(0, columns)
    }

    /// The last columns of it.
    #[inline(always)]
    pub(crate) fn last_columns(&self, columns: usize) -> Rows<T> {
        self.some_columns(self.columns - columns, columns)
    }

    #[inline(always)]
    fn some_columns(&self, from: usize, columns: usize) -> Rows<T> {
        let mut some = Rows::zeros(self.rows, columns);
        for i in 0..self.rows {
            some.row_mut(i).copy_from_slice(&self.row(i)[from..from + columns]);
        }
        some
    }

    /// The first rows of it.
    #[inline(always)]
    pub(crate) fn first_rows(&self, rows: usize) -> Rows<T> {
        Rows { rows, columns: self.columns, data: self.data[..rows * self.columns].to_vec() }
    }

    /// [A B].
    #[inline(always)]
    pub(crate) fn beside(&self, other: &Rows<T>) -> Rows<T> {
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
    #[inline(always)]
    pub(crate) fn times(&self, other: &Rows<T>) -> Rows<T> {
        self.combined(other, (self.rows, self.columns, 1))
    }

    /// A'B.
    #[inline(always)]
    pub(crate) fn transpose_times(&self, other: &Rows<T>) -> Rows<T> {
        self.combined(other, (self.columns, 1, self.columns))
    }

    /// Σ_k a_ik × row k of the other for so many i; how far it is from an a to that of the next i and of the next k.
    #[inline(always)]
    fn combined(&self, other: &Rows<T>, (rows, down, along): (usize, usize, usize)) -> Rows<T> {
        let mut product = Rows::zeros(rows, other.columns);
        if other.rows > 0 {
            T::apart(Combine { a: &self.data, down, along, other, product: &mut product });
        }
        product
    }

    /// A'.
    #[inline(always)]
    pub(crate) fn transposed(&self) -> Rows<T> {
        let mut turned = Rows::zeros(self.columns, self.rows);
        for i in 0..self.rows {
            for (k, &x) in self.row(i).iter().enumerate() {
                turned[(k, i)] = x;
            }
        }
        turned
    }

    /// AB'.
    #[inline(always)]
    pub(crate) fn times_transpose(&self, other: &Rows<T>) -> Rows<T> {
        let mut product = Rows::zeros(self.rows, other.rows);
        T::apart(TimesTranspose { a: self, b: other, product: &mut product });
        product
    }

    /// A - B.
    #[inline(always)]
    pub(crate) fn less(mut self, other: &Rows<T>) -> Rows<T> {
        for (a, &b) in self.data.iter_mut().zip(&other.data) {
            *a = *a - b;
        }
        self
    }

    /// A + B.
    #[inline(always)]
    pub(crate) fn plus(mut self, other: &Rows<T>) -> Rows<T> {
        for (a, &b) in self.data.iter_mut().zip(&other.data) {
            *a = *a + b;
        }
        self
    }

    /// No entry is larger than this, or not a number.
    #[inline(always)]
    pub(crate) fn is_within(&self, bound: f64) -> bool {
        let bound = T::splat(bound);
        let mut within = true;
        for x in &self.data {
            within &= x.magnitude().at_most(bound);
        }
        within
    }

    /// U⁻ᵀB, U upper triangular.
    #[inline(always)]
    pub(crate) fn solved_below(upper: &Rows<T>, mut b: Rows<T>) -> Rows<T> {
        T::apart(SolveBelow { upper, b: &mut b });
        b
    }
}

/// How triangular factors are made.
pub(crate) trait Factors {
    /// Of what.
    type Number: Real;
    /// Rows of any size are borne.
    const CAREFUL: bool;

    /// U, upper triangular w × w, with U'U = I + rows'rows; rows any number × w. No diagonal element is below one.
    fn identity_plus(rows: &Rows<Self::Number>) -> Rows<Self::Number>;

    /// Folds rows into [R | d], R upper triangular (first `width` columns) with a diagonal that is not negative. What is left of
    /// the rows in the other columns is returned: R takes no part of it.
    fn absorb(upper: &mut Rows<Self::Number>, rows: Rows<Self::Number>, width: usize) -> Rows<Self::Number>;
}

/// From cross products and reflections: fast.
#[derive(Debug)]
pub(crate) struct Plain<T>(PhantomData<T>);

/// By plane rotations, row by row: rows of very different size do no harm.
#[derive(Debug)]
pub(crate) struct Rotations;

impl<T: Real> Factors for Plain<T> {
    type Number = T;
    const CAREFUL: bool = false;

    #[inline(always)]
    fn identity_plus(rows: &Rows<T>) -> Rows<T> {
        let mut upper = Rows::identity(rows.columns);
        T::apart(IdentityPlus { rows, upper: &mut upper });
        upper
    }

    #[inline(always)]
    fn absorb(upper: &mut Rows<T>, mut rows: Rows<T>, width: usize) -> Rows<T> {
        T::apart(Absorb { upper, rows: &mut rows, width });
        rows
    }
}

impl Factors for Rotations {
    type Number = f64;
    const CAREFUL: bool = true;

    fn identity_plus(rows: &Rows) -> Rows {
        let w = rows.columns;
        let mut upper = Rows::identity(w);
        Rotations::absorb(&mut upper, rows.clone(), w);
        (0..w).for_each(|i| upper[(i, i)] = upper[(i, i)].max(1.0)); // rounding must not make it less
        upper
    }

    fn absorb(upper: &mut Rows, mut rows: Rows, width: usize) -> Rows {
        for i in 0..rows.rows {
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
        rows
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
        let expected = gram(&rows).plus(&Rows::identity(3));
        for upper in [Plain::<f64>::identity_plus(&rows), Rotations::identity_plus(&rows)] {
            close(&gram(&upper), &expected, 1e-14);
            assert!((0..3).all(|i| (0..i).all(|k| upper[(i, k)] == 0.0)), "{upper:?}");
        }
    }

    fn absorbs<F: Factors<Number = f64>>() {
        let (own, below) = (sample(3, 5, 1.0), sample(4, 5, 2.0));
        let mut upper = Rows::zeros(3, 5);
        let left_first = F::absorb(&mut upper, own.clone(), 3);
        let left = F::absorb(&mut upper, below.clone(), 3);
        let found = gram(&upper).plus(&gram(&left)).plus(&gram(&left_first));
        close(&found, &gram(&own).plus(&gram(&below)), 1e-13);
        assert!((0..3).all(|i| upper[(i, i)] >= 0.0 && (0..i).all(|k| upper[(i, k)] == 0.0)), "{upper:?}");
    }

    #[test]
    fn absorbing_rows_keeps_the_cross_products_and_tells_what_is_left() {
        absorbs::<Plain<f64>>();
        absorbs::<Rotations>();
    }

    #[test]
    fn rows_of_zeros_change_nothing() {
        let mut upper = Rows::zeros(2, 3);
        let left = Plain::<f64>::absorb(&mut upper, Rows::zeros(2, 3), 2);
        assert_eq!((upper, left), (Rows::zeros(2, 3), Rows::zeros(2, 3)));
    }

    #[test]
    fn rotations_keep_small_rows_beside_huge_ones() {
        let rows = Rows::from_fn(1, 2, |_, _| 1e12);
        let upper = Rotations::identity_plus(&rows);
        // |I + xx'| = 1 + |x|²
        let (found, expected) = (upper[(0, 0)] * upper[(1, 1)], (1.0 + 2e24_f64).sqrt());
        assert!((found / expected - 1.0).abs() < 1e-14, "{found} {expected}");
    }
}
