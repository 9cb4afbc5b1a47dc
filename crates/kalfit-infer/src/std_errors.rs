//! Kinds of standard errors, and the threshold below which an unidentified direction does not matter for them.

/// A quantity has no standard error when undetermined values of α move it by more than this, relative to its largest
/// derivative.
pub(super) const MAX_OPEN_SHARE: f64 = 1e-6;

/// Matrix that standard errors come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StdErrors {
    /// H⁻¹, H the negative Hessian of ℓ.
    #[default]
    Observed,
    /// I⁻¹, I the expected information (theory §3).
    Expected,
    /// H⁻¹ (Σ_j s_j s_j') H⁻¹ with the scores s_j of the tests: with many tests valid even if the model is wrong.
    Sandwich,
}
