//! One value of a design: its mean, what it hangs on, and its variance by process noise.

use nalgebra::{DMatrix, DVector};

use crate::predict::What;

/// One value.
#[derive(Debug)]
pub(super) struct PredictedValue {
    pub(super) what: What,
    pub(super) row: usize,
    pub(super) mean: f64,
    /// By (ξ, γ).
    pub(super) sensitivity: DVector<f64>,
    /// Variance by process noise.
    pub(super) process: f64,
}

impl PredictedValue {
    /// g'Σg.
    pub(super) fn population(&self, covariance: &DMatrix<f64>) -> f64 {
        let own = self.sensitivity.rows(0, covariance.nrows());
        let variance = own.dot(&(covariance * own));
        if variance < 0.0 { 0.0 } else { variance }
    }
}
