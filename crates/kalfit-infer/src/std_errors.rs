//! What standard errors are made of, and what has none.

/// An element that takes part in an unidentified direction by more than this has no standard error.
pub(super) const PART: f64 = 1e-6;

/// What standard errors are made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StdErrors {
    /// H⁻¹, H the negative Hessian of ℓ.
    #[default]
    Observed,
    /// I⁻¹, I the expected information (theory §3).
    Expected,
    /// H⁻¹ (Σ_j s_j s_j') H⁻¹ with the scores s_j of the tests: right also when the model is not, given many tests.
    Sandwich,
}
