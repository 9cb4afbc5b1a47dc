//! Kinds of numbers that can be estimated.

/// An estimated quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Estimated {
    /// An element of μ.
    Mean(usize),
    /// A regression coefficient.
    Coefficient(usize),
    /// An element of Σ, i ≥ j.
    Covariance(usize, usize),
    /// A free value of α, by slot.
    Value(usize),
}
