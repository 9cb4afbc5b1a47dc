//! Products, triangular solutions and triangular factors of row-major matrices, each compiled as a separate function
//! for every kind of number.

use kalfit_lanes::{Part, Real};

use crate::parts::{Dots, Reflection, Sum, by_column_blocks};
use crate::rows::Rows;

impl<T: Real> Rows<T> {
    /// AB.
    #[inline(always)]
    pub fn times(&self, other: &Rows<T>) -> Rows<T> {
        self.combined(other, (self.rows, self.columns, 1))
    }

    /// A'B.
    #[inline(always)]
    pub fn transpose_times(&self, other: &Rows<T>) -> Rows<T> {
        self.combined(other, (self.columns, 1, self.columns))
    }

    /// Matrix of `rows` rows with row i = Σ_k a_ik × row k of `other`; a_ik is element i × `row_stride` + k ×
    /// `term_stride` of `self.data`.
    #[inline(always)]
    fn combined(&self, other: &Rows<T>, (rows, row_stride, term_stride): (usize, usize, usize)) -> Rows<T> {
        let mut product = Rows::zeros(rows, other.columns);
        if other.rows > 0 {
            T::apart(Combine { a: &self.data, row_stride, term_stride, other, product: &mut product });
        }
        product
    }

    /// AB'.
    #[inline(always)]
    pub fn times_transpose(&self, other: &Rows<T>) -> Rows<T> {
        let mut product = Rows::zeros(self.rows, other.rows);
        T::apart(TimesTranspose { a: self, b: other, product: &mut product });
        product
    }

    /// U⁻ᵀB, U upper triangular.
    #[inline(always)]
    pub fn solved_transposed(upper: &Rows<T>, mut b: Rows<T>) -> Rows<T> {
        T::apart(ForwardSubstitution { upper, b: &mut b });
        b
    }
}

/// Row i of `product` ← Σ_k a_ik × row k of `other`; a_ik is element i × `row_stride` + k × `term_stride` of `a`.
struct Combine<'a, T> {
    a: &'a [T],
    row_stride: usize,
    term_stride: usize,
    other: &'a Rows<T>,
    product: &'a mut Rows<T>,
}

impl<T: Real> Part for Combine<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for i in 0..self.product.nrows() {
            let (a, x) = ((&self.a[i * self.row_stride..], self.term_stride), self.other.as_slice());
            by_column_blocks(0, &mut Sum::<T, false> { y: self.product.row_mut(i), a, x, count: self.other.nrows() });
        }
    }
}

struct TimesTranspose<'a, T> {
    a: &'a Rows<T>,
    b: &'a Rows<T>,
    product: &'a mut Rows<T>,
}

impl<T: Real> Part for TimesTranspose<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for i in 0..self.a.nrows() {
            by_column_blocks(0, &mut Dots { y: self.product.row_mut(i), x: self.a.row(i), rows: self.b });
        }
    }
}

struct ForwardSubstitution<'a, T> {
    upper: &'a Rows<T>,
    b: &'a mut Rows<T>,
}

impl<T: Real> Part for ForwardSubstitution<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let ForwardSubstitution { upper, b } = self;
        for i in 0..b.nrows() {
            let (rows_above, row) = b.split_at_row(i);
            let a = (&upper.as_slice()[i..], upper.ncols());
            by_column_blocks(0, &mut Sum::<T, true> { y: row, a, x: rows_above, count: i });
            let inverse = T::splat(1.0) / upper[(i, i)];
            for x in row.iter_mut() {
                *x = *x * inverse;
            }
        }
    }
}

pub(super) struct IdentityPlus<'a, T> {
    pub(super) rows: &'a Rows<T>,
    pub(super) upper: &'a mut Rows<T>,
}

impl<T: Real> Part for IdentityPlus<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let IdentityPlus { rows, upper } = self;
        let w = rows.ncols();
        for i in 0..w {
            let (rows_above, pivot_row) = upper.split_at_row(i);
            if rows.nrows() > 0 {
                let (a, x) = ((&rows.as_slice()[i..], w), rows.as_slice());
                by_column_blocks(i, &mut Sum::<T, false> { y: pivot_row, a, x, count: rows.nrows() });
            }
            if i > 0 {
                by_column_blocks(
                    i,
                    &mut Sum::<T, true> { y: pivot_row, a: (&rows_above[i..], w), x: rows_above, count: i },
                );
            }
            let pivot = pivot_row[i].maximum(T::splat(1.0)).root(); // rounding must not make the pivot less than one
            let inverse = T::splat(1.0) / pivot;
            pivot_row[i] = pivot;
            for x in &mut pivot_row[i + 1..] {
                *x = *x * inverse;
            }
        }
    }
}

pub(super) struct Absorb<'a, T> {
    pub(super) upper: &'a mut Rows<T>,
    pub(super) rows: &'a mut Rows<T>,
    pub(super) width: usize,
}

impl<T: Real> Part for Absorb<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for k in 0..self.width {
            reflect(self.upper, self.rows, k);
        }
    }
}

/// Applies the Householder reflection that takes column k of the rows into row k of the triangle.
#[inline(always)]
fn reflect<T: Real>(upper: &mut Rows<T>, rows: &mut Rows<T>, k: usize) {
    let head = upper[(k, k)];
    let mut square = head * head;
    for i in 0..rows.nrows() {
        square = rows[(i, k)].fma(rows[(i, k)], square);
    }
    let length = square.root();
    // head ≥ 0, so the reflection to -length cancels no digits; the row's sign is flipped afterwards
    let first = head + length;
    let scale = (length * first).recip_or_zero();
    by_column_blocks(k + 1, &mut Reflection { upper: upper.row_mut(k), rows, column: k, first, scale });
    for i in 0..rows.nrows() {
        rows[(i, k)] = T::splat(0.0);
    }
    upper[(k, k)] = length;
}
