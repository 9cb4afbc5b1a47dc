//! Small matrices of tests in lanes, of a size that the compiler knows, so that rows stay in registers and loops are
//! unrolled. Each operation is compiled as a separate function for each size and kind of number.

use std::marker::PhantomData;
use std::ops::Range;

use kalfit_lanes::{Part, Real};
use nalgebra::DMatrix;

use crate::algebra::{Algebra, MAX_CROSS_PRODUCT};
use crate::rows::Rows;

/// N × N matrix, row-major.
pub(crate) type Square<T, const N: usize> = [[T; N]; N];

/// Matrices of up to N rows and columns, with data in one column.
#[derive(Debug)]
pub struct Fixed<T, const N: usize>(PhantomData<T>);

/// U = D^½L' with LDL' = I + Σ A'A.
#[derive(Debug, Clone, Copy)]
pub struct Pivoted<T, const N: usize> {
    /// L', unit upper triangular; entries on and below the diagonal are not used.
    unit: Square<T, N>,
    /// D^½.
    root: [T; N],
    /// D^-½.
    inverse: [T; N],
}

impl<T: Real, const N: usize> Pivoted<T, N> {
    /// The factor of a given U, N × N, upper triangular.
    #[inline(always)]
    fn of(upper: Square<T, N>) -> Pivoted<T, N> {
        let mut factor = Pivoted { unit: upper, root: [T::splat(0.0); N], inverse: [T::splat(0.0); N] };
        for k in 0..N {
            factor.root[k] = upper[k][k];
            factor.inverse[k] = T::splat(1.0) / upper[k][k];
            for j in k + 1..N {
                factor.unit[k][j] = upper[k][j] * factor.inverse[k];
            }
        }
        factor
    }
}

impl<T: Real, const N: usize> Algebra for Fixed<T, N> {
    type Number = T;
    type Matrix = Square<T, N>;
    type Data = [T; N];
    type Factor = Pivoted<T, N>;

    #[inline(always)]
    fn zeros(_: usize, _: usize) -> Square<T, N> {
        [[T::splat(0.0); N]; N]
    }

    #[inline(always)]
    fn row_mut(a: &mut Square<T, N>, i: usize) -> &mut [T] {
        &mut a[i]
    }

    #[inline(always)]
    fn zero_data(_: usize, _: usize) -> [T; N] {
        [T::splat(0.0); N]
    }

    #[inline(always)]
    fn data_row_mut(data: &mut [T; N], i: usize) -> &mut [T] {
        std::slice::from_mut(&mut data[i])
    }

    #[inline(always)]
    fn identity_plus(parts: &[&Square<T, N>], keeps_digits: &mut bool) -> Pivoted<T, N> {
        T::apart(IdentityPlus { parts, keeps_digits })
    }

    #[inline(always)]
    fn diagonal(factor: &Pivoted<T, N>) -> impl Iterator<Item = T> {
        factor.root.into_iter()
    }

    #[inline(always)]
    fn solved(factor: &Pivoted<T, N>, mut a: Square<T, N>) -> Square<T, N> {
        T::apart(Solve(factor, &mut a));
        a
    }

    #[inline(always)]
    fn solved_data(factor: &Pivoted<T, N>, mut data: [T; N]) -> [T; N] {
        for i in 0..N {
            for k in 0..i {
                data[i] = factor.unit[k][i].fnma(data[k], data[i]);
            }
        }
        for i in 0..N {
            data[i] = data[i] * factor.inverse[i];
        }
        data
    }

    #[inline(always)]
    fn absorb(upper: &mut Square<T, N>, data: &mut [T; N], mut rows: Square<T, N>, mut rows_data: [T; N]) -> [T; N] {
        T::apart(Absorb { upper, data, rows: &mut rows, rows_data: &mut rows_data });
        rows_data
    }

    #[inline(always)]
    fn identity_absorbing(rows: Square<T, N>, rows_data: [T; N]) -> (Pivoted<T, N>, [T; N]) {
        let (mut upper, mut data) = (Self::identity_less(&Self::zeros(N, N)), [T::splat(0.0); N]);
        Self::absorb(&mut upper, &mut data, rows, rows_data);
        (Pivoted::of(upper), data)
    }

