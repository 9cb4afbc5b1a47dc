//! Kinds of standard errors, and the threshold below which an unidentified direction does not affect a standard error.

/// A quantity has no standard error when undetermined values of α move the quantity by more than this fraction of the
/// quantity's largest derivative.
pub(super) const MAX_OPEN_SHARE: f64 = 1e-6;

/// Matrix that standard errors come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StdErrors {
    /// H⁻¹, with H the negative Hessian of ℓ.
    #[default]
    Observed,
    /// I⁻¹, with I the expected information (theory §3).
    Expected,
    /// H⁻¹ (Σ_j s_j s_j') H⁻¹ with the scores s_j of the tests: with many tests valid even if the model is wrong.
    Sandwich,
}
