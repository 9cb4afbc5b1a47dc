//! One phase of a test, to be stacked.

use nalgebra::{DMatrix, DVector};

/// What stacking depends on, of one phase of a test.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StackPhase<'a> {
    /// p_i.
    pub(crate) own: usize,
    /// R_i, packed by columns, q_i × q_i.
    pub(crate) factor: &'a [f64],
    /// d_i, q_i numbers.
    pub(crate) data: &'a [f64],
    pub(crate) constant: f64,
    /// Ψ_K and a root of P_K of the phase before, and T; `None` for the first phase.
    pub(crate) link: Option<[&'a DMatrix<f64>; 3]>,
    /// g of the link that leads here.
    pub(crate) mean: Option<&'a DVector<f64>>,
}

/// The sizes of the matrices that stacking depends on: tests with the same ones can be stacked side by side.
pub(crate) type StackShape = Vec<(usize, usize, Option<[(usize, usize); 3]>)>;

/// The sizes of phases.
pub(crate) fn shape(phases: &[StackPhase<'_>]) -> StackShape {
    phases
        .iter()
        .map(|phase| (phase.own, phase.factor.len(), phase.link.map(|link| link.map(DMatrix::shape))))
        .collect()
}