    #[inline(always)]
    fn absorb_rows(upper: &mut Square<T, N>, mut rows: Square<T, N>) {
        let (mut data, mut rows_data) = ([T::splat(0.0); N], [T::splat(0.0); N]);
        T::apart(Absorb { upper, data: &mut data, rows: &mut rows, rows_data: &mut rows_data });
    }

    #[inline(always)]
    fn transposed(a: &Square<T, N>) -> Square<T, N> {
        let mut turned = *a;
        for i in 0..N {
            for k in 0..N {
                turned[i][k] = a[k][i];
            }
        }
        turned
    }

    #[inline(always)]
    fn times(a: &Square<T, N>, b: &Square<T, N>) -> Square<T, N> {
        T::apart(Product::<T, N, false, false>(a, b))
    }

    #[inline(always)]
    fn transpose_times(a: &Square<T, N>, b: &Square<T, N>) -> Square<T, N> {
        T::apart(Product::<T, N, true, false>(a, b))
    }

    #[inline(always)]
    fn times_upper_transpose(a: &Square<T, N>, upper: &Square<T, N>) -> Square<T, N> {
        T::apart(TimesUpperTranspose(a, upper))
    }

    #[inline(always)]
    fn times_transpose(a: &Square<T, N>, b: &Square<T, N>) -> Square<T, N> {
        T::apart(Product::<T, N, false, true>(a, b))
    }

    #[inline(always)]
    fn identity_less(a: &Square<T, N>) -> Square<T, N> {
        let mut less = *a;
        for i in 0..N {
            for k in 0..N {
                less[i][k] = T::splat(if i == k { 1.0 } else { 0.0 }) - a[i][k];
            }
        }
        less
    }

    #[inline(always)]
    fn apply(a: &Square<T, N>, data: &[T; N]) -> [T; N] {
        let mut product = [T::splat(0.0); N];
        for k in 0..N {
            for i in 0..N {
                product[i] = a[i][k].fma(data[k], product[i]);
            }
        }
        product
    }

    #[inline(always)]
    fn apply_transpose(a: &Square<T, N>, data: &[T; N]) -> [T; N] {
        let mut product = [T::splat(0.0); N];
        for k in 0..N {
            for i in 0..N {
                product[i] = a[k][i].fma(data[k], product[i]);
            }
        }
        product
    }

    #[inline(always)]
    fn plus(mut a: [T; N], b: &[T; N]) -> [T; N] {
        for i in 0..N {
            a[i] = a[i] + b[i];
        }
        a
    }

    #[inline(always)]
    fn less(mut a: [T; N], b: &[T; N]) -> [T; N] {
        for i in 0..N {
            a[i] = a[i] - b[i];
        }
        a
    }

    #[inline(always)]
    fn squares(count: T, data: &[T; N]) -> T {
        let mut sum = T::splat(0.0);
        for i in 0..N {
            sum = data[i].fma(data[i], sum);
        }
        count * sum
    }

    #[inline(always)]
    fn phase_root(root: &DMatrix<f64>, phase_states: &Range<usize>, _: &Square<T, N>) -> Square<T, N> {
        let mut rows = [[T::splat(0.0); N]; N];
        for c in 0..phase_states.len() {
            for i in c..phase_states.len() {
                rows[c][i] = T::splat(root[(phase_states.start + i, phase_states.start + c)]);
            }
        }
        rows
    }

    #[inline(always)]
    fn mean_of(mean: &[T], phase_states: &Range<usize>, _: &[T; N]) -> [T; N] {
        let mut column = [T::splat(0.0); N];
        column[..phase_states.len()].copy_from_slice(&mean[phase_states.clone()]);
        column
    }

    #[inline(always)]
    fn leading_block(a: &Square<T, N>, rows: usize, columns: usize) -> Rows<T> {
        if rows == N && columns == N {
            return Rows::from_vec(N, N, a.as_flattened().to_vec());
        }
        let mut block = Vec::with_capacity(rows * columns);
        for row in &a[..rows] {
            block.extend_from_slice(&row[..columns]);
        }
        Rows::from_vec(rows, columns, block)
    }

    #[inline(always)]
    fn head(data: &[T; N], rows: usize) -> Rows<T> {
        Rows::from_vec(rows, 1, data[..rows].to_vec())
    }
}

