//! Directions of μ and Σ.

use nalgebra::DMatrix;

/// Scaled information below this is none.
pub(crate) const NONE: f64 = 1e-10;

/// What a direction is a direction of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Of μ; entries by element, then by regression coefficient where there are any.
    Mean,
    /// Of Σ; entries by element (0,0), (1,0), (1,1), (2,0), … of the first phase, then those of the next ones.
    Covariance,
}

/// A direction without information: a unit vector in the user's units.
#[derive(Debug, Clone, PartialEq)]
pub struct Direction {
    /// Of what.
    pub quantity: Quantity,
    /// p entries for the mean and one for each regression coefficient; one for each element of the covariance.
    pub direction: Vec<f64>,
}

/// A basis of the same span with many zeros: Gauss-Jordan elimination with complete pivoting. Several directions that nothing
/// was observed of come in any mixture otherwise, and say little to a reader.
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

/// Scaled to length one, noise removed, largest entry positive.
pub(crate) fn unit(mut direction: Vec<f64>) -> Vec<f64> {
    let norm = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
    let largest = direction.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    let sign = if largest < 0.0 { -1.0 } else { 1.0 };
    for x in &mut direction {
        *x = if x.abs() < 1e-9 * norm { 0.0 } else { sign * *x / norm };
    }
    direction
}
