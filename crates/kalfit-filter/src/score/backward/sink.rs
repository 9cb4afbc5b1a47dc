//! What the backward pass hands on.

use std::ops::Range;

/// Adjoints of the scalar measurements of one step, as they stand in the design (whitened).
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct MeasurementAdjoint {
    /// ∂ℓ/∂R.
    pub(crate) noise: Vec<f64>,
    /// ∂ℓ/∂(z - d).
    pub(crate) value: Vec<f64>,
    /// ∂ℓ/∂h over all states, n numbers a measurement; empty when not wanted.
    pub(crate) h: Vec<f64>,
}

/// Adjoints of one transition.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TransitionAdjoint<T = f64> {
    /// ∂ℓ/∂φ, entry by entry of [`Transition::phi`](crate::reduce::Transition::phi); zero when not wanted.
    pub(crate) phi: Vec<T>,
    /// ∂ℓ/∂Q, entry by entry of [`Transition::q`](crate::reduce::Transition::q): an entry off the diagonal stands for both places.
    pub(crate) q: Vec<T>,
    /// ∂ℓ/∂b of the driven states.
    pub(crate) input: Vec<T>,
}

impl<T> Default for TransitionAdjoint<T> {
    fn default() -> TransitionAdjoint<T> {
        TransitionAdjoint { phi: Vec::new(), q: Vec::new(), input: Vec::new() }
    }
}

/// Takes adjoints from the last step to the first.
pub(crate) trait Sink {
    /// Why it cannot go on.
    type Error;
    /// Whether the sums of the adjoints over these equal steps will do; they are then given as those of the first of them.
    fn accepts_sums(&mut self, steps: Range<usize>) -> bool;
    /// Of the measurements of step `k`.
    fn measured(&mut self, k: usize, bar: &MeasurementAdjoint) -> Result<(), Self::Error>;
    /// Of the transition to step `k`.
    fn moved(&mut self, k: usize, bar: &TransitionAdjoint) -> Result<(), Self::Error>;
    /// Of a (n) and P0 (r × r, each place by itself).
    fn started(&mut self, mean: &[f64], variance: &[f64]) -> Result<(), Self::Error>;
}
