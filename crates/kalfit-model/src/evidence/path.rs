//! The arithmetic that made a reduction.

/// The arithmetic that made a reduction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Path {
    /// Sums of T'S⁻¹T and T'S⁻¹e: the fast path.
    Information,
    /// Square-root arrays folded by QR: for tests too ill-conditioned for the fast path.
    SquareRoot,
}
