//! One phase of tests that share all matrices.

use std::ops::Range;

/// One phase, its matrices and data kept in whatever way.
#[derive(Debug, Clone)]
pub(super) struct PhaseView<M, D> {
    /// Its states among those of all phases.
    pub(super) own: Range<usize>,
    /// R, q × q, upper triangular.
    pub(super) factor: M,
    /// d of all columns, q × columns.
    pub(super) data: D,
    pub(super) link: Option<LinkView<M>>,
}

/// What leads to a phase from the one before.
#[derive(Debug, Clone)]
pub(super) struct LinkView<M> {
    /// G, q × q of the phase before.
    pub(super) sensitivity: M,
    /// C', any number × q.
    pub(super) root: M,
}
