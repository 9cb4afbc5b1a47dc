//! One value at a step of a design: the mean, the sensitivity to ξ and γ, and the variance by process noise.

use nalgebra::{DMatrix, DVector};

use crate::predict::What;

/// A state or output at one step.
#[derive(Debug)]
pub(super) struct PredictedValue {
    pub(super) what: What,
    pub(super) row: usize,
    pub(super) mean: f64,
    /// Derivatives of the mean with respect to ξ and the regression coefficients γ.
    pub(super) sensitivity: DVector<f64>,
    /// Variance of the value by process noise.
    pub(super) process: f64,
}

impl PredictedValue {
    /// Variance g'Σg over the population.
    pub(super) fn population(&self, covariance: &DMatrix<f64>) -> f64 {
        let own = self.sensitivity.rows(0, covariance.nrows());
        let variance = own.dot(&(covariance * own));
        if variance < 0.0 { 0.0 } else { variance }
    }
}
