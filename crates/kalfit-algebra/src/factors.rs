//! Triangular factors of sums of products rows'rows.

use std::marker::PhantomData;

use kalfit_lanes::{Lanes, Part, Real};

use crate::fold::fold_rows;
use crate::products::{Absorb, IdentityPlus};
use crate::rows::Rows;

/// A way to compute triangular factors.
pub trait Factors {
    /// Type of the elements.
    type Number: Real;
    /// Whether rows of any magnitude cost no digits.
    const ALLOWS_LARGE_ROWS: bool;

    /// U, upper triangular w × w, with U'U = I + rows'rows; `rows` m × w. No diagonal element is below one.
    fn identity_plus(rows: &Rows<Self::Number>) -> Rows<Self::Number>;

    /// Folds rows into [R | d], R upper triangular (first `width` columns) with a nonnegative diagonal. Returns `rows`,
    /// which hold the residuals of the data in the columns from `width` on.
    fn absorb(upper: &mut Rows<Self::Number>, rows: Rows<Self::Number>, width: usize) -> Rows<Self::Number>;
}

/// Factors from cross products and reflections: fast, but rows of large magnitude cost digits.
#[derive(Debug)]
pub struct CrossFactors<T>(PhantomData<T>);

/// Factors by plane rotations, row by row: rows of very different size cost no digits.
#[derive(Debug)]
pub struct Rotations<T = f64>(PhantomData<T>);

impl<T: Real> Factors for CrossFactors<T> {
    type Number = T;
    const ALLOWS_LARGE_ROWS: bool = false;

    #[inline(always)]
    fn identity_plus(rows: &Rows<T>) -> Rows<T> {
        let mut upper = Rows::identity(rows.ncols());
        T::apart(IdentityPlus { rows, upper: &mut upper });
        upper
    }

    #[inline(always)]
    fn absorb(upper: &mut Rows<T>, mut rows: Rows<T>, width: usize) -> Rows<T> {
        T::apart(Absorb { upper, rows: &mut rows, width });
        rows
    }
}

impl<T: Lanes> Factors for Rotations<T> {
    type Number = T;
    const ALLOWS_LARGE_ROWS: bool = true;

    #[inline(always)]
    fn identity_plus(rows: &Rows<T>) -> Rows<T> {
        let w = rows.ncols();
        let mut upper = Rows::identity(w);
        Rotations::absorb(&mut upper, rows.clone(), w);
        for i in 0..w {
            upper[(i, i)] = upper[(i, i)].maximum(T::splat(1.0)); // rounding must not make the diagonal less than one
        }
        upper
    }

    #[inline(always)]
    fn absorb(upper: &mut Rows<T>, mut rows: Rows<T>, width: usize) -> Rows<T> {
        T::apart(Fold { upper, rows: &mut rows, width });
        rows
    }
}

/// [`fold_rows`] compiled as a separate function.
struct Fold<'a, T> {
    upper: &'a mut Rows<T>,
    rows: &'a mut Rows<T>,
    width: usize,
}

impl<T: Lanes> Part for Fold<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let columns = self.upper.columns;
        if self.rows.rows > 0 {
            fold_rows(&mut self.upper.data, &mut self.rows.data, (self.width, columns));
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
        let expected = gram(&rows).plus(&Rows::identity(3));
        for upper in [CrossFactors::<f64>::identity_plus(&rows), Rotations::<f64>::identity_plus(&rows)] {
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
        absorbs::<CrossFactors<f64>>();
        absorbs::<Rotations>();
    }

    #[test]
    fn rows_of_zeros_change_nothing() {
        let mut upper = Rows::zeros(2, 3);
        let left = CrossFactors::<f64>::absorb(&mut upper, Rows::zeros(2, 3), 2);
        assert_eq!((upper, left), (Rows::zeros(2, 3), Rows::zeros(2, 3)));
    }

    #[test]
    fn rotations_keep_small_rows_beside_huge_ones() {
        let rows = Rows::from_fn(1, 2, |_, _| 1e12);
        let upper = Rotations::<f64>::identity_plus(&rows);
        // |I + xx'| = 1 + |x|²
        let (found, expected) = (upper[(0, 0)] * upper[(1, 1)], (1.0 + 2e24_f64).sqrt());
        assert!((found / expected - 1.0).abs() < 1e-14, "{found} {expected}");
    }
}
