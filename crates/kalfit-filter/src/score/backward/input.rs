//! Input of the backward pass of a test.
#![expect(non_snake_case, reason = "the letters of the theory: N")]

use crate::reduce::{Design, Gains, Workspace};
use crate::score::moments::Moments;

/// Adjoints that the pullback needs from a backward pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AdjointsWanted {
    /// Whether ∂ℓ/∂φ is wanted.
    pub motion: bool,
    /// Whether ∂ℓ/∂h is wanted.
    pub equation: bool,
}

/// Design, gains, data and moments of ξ of one test, all that the backward pass reads.
#[derive(Debug, Clone, Copy)]
pub struct BackwardInput<'a> {
    pub(crate) design: &'a Design,
    pub(crate) gains: &'a Gains,
    pub(crate) start: &'a [f64],
    pub(crate) inputs: &'a [f64],
    pub(crate) values: &'a [f64],
    /// Whether all data are zero, so that the pass gives only the part of the adjoints that depends on the design.
    pub(crate) zero_data: bool,
    pub(crate) moments: &'a Moments,
    /// Adjoints of the last state from later phases; `None` for the last phase.
    pub(crate) ending: Option<&'a TerminalAdjoint>,
    pub(crate) wanted: AdjointsWanted,
}

impl<'a> BackwardInput<'a> {
    /// Input for the test in a work space, under the gains of the design.
    pub fn of(
        (work, gains): (&'a Workspace, &'a Gains),
        (moments, ending): (&'a Moments, Option<&'a TerminalAdjoint>),
        wanted: AdjointsWanted,
    ) -> BackwardInput<'a> {
        let (design, data) = (&work.design, &work.data);
        let (start, inputs, values) = (&data.start, &data.inputs, &data.values);
        BackwardInput { design, gains, start, inputs, values, zero_data: false, moments, ending, wanted }
    }
}

/// r (n), ρ (n × columns) and N (r × r) after the last step, in kernel order: adjoints of x_K from the phases that follow
/// (theory §7).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TerminalAdjoint {
    pub(crate) r: Vec<f64>,
    pub(crate) rho: Vec<f64>,
    pub(crate) N: Vec<f64>,
}
