//! One phase of a test, as the input of stacking.

use nalgebra::{DMatrix, DVector};

/// The quantities of one phase of a test on which stacking depends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StackPhase<'a> {
    /// p_i, the number of elements of ξ_i.
    pub(crate) own: usize,
    /// R_i, packed by columns, q_i × q_i.
    pub(crate) factor: &'a [f64],
    /// d_i, q_i numbers.
    pub(crate) data: &'a [f64],
    pub(crate) constant: f64,
    /// [Ψ_K of the phase before, a root of P_K of the phase before, T]; `None` for the first phase.
    pub(crate) link: Option<[&'a DMatrix<f64>; 3]>,
    /// g of the link that leads to this phase; `None` for the first phase.
    pub(crate) mean: Option<&'a DVector<f64>>,
}

/// The sizes of the matrices on which stacking depends: tests of one shape can be stacked in lanes.
pub(crate) type StackShape = Vec<(usize, usize, Option<[(usize, usize); 3]>)>;

/// The shape of the phases of a test.
pub(crate) fn shape(phases: &[StackPhase<'_>]) -> StackShape {
    phases
        .iter()
        .map(|phase| (phase.own, phase.factor.len(), phase.link.map(|link| link.map(DMatrix::shape))))
        .collect()
}
