//! Directions of μ and Σ.

use nalgebra::{DMatrix, DVector};

/// Eigenvalues of an information matrix, scaled to unit diagonal, below this threshold count as zero.
pub(crate) const ZERO_EIGENVALUE: f64 = 1e-10;
/// An element whose weight, in natural sizes, is below this fraction of the largest weight is not part of a direction.
const MIN_WEIGHT: f64 = 1e-6;

/// The quantity that a direction belongs to: μ or Σ.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Directions of μ; entries by element, then by regression coefficient where there are any.
    Mean,
    /// Directions of Σ; entries by element (0,0), (1,0), (1,1), (2,0), … of the first phase, then by element of each
    /// next phase.
    Covariance,
}

/// A direction without information: a unit vector in the user's units. Exactly the elements with a non-zero entry take
/// part in the direction, however small the entry: a scale factor of 1e-6 may take part together with a bias of 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Direction {
    /// The quantity: μ or Σ.
    pub quantity: Quantity,
    /// p entries for the mean and one for each regression coefficient; one for each element of the covariance.
    pub direction: Vec<f64>,
}

/// A basis of the span of `basis` with many zeros, by Gauss-Jordan elimination with complete pivoting; eigenvectors of
/// several unobserved directions are arbitrary mixtures of these directions.
pub(super) fn simplest(mut basis: DMatrix<f64>) -> DMatrix<f64> {
    for c in 0..basis.ncols() {
        let (mut at, mut largest) = ((0, c), 0.0);
        for k in c..basis.ncols() {
            for i in 0..basis.nrows() {
                if basis[(i, k)].abs() > largest * (1.0 + 1e-6) {
                    (at, largest) = ((i, k), basis[(i, k)].abs());
                }
            }
        }
        basis.swap_columns(c, at.1);
        let pivot = basis[(at.0, c)];
        basis.column_mut(c).unscale_mut(pivot);
        for k in (0..basis.ncols()).filter(|&k| k != c) {
            let part = basis.column(c) * basis[(at.0, k)];
            basis.set_column(k, &(basis.column(k) - part));
        }
    }
    basis
}

/// Converts a direction from natural sizes to the user's units; `units` has the natural size of each element in the
/// user's units. Entries below [`MIN_WEIGHT`] become zero, the length is 1, and the largest entry is positive.
pub(crate) fn in_units<'u>(natural: &DVector<f64>, units: impl Iterator<Item = &'u f64>) -> Vec<f64> {
    let least = MIN_WEIGHT * natural.amax();
    let in_user_units = natural.iter().zip(units).map(|(x, unit)| if x.abs() > least { x * unit } else { 0.0 });
    let mut direction: Vec<f64> = in_user_units.collect();
    let largest = direction.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    let length = largest * direction.iter().map(|x| (x / largest).powi(2)).sum::<f64>().sqrt();
    direction.iter_mut().filter(|x| **x != 0.0).for_each(|x| *x /= length);
    direction
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a state takes part does not depend on its unit.
    #[test]
    fn what_takes_part_does_so_in_any_unit() {
        let natural = DVector::from_vec(vec![1.0, -1.0, 1e-9, 0.0]);
        for unit in [1.0, 1e6, 1e-12, 1e200] {
            let found = in_units(&natural, [1.0, unit, 1.0, unit].iter());
            let sign = if unit > 1.0 { -1.0 } else { 1.0 };
            let length = f64::hypot(1.0, unit);
            for (found, expected) in found.iter().zip([sign / length, -sign * unit / length, 0.0, 0.0]) {
                assert!((found - expected).abs() <= 1e-14 * expected.abs(), "{found} {expected} for units of {unit}");
            }
        }
        assert_eq!(in_units(&DVector::zeros(2), [1.0, 1.0].iter()), [0.0, 0.0]);
    }
}
