//! The state after the last step of a test.

use nalgebra::{DMatrix, DVector};

/// The law of the state after the last step: x_K | z, ξ ~ N(x̂_K + Ψ_K ξ, P_K).
#[derive(Debug, Clone, PartialEq)]
pub struct Terminal {
    /// x̂_K, n numbers.
    pub mean: DVector<f64>,
    /// Ψ_K, n × p.
    pub sensitivity: DMatrix<f64>,
    /// C with CC' = P_K, n × any number of columns.
    pub root: DMatrix<f64>,
}

impl Terminal {
    /// P_K, n × n.
    pub fn covariance(&self) -> DMatrix<f64> {
        &self.root * self.root.transpose()
    }
}
