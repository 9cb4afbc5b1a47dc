//! A design propagated through the model: means, sensitivities to ξ and to the regression coefficients, and covariances
//! by process noise, step by step and from phase to phase.
#![expect(non_snake_case, reason = "the letters of the theory: Psi, P, C")]

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::apply::{EvaluatedPhase, StateForm, ValueSubject};
use crate::predict::steps::ValueSteps;
use crate::predict::value::PredictedValue;
use crate::predict::{Initial, MeanLimits, PhasePredictions, PredictError, Predicted, StepPredictions, What};
use kalfit_filter::reduce::{PhasedReducer, PhasedWork, Terminal, single_test_innovations};
use kalfit_filter::score::{AdjointsWanted, BackwardInput, BackwardWork, FilterSnapshot, Moments};
use kalfit_infer::{Knowledge, MeanCombination};
use kalfit_model::Test;
use kalfit_model::{Alpha, PhasedModel};
use kalfit_model::{Evidence, PhasedTest};

/// Filters of all phases of the model at one α.
#[derive(Debug)]
pub(super) struct Propagator {
    reducer: PhasedReducer,
}

/// Entering coordinates σ of a phase, of length q: the mean at the given (ξ, γ), with derivatives and covariance.
struct EnteringState {
    mean: DVector<f64>,
    /// Derivatives of σ with respect to (ξ, γ): q × (Σ p_i + regressions of all phases).
    sensitivity: DMatrix<f64>,
    /// Covariance by process noise of earlier phases, q × q.
    covariance: DMatrix<f64>,
}

/// All values at all steps of a design, phase by phase.
#[derive(Debug)]
pub(super) struct Trajectory {
    phases: Vec<PhaseTrajectory>,
}

/// (Rows of a step among the rows of the phase, time of the step, values of the step).
type StepValues = (Range<usize>, Option<f64>, Vec<PredictedValue>);

#[derive(Debug)]
struct PhaseTrajectory {
    phase: usize,
    steps: Vec<StepValues>,
}

impl Propagator {
    pub(super) fn new(model: &PhasedModel, alpha: &Alpha) -> Result<Propagator, PredictError> {
        Ok(Propagator { reducer: PhasedReducer::new(model, alpha)? })
    }

    /// Propagates a design phase by phase.
    pub(super) fn trajectory(
        &self,
        model: &PhasedModel,
        design: &PhasedTest,
        (initial, coefficients): (&Initial, &[f64]),
    ) -> Result<Trajectory, PredictError> {
        let mut work = self.reducer.workspace();
        let mut phases = Vec::with_capacity(design.phases.len());
        let mut previous_phase: Option<(EnteringState, Terminal)> = None;
        let (ranges, mut regression) = (model.ranges(), 0);
        for (at, evidence) in design.phases.iter().enumerate() {
            let Evidence::Rows(rows) = evidence else { break };
            let own = (ranges[at].clone(), regression);
            regression += model.phases[at].model.mean.regression.len();
            let (trajectory, end) =
                self.phase((model, at), rows, (initial, coefficients, own), previous_phase.as_ref(), &mut work)?;
            phases.push(trajectory);
            previous_phase = end;
        }
        Ok(Trajectory { phases })
    }

