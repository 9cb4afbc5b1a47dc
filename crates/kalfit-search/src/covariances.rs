//! Covariances from the inverse of the information of (α, μ, Σ).

use nalgebra::{DMatrix, DVector};

/// Variances of α, and covariances of shared values of α and along the tangent basis of (μ, Σ).
#[derive(Debug, Clone)]
pub struct ValueCovariances {
    /// Variance of each coordinate of α; `None` for a coordinate that does not move or takes part in a flat direction.
    pub alpha: Vec<Option<f64>>,
    /// Indices of the values that are not eliminated test by test, in the order of the first rows and columns of
    /// `whole`.
    pub shared: Vec<usize>,
    /// Covariance of the coordinates of `shared`, then along the tangent basis of (μ, Σ), including the uncertainty of
    /// all α.
    pub whole: DMatrix<f64>,
    /// Directions, in the coordinates of `whole`, along which ℓ does not change: values that take part in such a
    /// direction have no variance.
    pub flat: Vec<DVector<f64>>,
}

impl ValueCovariances {
    /// Removes the variances that `others` lacks, and copies the flat directions of `others`.
    pub fn without_flat(&mut self, others: &ValueCovariances) {
        for (own, other) in self.alpha.iter_mut().zip(&others.alpha) {
            *own = own.filter(|_| other.is_some());
        }
        self.flat.clone_from(&others.flat);
    }
}
