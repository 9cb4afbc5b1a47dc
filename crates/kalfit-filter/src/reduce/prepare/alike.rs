//! The cells that determine the design of a test, and the number of stretches of equal steps of a test.

use crate::reduce::cell_mask::CellMask;
use crate::reduce::dynamics::Dynamics;
use crate::reduce::observe::Meters;
use crate::reduce::prepare::Preparer;
use crate::reduce::start::ModelStart;
use crate::reduce::steps::{StepSpan, spans};
use crate::reduce::subject::{ModelAt, Uses};
use kalfit_model::Test;

/// Mask of all cells that are read from a test except measured values and covariates; `None` where whitening mixes
/// values. `design_columns`, `input_columns`: columns as in the fields of `Preparer`.
pub(super) fn read_cells(
    at: &ModelAt<'_>,
    (design_columns, input_columns): (&Uses, &Uses),
    (dynamics, start, meters): (&Dynamics, &ModelStart, &Meters),
) -> Option<CellMask> {
    let mut read = Uses::default();
    for uses in [design_columns, input_columns, &dynamics.uses] {
        read.extend(uses);
    }
    start.coefficients().chain(&start.initial_time).for_each(|coefficient| read.add(coefficient, at.alpha));
    at.model.clock.time.iter().for_each(|&column| read.number(column));
    meters.can_repeat().then(|| CellMask::new(at.model.columns.len(), &read, meters.columns()))
}

impl Preparer {
    /// Number of stretches of equal steps of a test, by times and the cells of coefficients, whatever α is; `None`
    /// where the steps cannot be determined or states have inputs.
    pub(crate) fn stretches(&self, test: &Test) -> Option<usize> {
        let mut steps = Vec::new();
        spans(&self.at(), test, None, &mut steps).ok()?;
        let changes = |span: &StepSpan| {
            let later = (1..span.count).map(|number| span.step(number));
            1 + later.filter(|rows| !self.design_columns.repeat(test, rows)).count()
        };
        self.order.frame.driven.is_empty().then(|| steps.iter().map(changes).sum())
    }
}