/// Work on row or column K of matrices, with K known to the compiler, which then also knows the numbers of rows and
/// columns before K and after K.
trait UnrolledWork {
    fn work_at<const K: usize>(&mut self);
}

/// Largest size N of matrices in this module.
const MAX_SIZE: usize = 8;

/// Does the work for K = 0, 1, …, N - 1, without a loop.
#[inline(always)]
fn unrolled<const N: usize>(work: &mut impl UnrolledWork) {
    const { assert!(N <= MAX_SIZE, "sizes have a rank each below") };
    if N > 0 {
        work.work_at::<0>();
    }
    if N > 1 {
        work.work_at::<1>();
    }
    if N > 2 {
        work.work_at::<2>();
    }
    if N > 3 {
        work.work_at::<3>();
    }
    if N > 4 {
        work.work_at::<4>();
    }
    if N > 5 {
        work.work_at::<5>();
    }
    if N > 6 {
        work.work_at::<6>();
    }
    if N > 7 {
        work.work_at::<7>();
    }
}

struct IdentityPlus<'a, T, const N: usize> {
    parts: &'a [&'a Square<T, N>],
    keeps_digits: &'a mut bool,
}

impl<T: Real, const N: usize> Part for IdentityPlus<'_, T, N> {
    type Output = Pivoted<T, N>;

    #[inline(always)]
    fn run(self) -> Pivoted<T, N> {
        let (zero, one) = (T::splat(0.0), T::splat(1.0));
        let mut factor = Pivoted { unit: [[zero; N]; N], root: [one; N], inverse: [one; N] };
        let mut scaled = [[zero; N]; N];
        let mut rows = PivotedRows { parts: self.parts, scaled: &mut scaled, factor: &mut factor, largest: one };
        unrolled::<N>(&mut rows);
        *self.keeps_digits &= rows.largest.at_most(T::splat(MAX_CROSS_PRODUCT));
        for k in 0..N {
            let pivot = factor.root[k];
            factor.inverse[k] = pivot.recip_root();
            factor.root[k] = pivot * factor.inverse[k];
        }
        factor
    }
}

/// Factorisation LDL', computed row by row of DL'.
struct PivotedRows<'a, T, const N: usize> {
    parts: &'a [&'a Square<T, N>],
    /// DL'.
    scaled: &'a mut Square<T, N>,
    /// L' in `unit` and, instead of D^½, D in `root`.
    factor: &'a mut Pivoted<T, N>,
    /// Largest diagonal element of I + Σ A'A so far.
    largest: T,
}

impl<T: Real, const N: usize> UnrolledWork for PivotedRows<'_, T, N> {
    #[inline(always)]
    fn work_at<const K: usize>(&mut self) {
        let one = T::splat(1.0);
        let mut row = [T::splat(0.0); N];
        row[K] = one;
        for part in self.parts {
            for i in 0..N {
                for j in K..N {
                    row[j] = part[i][K].fma(part[i][j], row[j]);
                }
            }
        }
        self.largest = self.largest.maximum(row[K]);
        for i in 0..K {
            for j in K..N {
                row[j] = self.factor.unit[i][K].fnma(self.scaled[i][j], row[j]);
            }
        }
        let pivot = row[K].maximum(one); // rounding must not make the pivot less than one
        let inverse_pivot = pivot.recip();
        self.factor.root[K] = pivot;
        for j in K + 1..N {
            self.scaled[K][j] = row[j];
            self.factor.unit[K][j] = row[j] * inverse_pivot;
        }
    }
}

struct Solve<'a, T, const N: usize>(&'a Pivoted<T, N>, &'a mut Square<T, N>);

impl<T: Real, const N: usize> Part for Solve<'_, T, N> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        unrolled::<N>(&mut self);
        for i in 0..N {
            for j in 0..N {
                self.1[i][j] = self.1[i][j] * self.0.inverse[i];
            }
        }
    }
}

impl<T: Real, const N: usize> UnrolledWork for Solve<'_, T, N> {
    #[inline(always)]
    fn work_at<const K: usize>(&mut self) {
        let mut row = self.1[K];
        for i in 0..K {
            for j in 0..N {
                row[j] = self.0.unit[i][K].fnma(self.1[i][j], row[j]);
            }
        }
        self.1[K] = row;
    }
}

