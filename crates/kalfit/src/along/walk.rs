//! The results along the record of one test: measured and predicted values, innovations, smoothed states.

use crate::along::MAX_QUANTILES;
use crate::along::thin::{quantiles, thinned, with_largest};
use kalfit_apply::apply::{Applied, ApplyError, PhaseStates, StateKind};
use kalfit_filter::innovations::{Innovation, InnovationFilter};
use kalfit_model::PhasedModel;
use kalfit_model::{Evidence, PhasedTest};
use kalfit_record::{MeasurementAlong, PhaseAlong, StateAlong, TestAlong};

/// Model and filters that a test is evaluated with.
pub(super) struct RecordEvaluator<'a> {
    pub(super) model: &'a PhasedModel,
    pub(super) applied: &'a Applied<'a>,
    pub(super) filter: &'a InnovationFilter,
    /// Number of values of a series that are included.
    pub(super) values: usize,
}

/// A measured value, with the predicted value and standard deviation.
struct MeasuredValue {
    at: f64,
    measured: f64,
    predicted: f64,
    std_dev: f64,
}

impl RecordEvaluator<'_> {
    /// The results along the record of a test; `place`: index of the test among the tests that the model is applied to.
    pub(super) fn test(&self, test: &PhasedTest, place: usize) -> Result<TestAlong, ApplyError> {
        let of = |kind| self.applied.states(kind, place..place + 1).map(|mut all| all.pop().unwrap_or_default());
        let predicted = of(StateKind::Predicted)?;
        let measured: Vec<Vec<Vec<MeasuredValue>>> = predicted.iter().map(|phase| self.measured(test, phase)).collect();
        drop(predicted); // predicted and smoothed states are not in memory at the same time: records may be very long
        let seen = self.filter.run(std::slice::from_ref(test)).pop().transpose()?.flatten();
        let seen = seen.map_or(Vec::new(), |own| own.series);
        let smoothed = of(StateKind::Smoothed)?;
        let one = |(states, measured): (&PhaseStates, Vec<Vec<MeasuredValue>>)| {
            let phase = &self.model.phases[states.phase];
            let included = thinned(states.steps.len(), self.values);
            let measurements = measured.into_iter().enumerate().map(|(m, values)| {
                let own = seen.iter().filter(|one| one.phase == states.phase && one.measurement == m);
                self.measurement(&phase.model.measurements[m].name, &values, &own.collect::<Vec<_>>())
            });
            PhaseAlong {
                name: phase.name.clone(),
                steps: states.steps.len(),
                at: included.iter().map(|&step| time(states.steps[step].time)).collect(),
                states: self.states(states, &included),
                measurements: measurements.filter(|own| own.values > 0).collect(),
            }
        };
        Ok(TestAlong { id: test.id.to_string(), phases: smoothed.iter().zip(measured).map(one).collect() })
    }

    /// Measured values of a phase, by measurement.
    fn measured(&self, test: &PhasedTest, states: &PhaseStates) -> Vec<Vec<MeasuredValue>> {
        let model = &self.model.phases[states.phase].model;
        let mut all: Vec<Vec<MeasuredValue>> = model.measurements.iter().map(|_| Vec::new()).collect();
        let Some(Evidence::Rows(rows)) = test.phases.get(states.phase) else { return all };
        for step in &states.steps {
            for one in &step.measurements {
                let measured = rows.numbers(one.row)[model.measurements[one.measurement].column];
                let own = MeasuredValue { at: time(step.time), measured, predicted: one.value, std_dev: one.std_dev };
                all[one.measurement].push(own);
            }
        }
        all
    }

    fn measurement(&self, name: &str, values: &[MeasuredValue], seen: &[&Innovation]) -> MeasurementAlong {
        let standardised_residual =
            |one: &MeasuredValue| if one.std_dev > 0.0 { (one.measured - one.predicted) / one.std_dev } else { 0.0 };
        let included = with_largest(&values.iter().map(standardised_residual).collect::<Vec<f64>>(), self.values);
        let of = |own: &dyn Fn(&MeasuredValue) -> f64| included.iter().map(|&place| own(&values[place])).collect();
        let sizes: Vec<f64> = seen.iter().map(|one| one.standardised).collect();
        let shown = with_largest(&sizes, self.values);
        MeasurementAlong {
            name: name.to_owned(),
            values: values.len(),
            at: of(&|one| one.at),
            measured: of(&|one| one.measured),
            predicted: of(&|one| one.predicted),
            std_dev: of(&|one| one.std_dev),
            innovations: sizes.len(),
            innovations_at: shown.iter().map(|&place| time(seen[place].time)).collect(),
            standardised: shown.iter().map(|&place| sizes[place]).collect(),
            quantiles: quantiles(&sizes, MAX_QUANTILES),
        }
    }

    fn states(&self, states: &PhaseStates, included: &[usize]) -> Vec<StateAlong> {
        let model = &self.model.phases[states.phase].model;
        let one = |(i, state): (usize, &kalfit_model::State)| StateAlong {
            name: state.name.clone(),
            unit: state.unit.clone(),
            mean: included.iter().map(|&step| states.steps[step].mean[i]).collect(),
            std_dev: included.iter().map(|&step| states.steps[step].std_dev[i]).collect(),
        };
        model.states.iter().enumerate().map(one).collect()
    }
}

/// Time of a step; NaN where the step has no time.
fn time(of: Option<f64>) -> f64 {
    of.unwrap_or(f64::NAN)
}
