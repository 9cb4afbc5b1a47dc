//! Matrix operations of the recursions over phases, written once for two kinds of storage: rows of any size
//! (`crate::linalg::rows`) and arrays of a size that the compiler knows (`crate::linalg::fixed`).

use std::ops::Range;

use kalfit_lanes::Real;
use nalgebra::DMatrix;

use crate::factors::Factors;
use crate::rows::Rows;

/// Operations on q × q matrices and on data of q rows. The storage may hold more than q rows and columns; rows and
/// columns beyond q are zero.
pub trait Algebra {
    /// Type of the elements.
    type Number: Real;
    /// Type of a matrix, q × q, or m × q with any m.
    type Matrix: Clone;
    /// Type of the data, q × columns.
    type Data: Clone;
    /// Type of a factor U, q × q, upper triangular.
    type Factor;

    /// A matrix of zeros, rows × columns.
    fn zeros(rows: usize, columns: usize) -> Self::Matrix;
    /// Row `i` of `a`, for writing.
    fn row_mut(a: &mut Self::Matrix, i: usize) -> &mut [Self::Number];
    /// Data of zeros, rows × columns.
    fn zero_data(rows: usize, columns: usize) -> Self::Data;
    /// Row `i` of the data, for writing.
    fn data_row_mut(data: &mut Self::Data, i: usize) -> &mut [Self::Number];

    /// U with U'U = I + Σ A'A over the matrices A of `parts`. `keeps_digits` becomes false where cross products would
    /// lose digits.
    fn identity_plus(parts: &[&Self::Matrix], keeps_digits: &mut bool) -> Self::Factor;
    /// Diagonal elements u_ii of U, |U| = Π u_ii.
    fn diagonal(factor: &Self::Factor) -> impl Iterator<Item = Self::Number>;
    /// U⁻ᵀA.
    fn solved(factor: &Self::Factor, a: Self::Matrix) -> Self::Matrix;
    /// U⁻ᵀd.
    fn solved_data(factor: &Self::Factor, data: Self::Data) -> Self::Data;
    /// Folds [A | b] (`rows`, `rows_data`) into [R | d] (`upper`, `data`), R upper triangular with a nonnegative
    /// diagonal; returns the residual of b.
    fn absorb(upper: &mut Self::Matrix, data: &mut Self::Data, rows: Self::Matrix, rows_data: Self::Data)
    -> Self::Data;
    /// U with U'U = I + A'A, and U⁻ᵀA'd, by folding [A | d] into [I | 0]: no digits are lost, however large A is.
    fn identity_absorbing(rows: Self::Matrix, rows_data: Self::Data) -> (Self::Factor, Self::Data);
    /// Folds A (`rows`) into R (`upper`), upper triangular: R'R grows by A'A.
    fn absorb_rows(upper: &mut Self::Matrix, rows: Self::Matrix);

    /// A'.
    fn transposed(a: &Self::Matrix) -> Self::Matrix;
    /// AB.
    fn times(a: &Self::Matrix, b: &Self::Matrix) -> Self::Matrix;
    /// A'B.
    fn transpose_times(a: &Self::Matrix, b: &Self::Matrix) -> Self::Matrix;
    /// AU', U upper triangular.
    fn times_upper_transpose(a: &Self::Matrix, upper: &Self::Matrix) -> Self::Matrix;
    /// AB'.
    fn times_transpose(a: &Self::Matrix, b: &Self::Matrix) -> Self::Matrix;
    /// I - A, A q × q.
    fn identity_less(a: &Self::Matrix) -> Self::Matrix;
    /// Ad.
    fn apply(a: &Self::Matrix, data: &Self::Data) -> Self::Data;
    /// A'd.
    fn apply_transpose(a: &Self::Matrix, data: &Self::Data) -> Self::Data;
    /// a + b.
    fn plus(a: Self::Data, b: &Self::Data) -> Self::Data;
    /// a - b.
    fn less(a: Self::Data, b: &Self::Data) -> Self::Data;
    /// Σ w_k d_ik² over the data, with w_0 = `count` for the first column, which is a mean over `count` tests, and w_k = 1
    /// for all other columns.
    fn squares(count: Self::Number, data: &Self::Data) -> Self::Number;

