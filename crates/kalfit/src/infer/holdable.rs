//! Quantities that can be held at a value.

/// A quantity that can be held. Values are in the user's units.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Holdable {
    /// μ_i.
    Mean(usize),
    /// A regression coefficient.
    Coefficient(usize),
    /// √σ_ii.
    StdDev(usize),
    /// σ_ij, i ≠ j.
    Covariance(usize, usize),
    /// σ_ij / √(σ_ii σ_jj).
    Correlation(usize, usize),
}
