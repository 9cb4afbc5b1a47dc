//! Adjoints that the backward pass computes, and the trait [`Sink`] of receivers.

use std::ops::Range;

/// Adjoints of the scalar measurements of one step, whitened as in the design.
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
    /// ∂ℓ/∂Q, entry by entry of [`Transition::q`](crate::reduce::Transition::q): an off-diagonal value is the
    /// derivative to both entries together.
    pub(crate) q: Vec<T>,
    /// ∂ℓ/∂b of the driven states.
    pub(crate) input: Vec<T>,
}

impl<T> Default for TransitionAdjoint<T> {
    fn default() -> TransitionAdjoint<T> {
        TransitionAdjoint { phi: Vec::new(), q: Vec::new(), input: Vec::new() }
    }
}

/// A receiver of adjoints, from the last step to the first.
pub(crate) trait Sink {
    /// The error that ends the pass.
    type Error;
    /// Whether sums of the adjoints over the equal steps `steps` suffice; the sums are then given as the adjoints of
    /// the first of the steps.
    fn accepts_sums(&mut self, steps: Range<usize>) -> bool;
    /// Takes the adjoints of the measurements of step `k`.
    fn measured(&mut self, k: usize, bar: &MeasurementAdjoint) -> Result<(), Self::Error>;
    /// Takes the adjoints of the transition to step `k`.
    fn moved(&mut self, k: usize, bar: &TransitionAdjoint) -> Result<(), Self::Error>;
    /// Takes ∂ℓ/∂a (n) and ∂ℓ/∂P0 (r × r, entries taken as independent).
    fn started(&mut self, mean: &[f64], variance: &[f64]) -> Result<(), Self::Error>;
}