    fn phase(
        &self,
        (model, at): (&PhasedModel, usize),
        rows: &Test,
        (initial, coefficients, (elements, regression)): (&Initial, &[f64], (Range<usize>, usize)),
        previous_phase: Option<&(EnteringState, Terminal)>,
        work: &mut PhasedWork,
    ) -> Result<(PhaseTrajectory, Option<(EnteringState, Terminal)>), PredictError> {
        let phase = &self.reducer.phases()[at];
        let (rows_without_outputs, rows_with_outputs) =
            (with_output_column(rows, f64::NAN), with_output_column(rows, 0.0));
        let inherited = previous_phase.map(|previous_phase| {
            Ok::<_, PredictError>((previous_phase, phase.inherited(&rows_without_outputs, &mut work.cells)?))
        });
        let inherited = inherited.transpose()?;
        let evaluated_phase = EvaluatedPhase::new(phase, &rows_with_outputs)?;
        let forms = evaluated_phase.forms();
        let structure = &model.phases[at].model.mean.regression;
        let propagate = |gains: &kalfit_filter::reduce::Gains, work: &mut kalfit_filter::reduce::Workspace| {
            let q = work.design.frame.p;
            let mut entering = EnteringState {
                mean: DVector::zeros(q),
                sensitivity: DMatrix::zeros(q, initial.mean.len() + coefficients.len()),
                covariance: DMatrix::zeros(q, q),
            };
            for (row, element) in elements.clone().enumerate() {
                entering.mean[row] = initial.mean[element];
                entering.sensitivity[(row, element)] = 1.0;
            }
            for (number, (own, covariate)) in structure.iter().zip(&work.covariates).enumerate() {
                entering.mean[own.element] += coefficients[regression + number] * covariate;
                entering.sensitivity[(own.element, initial.mean.len() + regression + number)] += covariate;
            }
            if let Some(((last, terminal), inherited)) = &inherited {
                entering.add(last, terminal, inherited);
            }
            single_test_innovations(gains, work);
            let moments_at_zero = Moments::of(&DVector::zeros(q), &DMatrix::identity(q, q));
            let backward_input = BackwardInput::of(
                (work, gains),
                (&moments_at_zero, None),
                AdjointsWanted { motion: true, equation: false },
            );
            let mut steps = forms.into_iter();
            let mut trajectory = Vec::with_capacity(work.design.steps());
            backward_input.filtered_states(&mut BackwardWork::default(), &work.pass.e, |_, measured, seen| {
                if !measured && let Some((rows, time, forms)) = steps.next() {
                    let state = StepState::new(seen, &entering);
                    let values = forms.iter().map(|(subject, form)| state.value((*subject, rows.start), form));
                    trajectory.push((rows.clone(), time, values.collect()));
                }
            });
            let states = &phase.reducer.preparer().order.states;
            let end = gains.terminal(states, &work.pass.x);
            (PhaseTrajectory { phase: at, steps: trajectory }, end.map(|end| (entering, end)))
        };
        phase
            .reducer
            .with_gains(&rows_without_outputs, &mut work.phases[at], propagate)
            .map_err(|error| phase.named(error).into())
    }
}

/// A copy of the rows with an additional last column, from which outputs are read; every row of the column is `value`.
fn with_output_column(rows: &Test, value: f64) -> Test {
    let (numbers, texts) = rows.widths();
    let mut test = Test::new(rows.id.clone(), numbers + 1, texts);
    let mut cells = Vec::with_capacity(numbers + 1);
    for row in 0..rows.rows() {
        cells.clear();
        cells.extend_from_slice(rows.numbers(row));
        cells.push(value);
        test.push(&cells, rows.texts(row), rows.source(row));
    }
    test
}

impl EnteringState {
    /// Adds T x_K + t, the part of σ that depends on the last state x_K of the phase before.
    fn add(&mut self, last: &EnteringState, terminal: &Terminal, inherited: &kalfit_model::Inherited) {
        let T = &inherited.transition;
        let along = T * &terminal.sensitivity;
        self.mean += T * &terminal.mean + &inherited.input + &along * &last.mean;
        self.sensitivity += &along * &last.sensitivity;
        self.covariance += T * terminal.covariance() * T.transpose() + &along * &last.covariance * along.transpose();
    }
}

/// Moments of the states at a step.
struct StepState {
    mean: DVector<f64>,
    /// Derivatives of the states with respect to (ξ, γ): n × (length of ξ + length of γ).
    sensitivity: DMatrix<f64>,
    /// Covariance by process noise, n × n.
    covariance: DMatrix<f64>,
}

