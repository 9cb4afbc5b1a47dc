//! Moments of the states given the measurements before a step, or up to and including the step, by the filter with the
//! law of σ.
#![expect(non_snake_case, reason = "the letters of the theory: Psi, P")]

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::apply::predicted::EvaluatedPhase;
use crate::apply::states::{PhaseStates, StateKind, StepMoments};
use crate::apply::{Applied, ApplyError};
use kalfit_filter::innovations::{ChainedFilter, EnteringLaw};
use kalfit_filter::reduce::{Gains, PhasedWork, ReduceError, Workspace, single_test_innovations};
use kalfit_filter::score::{AdjointsWanted, BackwardInput, BackwardWork, FilterSnapshot, Moments};
use kalfit_model::PhasedTest;

impl Applied<'_> {
    pub(super) fn forward(&self, kind: StateKind, tests: Range<usize>) -> Result<Vec<Vec<PhaseStates>>, ApplyError> {
        let combined = self.population.together(self.model.dimension(), &self.model.slots());
        let filter = ChainedFilter::new(self.model, self.alpha, &combined)?;
        let states: Vec<Result<Vec<PhaseStates>, ReduceError>> = self.tests[tests]
            .par_iter()
            .map_init(|| filter.reducer().workspace(), |work, test| states_of_test(&filter, kind, test, work))
            .collect();
        Ok(states.into_iter().collect::<Result<_, _>>()?)
    }
}

fn states_of_test(
    filter: &ChainedFilter,
    kind: StateKind,
    test: &PhasedTest,
    work: &mut PhasedWork,
) -> Result<Vec<PhaseStates>, ReduceError> {
    let mut states = Vec::with_capacity(test.phases.len());
    let mut backward = BackwardWork::default();
    filter.through(test, work, &mut |(at, rows), gains, work, law| {
        let known = filtered(kind, gains, (work, &mut backward), law);
        let evaluated_phase = EvaluatedPhase::new(&filter.reducer().phases()[at], rows);
        states.push(
            evaluated_phase
                .map(|evaluated_phase| evaluated_phase.states(at, known.into_iter(), kind == StateKind::Predicted)),
        );
    })?;
    states.into_iter().collect()
}

/// Noise of an exact measurement h'Ψσ in the law of σ, as a fraction of the standard deviation that h'Ψσ had before the
/// measurement.
const EXACT_NOISE: f64 = 1e-12;
/// Fraction of the standard deviation at the start of the phase down to which h'Ψσ counts as known.
const KNOWN_FRACTION: f64 = 1e-8;

/// Mean x̂ + Ψσ̂ and covariance P + ΨVΨ' of the states of each step, before or after the measurements of the step (by
/// `kind`). Every measurement updates `law`, the law N(σ̂, V) of σ. Exact measurements, which the filter at a given σ
/// leaves out, update the law after the other measurements of the step: as h'P = 0, these change neither the innovation
/// nor h'Ψ.
fn filtered(
    kind: StateKind,
    gains: &Gains,
    (work, backward): (&mut Workspace, &mut BackwardWork),
    law: &mut EnteringLaw,
) -> Vec<StepMoments> {
    single_test_innovations(gains, work);
    let q = work.design.frame.p;
    // moments at σ = 0, with one column of sensitivities for each element of σ
    let moments_at_zero = Moments::of(&DVector::zeros(q), &DMatrix::identity(q, q));
    let backward_input =
        BackwardInput::of((work, gains), (&moments_at_zero, None), AdjointsWanted { motion: true, equation: false });
    let mut states = Vec::with_capacity(work.design.steps());
    let first = law.posterior().1;
    backward_input.filtered_states(backward, &work.pass.e, |step, measured, seen| {
        if measured {
            for row in step.rows.clone() {
                let (weight, _, sensitivity) = gains.row(row);
                if weight > 0.0 {
                    law.take(work.pass.e[row], sensitivity, weight);
                }
            }
            for (line, row) in step.lines.clone().zip(step.rows.clone()) {
                if work.design.noise[line] == 0.0 && gains.row(row).0 == 0.0 {
                    let sensitivity = seen.sensitivity().transpose() * dense(work.design.terms(line), seen.x.len());
                    take_exact(law, work.pass.e[row], &sensitivity, &first);
                }
            }
        }
        if measured == (kind == StateKind::Filtered) {
            states.push(known(seen, &law.posterior()));
        }
    });
    states
}

/// h as a vector of length n.
fn dense((states, h): (&[u32], &[f64]), n: usize) -> DVector<f64> {
    let mut form = DVector::zeros(n);
    states.iter().zip(h).for_each(|(&state, &h)| form[state as usize] = h);
    form
}

/// Takes e = t'σ into the law of σ, unless t'σ is known already; `first`: root of the covariance of σ at the start of
/// the phase.
fn take_exact(law: &mut EnteringLaw, e: f64, t: &DVector<f64>, first: &DMatrix<f64>) {
    let deviation = law.posterior().1.tr_mul(t).norm();
    let at_start: f64 = first.row_iter().zip(t.iter()).map(|(row, t)| t.abs() * row.norm()).sum();
    if deviation > KNOWN_FRACTION * at_start {
        law.take(e, t.as_slice(), (EXACT_NOISE * deviation).powi(-2));
    }
}

fn known(seen: FilterSnapshot<'_>, (mean, root): &(DVector<f64>, DMatrix<f64>)) -> StepMoments {
    let Psi = seen.sensitivity();
    let state_root = &Psi * root;
    let mut covariance = &state_root * state_root.transpose();
    seen.add_noise(&mut covariance);
    let mean = DVector::from_column_slice(seen.x) + Psi * mean;
    StepMoments { mean: mean.as_slice().to_vec(), covariance }
}
