//! One phase of tests that share all matrices.

use std::ops::Range;

/// One phase, generic in the types of its matrices and data.
#[derive(Debug, Clone)]
pub(super) struct PhaseView<M, D> {
    /// Range of the states that are new in the phase, as indices into the states of all phases.
    pub(super) own: Range<usize>,
    /// R, q × q, upper triangular.
    pub(super) factor: M,
    /// d, q × columns: the mean over the tests, then the columns of the scatter.
    pub(super) data: D,
    pub(super) link: Option<LinkView<M>>,
}

/// Link from the phase before: σ = Eξ + G σ_before + noise of covariance CC'.
#[derive(Debug, Clone)]
pub(super) struct LinkView<M> {
    /// G, q × (q of the phase before).
    pub(super) sensitivity: M,
    /// C', root of the covariance CC' of the noise between the phases; q columns.
    pub(super) root: M,
}