    /// F' of a phase, q × q, with F the rows and columns `phase_states` of `root`, lower triangular with a nonnegative
    /// diagonal. The result has as many columns as `like`.
    fn phase_root(root: &DMatrix<f64>, phase_states: &Range<usize>, like: &Self::Matrix) -> Self::Matrix;
    /// Data of the shape of `like`, zero but for the elements `phase_states` of `mean` in the first column.
    fn mean_of(mean: &[Self::Number], phase_states: &Range<usize>, like: &Self::Data) -> Self::Data;
    /// The first `rows` rows and `columns` columns of `a`.
    fn leading_block(a: &Self::Matrix, rows: usize, columns: usize) -> Rows<Self::Number>;
    /// The first `rows` rows of the data.
    fn head(data: &Self::Data, rows: usize) -> Rows<Self::Number>;
}

/// Largest element of A'A for which cross products are used; larger elements would cost digits of I + A'A.
pub(crate) const MAX_CROSS_PRODUCT: f64 = 1e10;

impl<F: Factors> Algebra for F {
    type Number = F::Number;
    type Matrix = Rows<F::Number>;
    type Data = Rows<F::Number>;
    type Factor = Rows<F::Number>;

    #[inline(always)]
    fn zeros(rows: usize, columns: usize) -> Self::Matrix {
        Rows::zeros(rows, columns)
    }

    #[inline(always)]
    fn row_mut(a: &mut Self::Matrix, i: usize) -> &mut [Self::Number] {
        a.row_mut(i)
    }

    #[inline(always)]
    fn zero_data(rows: usize, columns: usize) -> Self::Data {
        Rows::zeros(rows, columns)
    }

    #[inline(always)]
    fn data_row_mut(data: &mut Self::Data, i: usize) -> &mut [Self::Number] {
        data.row_mut(i)
    }

    #[inline(always)]
    fn identity_plus(parts: &[&Self::Matrix], keeps_digits: &mut bool) -> Self::Factor {
        for part in parts {
            *keeps_digits &= F::ALLOWS_LARGE_ROWS || part.is_within(MAX_CROSS_PRODUCT.sqrt());
        }
        if let [only] = parts {
            return <F as Factors>::identity_plus(only);
        }
        let mut all = Rows::zeros(0, parts.first().map_or(0, |part| part.ncols()));
        for part in parts {
            all.append(part);
        }
        <F as Factors>::identity_plus(&all)
    }

    #[inline(always)]
    fn diagonal(factor: &Self::Factor) -> impl Iterator<Item = Self::Number> {
        (0..factor.nrows()).map(|i| factor[(i, i)])
    }

    #[inline(always)]
    fn solved(factor: &Self::Factor, a: Self::Matrix) -> Self::Matrix {
        Rows::solved_transposed(factor, a)
    }

    #[inline(always)]
    fn solved_data(factor: &Self::Factor, data: Self::Data) -> Self::Data {
        Rows::solved_transposed(factor, data)
    }

    #[inline(always)]
    fn absorb(
        upper: &mut Self::Matrix,
        data: &mut Self::Data,
        rows: Self::Matrix,
        rows_data: Self::Data,
    ) -> Self::Data {
        let (q, columns) = (upper.nrows(), data.ncols());
        let mut joined = upper.joined_columns(data);
        let folded_rows = <F as Factors>::absorb(&mut joined, rows.joined_columns(&rows_data), q);
        *upper = joined.first_columns(q);
        *data = joined.last_columns(columns);
        folded_rows.last_columns(columns)
    }

    #[inline(always)]
    fn identity_absorbing(rows: Self::Matrix, rows_data: Self::Data) -> (Self::Factor, Self::Data) {
        let (mut upper, mut data) = (Rows::identity(rows.ncols()), Rows::zeros(rows.ncols(), rows_data.ncols()));
        <F as Algebra>::absorb(&mut upper, &mut data, rows, rows_data);
        (upper, data)
    }

