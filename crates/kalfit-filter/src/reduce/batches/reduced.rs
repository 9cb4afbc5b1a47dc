//! Reductions of tests in lanes, from the results of the filters.

use std::sync::Arc;

use crate::reduce::batches::layout::BatchLayout;
use crate::reduce::batches::values::BatchValues;
use crate::reduce::data::Outcome;
use crate::reduce::lanes::DataWorkspace;
use crate::reduce::reduced_tests::ReducedTests;
use crate::reduce::reducer::{Reducer, ReductionHeader};
use crate::reduce::terminal::TerminalState;
use kalfit_model::Path;
use kalfit_model::Test;

/// The parts of a reduction that the filter does not compute. `digest`: digest of the design at the α of the first
/// evaluation.
#[derive(Debug)]
pub(super) struct TestHeader {
    pub(super) digest: u128,
    pub(super) covariates: Vec<f64>,
    pub(super) steps: usize,
    pub(super) observations: usize,
}

impl BatchValues {
    /// Runs the filters of evaluated tests and adds the reductions to `found`. `digest`: gives the digest of the design
    /// of a test at this α.
    pub(super) fn reduce(
        &mut self,
        (layout, own): (&BatchLayout, &[TestHeader]),
        (reducer, digest): (&Reducer, impl Fn(&TestHeader) -> u128),
        tests: &[&Test],
        scratch: &mut DataWorkspace,
        found: &mut ReducedTests,
    ) {
        self.batch_filter.design_batch.with_ends = reducer.wants_ends();
        self.batch_filter.run(&layout.design, own.len(), scratch);
        for (lane, (own, &number)) in own.iter().zip(&layout.tests).enumerate() {
            let Some((factor, outcome, end)) = self.lane_result(lane, (layout, own.observations), reducer, scratch)
            else {
                self.valid[lane] = false;
                found.exceptional.push(number);
                continue;
            };
            let header = ReductionHeader {
                factor,
                covariates: &own.covariates,
                steps: own.steps,
                observations: own.observations,
                path: Path::Information,
                digest: digest(own),
            };
            found.reductions.put(reducer.counted_reduction(tests[number], &outcome, header));
            found.numbers.push(number);
            found.terminals.extend(end);
        }
    }

    /// (R, outcome, last state if last states are wanted) of the test in a lane; `None` if the test needs square-root
    /// arrays or a number is not finite.
    pub(super) fn lane_result(
        &self,
        lane: usize,
        (layout, observations): (&BatchLayout, usize),
        reducer: &Reducer,
        scratch: &DataWorkspace,
    ) -> Option<(&[f64], Outcome, Option<TerminalState>)> {
        let (factor, determinant) = self.batch_filter.design_batch.found[lane].as_ref().filter(|_| self.valid[lane])?;
        let outcome = self.batch_filter.block.outcome(lane, (observations, *determinant), scratch);
        let end = match reducer.wants_ends() {
            true => Some(self.end(lane, layout, reducer, scratch)?),
            false => None,
        };
        outcome.is_finite().then_some((factor, outcome, end))
    }

    /// The last state of the test in a lane; `None` if the last state needs square-root arrays.
    fn end(
        &self,
        lane: usize,
        layout: &BatchLayout,
        reducer: &Reducer,
        scratch: &DataWorkspace,
    ) -> Option<TerminalState> {
        let states = &reducer.preparer().order.states;
        let end = self.batch_filter.design_batch.end((lane, layout.lanes), states)?;
        Some(TerminalState::new(Arc::new(end), states, self.batch_filter.block.last(lane, scratch)))
    }
}
