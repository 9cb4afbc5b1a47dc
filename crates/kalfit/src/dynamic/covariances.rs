//! Covariances from the inverse of the information of (α, μ, Σ).

use nalgebra::DMatrix;

/// Covariances from the inverse of the information.
#[derive(Debug, Clone)]
pub(crate) struct ValueCovariances {
    /// Variance of each coordinate of α; `None` where it does not move or is flat.
    pub(crate) alpha: Vec<Option<f64>>,
    /// Values that are not of single tests: the first rows and columns of `whole`.
    pub(crate) shared: Vec<usize>,
    /// Covariance of the coordinates of those, then along the tangent basis of (μ, Σ), the uncertainty of all α in it.
    pub(crate) whole: DMatrix<f64>,
}
