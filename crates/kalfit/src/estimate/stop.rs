//! Why a search stopped.

/// Why the search stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// The certificate holds.
    Certified,
    /// The passes ran out first.
    PassLimit,
    /// [`Progress::stops`](crate::estimate::Progress::stops) asked for it.
    Interrupted,
    /// No step raises ℓ, yet the certificate does not hold.
    Stalled,
}
