//! The root of the information of a segment: its rows as a measurement of the state before them.
#![expect(non_snake_case, reason = "the letters of the theory: J, R")]

use crate::reduce::segments::{Square, Vector};

/// A pivot up to this fraction of its diagonal counts as zero: the states of such a pivot are seen as a sum.
const ZERO_PIVOT: f64 = 1e-15;

/// Least fraction of its diagonal that a pivot has unless it is zero: a smaller pivot has fewer than seven digits in J.
const LEAST_PIVOT: f64 = 1e-9;

/// R upper triangular with R'R = J, for a positive semidefinite J; a zero pivot gives a row of zeros. `None` where a
/// pivot has lost its digits.
pub(super) fn root<const N: usize>(J: &Square<N>) -> Option<Square<N>> {
    let mut R = Square::<N>::zeros();
    for k in 0..N {
        let pivot = (0..k).fold(J[(k, k)], |left, l| left - R[(l, k)] * R[(l, k)]);
        if pivot <= ZERO_PIVOT * J[(k, k)] {
            continue;
        }
        if pivot < LEAST_PIVOT * J[(k, k)] || pivot.is_nan() {
            return None;
        }
        R[(k, k)] = pivot.sqrt();
        for j in k + 1..N {
            R[(k, j)] = (0..k).fold(J[(k, j)], |left, l| left - R[(l, k)] * R[(l, j)]) / R[(k, k)];
        }
    }
    Some(R)
}

/// d with R'd = y; zero in rows of zeros.
pub(super) fn root_data<const N: usize>(R: &Square<N>, y: &Vector<N>) -> Vector<N> {
    let mut d = Vector::<N>::zeros();
    for k in 0..N {
        let left = (0..k).fold(y[k], |left, l| left - R[(l, k)] * d[l]);
        d[k] = if R[(k, k)] > 0.0 { left / R[(k, k)] } else { 0.0 };
    }
    d
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_singular_matrix_is_the_square_of_its_root() {
        let J = Square::<3>::from_row_slice(&[4.0, 2.0, -4.0, 2.0, 1.0, -2.0, -4.0, -2.0, 9.0]);
        let R = root(&J).expect("accurate");
        assert_eq!((R.row(1).norm(), R[(2, 2)]), (0.0, 5f64.sqrt()));
        assert!((R.transpose() * R - J).amax() < 1e-14);
        let d = Vector::<3>::new(0.3, 0.0, -2.0);
        assert!((root_data(&R, &(R.transpose() * d)) - d).amax() < 1e-15);
        assert!(root(&Square::<2>::new(1.0, 1.0, 1.0, 1.0 + 1e-12)).is_none());
    }
}
