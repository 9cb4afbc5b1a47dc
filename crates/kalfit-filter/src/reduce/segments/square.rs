//! Small square matrices of fixed size.

/// A pivot up to this fraction of its diagonal counts as zero.
const ZERO_PIVOT: f64 = 1e-15;

/// Least fraction of its diagonal that a pivot has unless it is zero.
const LEAST_PIVOT: f64 = 1e-9;

/// N × N, by rows.
pub(crate) type Square<const N: usize> = [[f64; N]; N];

/// The matrix stored in a list, row-major.
#[inline]
pub(crate) fn square<const N: usize>(list: &[f64]) -> Square<N> {
    let mut out = [[0.0; N]; N];
    out.as_flattened_mut().copy_from_slice(&list[..N * N]);
    out
}

/// The vector stored in a list.
#[inline]
pub(crate) fn vector<const N: usize>(list: &[f64]) -> [f64; N] {
    let mut out = [0.0; N];
    out.copy_from_slice(&list[..N]);
    out
}

#[inline]
pub(crate) fn identity<const N: usize>() -> Square<N> {
    let mut out = [[0.0; N]; N];
    (0..N).for_each(|i| out[i][i] = 1.0);
    out
}

/// AB.
#[inline]
pub(crate) fn product<const N: usize>(a: &Square<N>, b: &Square<N>) -> Square<N> {
    let mut out = [[0.0; N]; N];
    for i in 0..N {
        for k in 0..N {
            for j in 0..N {
                out[i][j] += a[i][k] * b[k][j];
            }
        }
    }
    out
}

#[inline]
pub(crate) fn transposed<const N: usize>(a: &Square<N>) -> Square<N> {
    let mut out = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..N {
            out[j][i] = a[i][j];
        }
    }
    out
}

/// A + factor × B.
#[inline]
pub(crate) fn sum<const N: usize>(a: &Square<N>, factor: f64, b: &Square<N>) -> Square<N> {
    let mut out = *a;
    for i in 0..N {
        for j in 0..N {
            out[i][j] += factor * b[i][j];
        }
    }
    out
}

/// ABA', symmetric, for a symmetric B.
#[inline]
pub(crate) fn congruence<const N: usize>(a: &Square<N>, b: &Square<N>) -> Square<N> {
    symmetric(&product(&product(a, b), &transposed(a)))
}

/// ½(A + A').
#[inline]
pub(crate) fn symmetric<const N: usize>(a: &Square<N>) -> Square<N> {
    let mut out = *a;
    for i in 0..N {
        for j in 0..N {
            out[i][j] = 0.5 * (a[i][j] + a[j][i]);
        }
    }
    out
}

/// Ax.
#[inline]
pub(crate) fn times<const N: usize>(a: &Square<N>, x: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|i| dot(&a[i], x))
}

/// A'x.
#[inline]
pub(crate) fn transposed_times<const N: usize>(a: &Square<N>, x: &[f64; N]) -> [f64; N] {
    let mut out = [0.0; N];
    for k in 0..N {
        for i in 0..N {
            out[i] += a[k][i] * x[k];
        }
    }
    out
}

#[inline]
pub(crate) fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// a + factor × b.
#[inline]
pub(crate) fn added<const N: usize>(a: &[f64; N], factor: f64, b: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|i| a[i] + factor * b[i])
}

/// R upper triangular with R'R = A, for a positive semidefinite A; a pivot that is zero up to rounding gives a row of
/// zeros. `None` where a pivot is so small that it has lost its digits.
pub(crate) fn root<const N: usize>(a: &Square<N>) -> Option<Square<N>> {
    let mut r = [[0.0; N]; N];
    for k in 0..N {
        let pivot = (0..k).fold(a[k][k], |left, l| left - r[l][k] * r[l][k]);
        if pivot > ZERO_PIVOT * a[k][k] {
            if pivot < LEAST_PIVOT * a[k][k] {
                return None;
            }
            let diagonal = pivot.sqrt();
            r[k][k] = diagonal;
            for j in k + 1..N {
                r[k][j] = (0..k).fold(a[k][j], |left, l| left - r[l][k] * r[l][j]) / diagonal;
            }
        }
    }
    Some(r)
}

/// (A⁻¹, |A|) by elimination with row pivots; `None` for a singular matrix.
pub(crate) fn inverse<const N: usize>(a: &Square<N>) -> Option<(Square<N>, f64)> {
    let (mut left, mut right, mut determinant) = (*a, identity::<N>(), 1.0);
    for k in 0..N {
        let pivot = (k..N).max_by(|&i, &j| left[i][k].abs().total_cmp(&left[j][k].abs()))?;
        if pivot != k {
            left.swap(k, pivot);
            right.swap(k, pivot);
            determinant = -determinant;
        }
        let diagonal = left[k][k];
        if diagonal == 0.0 || !diagonal.is_finite() {
            return None;
        }
        determinant *= diagonal;
        let reciprocal = 1.0 / diagonal;
        for j in 0..N {
            left[k][j] *= reciprocal;
            right[k][j] *= reciprocal;
        }
        let (pivot_left, pivot_right) = (left[k], right[k]);
        for i in (0..N).filter(|&i| i != k) {
            let factor = left[i][k];
            if factor != 0.0 {
                for j in 0..N {
                    left[i][j] -= factor * pivot_left[j];
                    right[i][j] -= factor * pivot_right[j];
                }
            }
        }
    }
    Some((right, determinant))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_singular_matrix_is_the_square_of_its_root() {
        let a = [[4.0, 2.0, -4.0], [2.0, 1.0, -2.0], [-4.0, -2.0, 9.0]];
        assert!(root(&[[1.0, 1.0], [1.0, 1.0 + 1e-12]]).is_none());
        let r = root(&a).expect("accurate");
        assert_eq!((r[1], r[2][2]), ([0.0; 3], 5f64.sqrt()));
        let square = product(&transposed(&r), &r);
        (0..9).for_each(|ij| assert!((square[ij / 3][ij % 3] - a[ij / 3][ij % 3]).abs() < 1e-14));
    }

    #[test]
    fn the_inverse_times_the_matrix_is_the_identity() {
        let a = [[0.0, 2.0, 1.0], [1.0, -1.0, 4.0], [3.0, 0.5, 2.0]];
        let (inverse, determinant) = inverse(&a).expect("regular");
        let product = product(&a, &inverse);
        for i in 0..3 {
            for j in 0..3 {
                assert!((product[i][j] - f64::from(u8::from(i == j))).abs() < 1e-15);
            }
        }
        assert!((determinant - 23.5).abs() < 1e-14, "{determinant}");
        assert!(super::inverse(&[[1.0, 2.0], [2.0, 4.0]]).is_none());
    }
}
