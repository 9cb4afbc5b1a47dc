//! Moments of the states given all measurements of a test, by the smoother of `score` with the posterior of ξ.

use std::ops::Range;

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::apply::predicted::EvaluatedPhase;
use crate::apply::states::{PhaseStates, StepMoments};
use crate::apply::{Applied, ApplyError};
use kalfit_filter::reduce::ReduceError;
use kalfit_filter::score::{PhasedScorer, Smoothed};
use kalfit_model::{Evidence, PhasedTest};

impl Applied<'_> {
    pub(super) fn smoothed(&self, tests: Range<usize>) -> Result<Vec<Vec<PhaseStates>>, ApplyError> {
        let law = kalfit_estimate::law_at(&self.problem, &self.point);
        let scorer = PhasedScorer::new(self.model, &self.reducer, &self.slots)?;
        let numbers: Vec<usize> = tests.clone().collect();
        let reductions = self.reductions.select(&numbers);
        let found = scorer.all_smoothed(&self.tests[tests.clone()], &reductions, &law)?;
        let states: Vec<Result<Vec<PhaseStates>, ReduceError>> =
            self.tests[tests].par_iter().zip(found).map(|(test, phases)| self.states_of_test(test, phases)).collect();
        Ok(states.into_iter().collect::<Result<_, _>>()?)
    }

    fn states_of_test(
        &self,
        test: &PhasedTest,
        phases: Vec<Option<Vec<Smoothed>>>,
    ) -> Result<Vec<PhaseStates>, ReduceError> {
        let mut states = Vec::with_capacity(phases.len());
        for (at, (evidence, found)) in test.phases.iter().zip(phases).enumerate() {
            let (Evidence::Rows(rows), Some(found)) = (evidence, found) else { continue };
            let evaluated_phase = EvaluatedPhase::new(&self.reducer.phases()[at], rows)?;
            let known = found.into_iter().skip(1).map(|one| {
                let n = one.mean.len();
                StepMoments { covariance: DMatrix::from_row_slice(n, n, &one.variance), mean: one.mean }
            });
            states.push(evaluated_phase.states(at, known, false));
        }
        Ok(states)
    }
}