    #[inline(always)]
    fn absorb_rows(upper: &mut Self::Matrix, rows: Self::Matrix) {
        let width = upper.nrows();
        <F as Factors>::absorb(upper, rows, width);
    }

    #[inline(always)]
    fn transposed(a: &Self::Matrix) -> Self::Matrix {
        a.transposed()
    }

    #[inline(always)]
    fn times(a: &Self::Matrix, b: &Self::Matrix) -> Self::Matrix {
        a.times(b)
    }

    #[inline(always)]
    fn transpose_times(a: &Self::Matrix, b: &Self::Matrix) -> Self::Matrix {
        a.transpose_times(b)
    }

    #[inline(always)]
    fn times_upper_transpose(a: &Self::Matrix, upper: &Self::Matrix) -> Self::Matrix {
        a.times_transpose(upper)
    }

    #[inline(always)]
    fn times_transpose(a: &Self::Matrix, b: &Self::Matrix) -> Self::Matrix {
        a.times_transpose(b)
    }

    #[inline(always)]
    fn identity_less(a: &Self::Matrix) -> Self::Matrix {
        Rows::identity(a.nrows()).less(a)
    }

    #[inline(always)]
    fn apply(a: &Self::Matrix, data: &Self::Data) -> Self::Data {
        a.times(data)
    }

    #[inline(always)]
    fn apply_transpose(a: &Self::Matrix, data: &Self::Data) -> Self::Data {
        a.transpose_times(data)
    }

    #[inline(always)]
    fn plus(a: Self::Data, b: &Self::Data) -> Self::Data {
        a.plus(b)
    }

    #[inline(always)]
    fn less(a: Self::Data, b: &Self::Data) -> Self::Data {
        a.less(b)
    }

    #[inline(always)]
    fn squares(count: Self::Number, data: &Self::Data) -> Self::Number {
        let mut sum = F::Number::splat(0.0);
        for i in 0..data.nrows() {
            for (k, &x) in data.row(i).iter().enumerate() {
                sum = if k == 0 { (count * x).fma(x, sum) } else { x.fma(x, sum) };
            }
        }
        sum
    }

    #[inline(always)]
    fn phase_root(root: &DMatrix<f64>, phase_states: &Range<usize>, like: &Self::Matrix) -> Self::Matrix {
        let mut rows = Rows::zeros(like.ncols(), like.ncols());
        for c in 0..phase_states.len() {
            for i in c..phase_states.len() {
                rows[(c, i)] = F::Number::splat(root[(phase_states.start + i, phase_states.start + c)]);
            }
        }
        rows
    }

    #[inline(always)]
    fn mean_of(mean: &[Self::Number], phase_states: &Range<usize>, like: &Self::Data) -> Self::Data {
        let mut column = Rows::zeros(like.nrows(), like.ncols());
        for (i, phase_states) in phase_states.clone().enumerate() {
            column[(i, 0)] = mean[phase_states];
        }
        column
    }

    #[inline(always)]
    fn leading_block(a: &Self::Matrix, rows: usize, columns: usize) -> Rows<Self::Number> {
        a.first_rows(rows).first_columns(columns)
    }

    #[inline(always)]
    fn head(data: &Self::Data, rows: usize) -> Rows<Self::Number> {
        data.first_rows(rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::factors::{CrossFactors, Rotations};

    /// Beyond elements of 10⁵, cross products lose digits of I in I + A'A; rotations lose no digits.
    #[test]
    fn what_is_too_large_for_cross_products_is_said() {
        for (size, sound) in [(0.99e5, true), (1.01e5, false), (1e9, false)] {
            let small = Rows::from_fn(2, 2, |i, k| 1.0 + (i + k) as f64);
            let large = Rows::from_fn(1, 2, |_, k| if k == 0 { -size } else { 0.5 });
            for parts in [vec![&small, &large], vec![&large, &small], vec![&large]] {
                let (mut plain, mut careful) = (true, true);
                <CrossFactors<f64> as Algebra>::identity_plus(&parts, &mut plain);
                <Rotations as Algebra>::identity_plus(&parts, &mut careful);
                assert_eq!((plain, careful), (sound, true), "{size} among {} parts", parts.len());
            }
        }
    }
}
