//! Steps of one row each whose transition is that of the step before, taken many at a time.

use std::ops::Range;

use crate::ensemble::Test;
use crate::reduce::observe::{Ahead, Observed};
use crate::reduce::prepare::{Moment, Preparer, Workspace};
use crate::reduce::steps::Cells;
use crate::reduce::subject::At;

impl Preparer {
    /// Takes the steps of `rows`, one row each and like `last` but for the cells that they read, as far as they are sound and no two
    /// on end have equal lines. Returns how many.
    pub(super) fn follow(
        &self,
        at: &At<'_>,
        test: &Test,
        (last, rows): (&Moment, Range<usize>),
        work: &mut Workspace,
    ) -> usize {
        let Workspace { design, data, instances, covariances, constants, last: made, inputs: known, .. } = work;
        let mut observed = Observed { design, data, instances, covariances: covariances.as_mut(), constants };
        let driven = if last.moves { self.order.frame.driven.len() } else { 0 };
        let is_fixed = self.dynamics.inputs.varying.is_empty();
        let drive = |row: usize, inputs: &mut Vec<f64>| {
            if driven == 0 || is_fixed {
                inputs.extend_from_within(inputs.len() - driven..);
                return true;
            }
            let moves = made.as_ref().expect("the last step has had a transition").moves();
            let source = if self.clock_previous() { row - 1 } else { row };
            let moment = Moment { rows: row..row + 1, source: source..source + 1, ..last.clone() };
            let mut none = Cells::default(); // a row's own cells are in one place
            let scope = self.motion_scope(at, test, &moment, &mut none);
            if scope.and_then(|scope| self.dynamics.inputs.evaluate(at, &scope, known)).is_err() {
                return false;
            }
            self.plan.inputs(moves, known, inputs);
            true
        };
        let ahead = Ahead { first: rows.start, most: rows.len(), dt: last.dt };
        self.meters.follow(at, test, ahead, &mut observed, drive)
    }
}

#[cfg(test)]
mod tests;