struct Absorb<'a, T, const N: usize> {
    upper: &'a mut Square<T, N>,
    data: &'a mut [T; N],
    rows: &'a mut Square<T, N>,
    rows_data: &'a mut [T; N],
}

impl<T: Real, const N: usize> Part for Absorb<'_, T, N> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        unrolled::<N>(&mut self);
    }
}

impl<T: Real, const N: usize> UnrolledWork for Absorb<'_, T, N> {
    /// Applies the Householder reflection that takes column K of the rows into row K of the triangle.
    #[inline(always)]
    fn work_at<const K: usize>(&mut self) {
        let Absorb { upper, data, rows, rows_data } = self;
        let (row, zero) = (&mut upper[K], T::splat(0.0));
        let mut column = [zero; N];
        let mut square = row[K] * row[K];
        for i in 0..N {
            column[i] = rows[i][K];
            square = column[i].fma(column[i], square);
        }
        let length = square.root();
        // the head is not negative, so the reflection to -length cancels no digits; the row's sign is flipped
        // afterwards
        let first = row[K] + length;
        let scale = (length * first).recip_or_zero();
        let (mut projection, mut projection_data) = ([zero; N], first * data[K]);
        for j in K + 1..N {
            projection[j] = first * row[j];
        }
        for i in 0..N {
            for j in K + 1..N {
                projection[j] = column[i].fma(rows[i][j], projection[j]);
            }
            projection_data = column[i].fma(rows_data[i], projection_data);
        }
        for j in K + 1..N {
            projection[j] = projection[j] * scale;
            row[j] = first * projection[j] - row[j];
        }
        projection_data = projection_data * scale;
        data[K] = first * projection_data - data[K];
        for i in 0..N {
            for j in K + 1..N {
                rows[i][j] = column[i].fnma(projection[j], rows[i][j]);
            }
            rows_data[i] = column[i].fnma(projection_data, rows_data[i]);
        }
        row[K] = length;
    }
}

/// AB, with A' for A if `TRANSPOSE_A`, and with B' for B if `TRANSPOSE_B`.
struct Product<'a, T, const N: usize, const TRANSPOSE_A: bool, const TRANSPOSE_B: bool>(
    &'a Square<T, N>,
    &'a Square<T, N>,
);

impl<T: Real, const N: usize, const TRANSPOSE_A: bool, const TRANSPOSE_B: bool> Part
    for Product<'_, T, N, TRANSPOSE_A, TRANSPOSE_B>
{
    type Output = Square<T, N>;

    #[inline(always)]
    fn run(self) -> Square<T, N> {
        let Product(a, b) = self;
        let mut product = [[T::splat(0.0); N]; N];
        for i in 0..N {
            let mut row = [T::splat(0.0); N];
            for k in 0..N {
                let a = if TRANSPOSE_A { a[k][i] } else { a[i][k] };
                for j in 0..N {
                    row[j] = a.fma(if TRANSPOSE_B { b[j][k] } else { b[k][j] }, row[j]);
                }
            }
            product[i] = row;
        }
        product
    }
}

struct TimesUpperTranspose<'a, T, const N: usize>(&'a Square<T, N>, &'a Square<T, N>);

impl<T: Real, const N: usize> Part for TimesUpperTranspose<'_, T, N> {
    type Output = Square<T, N>;

    #[inline(always)]
    fn run(self) -> Square<T, N> {
        let mut product = [[T::splat(0.0); N]; N];
        unrolled::<N>(&mut UpperColumns { a: self.0, upper: self.1, product: &mut product });
        product
    }
}

/// AU', U upper triangular, column by column.
struct UpperColumns<'a, T, const N: usize> {
    a: &'a Square<T, N>,
    upper: &'a Square<T, N>,
    product: &'a mut Square<T, N>,
}

impl<T: Real, const N: usize> UnrolledWork for UpperColumns<'_, T, N> {
    #[inline(always)]
    fn work_at<const K: usize>(&mut self) {
        let mut column = [T::splat(0.0); N];
        for k in K..N {
            for i in 0..N {
                column[i] = self.a[i][k].fma(self.upper[K][k], column[i]);
            }
        }
        for i in 0..N {
            self.product[i][K] = column[i];
        }
    }
}
