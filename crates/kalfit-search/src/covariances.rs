//! Covariances from the inverse of the information of (α, μ, Σ).

use nalgebra::{DMatrix, DVector};

/// Covariances from the inverse of the information.
#[derive(Debug, Clone)]
pub struct ValueCovariances {
    /// Variance of each coordinate of α; `None` where it does not move or is flat.
    pub alpha: Vec<Option<f64>>,
    /// Values that are not of single tests: the first rows and columns of `whole`.
    pub shared: Vec<usize>,
    /// Covariance of the coordinates of `shared`, then along the tangent basis of (μ, Σ), including the uncertainty of
    /// all α.
    pub whole: DMatrix<f64>,
    /// Directions, in the coordinates of `whole`, along which ℓ does not change: values that take part in them have no
    /// covariance.
    pub flat: Vec<DVector<f64>>,
}

impl ValueCovariances {
    /// Removes variances that `others` has not, and takes over its flat directions.
    pub fn without_flat(&mut self, others: &ValueCovariances) {
        for (own, other) in self.alpha.iter_mut().zip(&others.alpha) {
            *own = own.filter(|_| other.is_some());
        }
        self.flat.clone_from(&others.flat);
    }
}