impl StepState {
    fn new(seen: FilterSnapshot<'_>, entering: &EnteringState) -> StepState {
        let Psi = seen.sensitivity();
        let mut covariance = &Psi * &entering.covariance * Psi.transpose();
        seen.add_noise(&mut covariance);
        StepState {
            mean: DVector::from_column_slice(seen.x) + &Psi * &entering.mean,
            sensitivity: Psi * &entering.sensitivity,
            covariance,
        }
    }

    fn value(&self, (subject, first): (ValueSubject, usize), form: &StateForm) -> PredictedValue {
        let (what, row) = match subject {
            ValueSubject::State(state) => (What::State(state), first),
            ValueSubject::Measurement(output, row) => (What::Output(output), row),
        };
        PredictedValue {
            what,
            row,
            mean: form.of(self.mean.as_slice()),
            sensitivity: form.along(&self.sensitivity),
            process: form.variance(&self.covariance),
        }
    }
}

impl Trajectory {
    /// Mean of each value as a linear combination of (μ, γ).
    pub(super) fn means(&self, initial: &Initial, coefficients: &[f64]) -> impl Iterator<Item = MeanCombination> {
        let at = DVector::from_iterator(
            initial.mean.len() + coefficients.len(),
            initial.mean.iter().chain(coefficients).copied(),
        );
        let values = self.phases.iter().flat_map(|phase| &phase.steps).flat_map(|(.., values)| values);
        values.map(move |value| MeanCombination {
            weights: value.sensitivity.clone(),
            constant: value.mean - value.sensitivity.dot(&at),
        })
    }

    /// Refuses values that are not finite.
    pub(super) fn check(&self, test: &str, initial: &Initial) -> Result<(), PredictError> {
        let all = self.phases.iter().flat_map(|phase| &phase.steps).flat_map(|(.., values)| values);
        for value in all {
            let variance = value.population(&initial.covariance) + value.process;
            let what = match (value.mean.is_finite(), variance.is_finite()) {
                (true, true) => continue,
                (false, _) => "the mean of a state or output",
                (true, false) => "the variance of a state or output",
            };
            return Err(PredictError::NotFinite { test: test.to_owned(), row: value.row + 1, what });
        }
        Ok(())
    }

    /// Predictions of all values. `sides`: the trajectory at each α of `ValueSteps::moved`.
    pub(super) fn predictions(
        &self,
        sides: &[Trajectory],
        initial: &Initial,
        known: Option<(&Knowledge, &ValueSteps)>,
    ) -> Vec<PhasePredictions> {
        let predicted = |phase: usize, step: usize, place: usize, value: &PredictedValue| {
            let moved: Vec<&PredictedValue> =
                sides.iter().map(|side| &side.phases[phase].steps[step].2[place]).collect();
            let estimation = known.and_then(|(knowledge, steps)| steps.estimation(knowledge, initial, value, &moved));
            let population = value.population(&initial.covariance);
            let left = initial.left.as_ref().filter(|_| estimation.is_none()); // `estimation` includes the variance by `left`
            Predicted {
                what: value.what,
                row: value.row,
                mean: value.mean,
                population: population + left.map_or(0.0, |left| value.population(left)),
                process: value.process,
                hangs_on_zero: known
                    .is_some_and(|(knowledge, steps)| steps.hangs_on_zero(knowledge, initial, value, &moved)),
                is_drawn_to_zero: known
                    .is_some_and(|(knowledge, _)| ValueSteps::is_drawn_to_zero(knowledge, initial, value)),
                estimation,
                limits: MeanLimits::Error,
            }
        };
        let of_phase = |(place, phase): (usize, &PhaseTrajectory)| {
            let step = |(number, (rows, time, values)): (usize, &StepValues)| {
                let all = values.iter().enumerate().map(|(at, value)| predicted(place, number, at, value));
                StepPredictions { rows: rows.clone(), time: *time, values: all.collect() }
            };
            PhasePredictions { phase: phase.phase, steps: phase.steps.iter().enumerate().map(step).collect() }
        };
        self.phases.iter().enumerate().map(of_phase).collect()
    }
}
