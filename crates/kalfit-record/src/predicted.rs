//! Predictions of tests that have not been made, at the end of each.

use serde::{Deserialize, Serialize};

use kalfit_apply::predict::{
    Bounds, Ellipse, Limits, Output, Pair, PhasePredictions, Predicted, Sides, StepPredictions, What,
};
use kalfit_model::PhasedModel;

/// Predictions in short: the last row of each of the first tests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PredictedRecord {
    /// Title of the model.
    pub title: String,
    /// What the parameters were taken from, as named by the user.
    pub from: String,
    /// Number of designs.
    pub tests: usize,
    /// Number of rows of all designs.
    pub rows: usize,
    /// `new`, or `known`: whether tests are of units that the fit knows.
    pub units: String,
    /// Confidence of the limits.
    pub confidence: f64,
    /// Fraction of all tests that is within the tolerance limits.
    pub content: f64,
    /// Whether each tolerance limit is meant by itself.
    pub one_sided: bool,
    /// How many tests, or groups of the outermost level, the population was estimated from; null where it was given.
    pub fitted: Option<usize>,
    /// Whether it is known how far the estimates can be trusted.
    pub estimation: bool,
    /// Whether limits of means are by profile likelihood.
    #[serde(default)]
    pub profile: bool,
    /// Whether errors of the means of known units contain those of the estimated covariances; null for new units, and
    /// where the parameters were given.
    #[serde(default)]
    pub covariance_errors: Option<bool>,
    /// Parameters that were given other values.
    pub changed: Vec<String>,
    /// Values at the last row of each of the first tests.
    pub last: Vec<PredictedValueRecord>,
    /// Two outputs together at the last row of each of the first tests.
    pub pairs: Vec<PairRecord>,
}

/// One value that was predicted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PredictedValueRecord {
    /// Id of the test.
    pub test: String,
    /// Name of the phase.
    pub phase: String,
    /// Row of the phase, from 1.
    pub row: usize,
    /// Time of the row.
    pub time: Option<f64>,
    /// Name of the state or the output.
    pub name: String,
    /// `state` or `output`.
    pub what: String,
    /// Unit of the value, a label.
    pub unit: Option<String>,
    /// Mean over tests.
    pub mean: f64,
    /// Standard deviation of the value that will be observed about the mean: all three parts together, as far as they
    /// are known.
    pub std_dev: f64,
    /// Standard deviation from test to test, by the initial state.
    pub std_dev_population: f64,
    /// Standard deviation by process noise, and by the known part of the initial variance.
    pub std_dev_process: f64,
    /// Standard deviation of the estimated mean; null where it is not known.
    pub std_dev_estimation: Option<f64>,
    /// Limits of the mean.
    pub confidence: Option<[f64; 2]>,
    /// Tolerance limits.
    pub tolerance: Option<[f64; 2]>,
    /// Limits that hold the value of one new test with the probability `content`.
    #[serde(default)]
    pub prediction: Option<[f64; 2]>,
    /// Degrees of freedom of these limits; null where they are by the normal law.
    #[serde(default)]
    pub df: Option<f64>,
}

/// Two outputs together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairRecord {
    /// Id of the test.
    pub test: String,
    /// Row of the phase, from 1.
    pub row: usize,
    /// Time of the row.
    pub time: Option<f64>,
    /// Names of the outputs.
    pub names: [String; 2],
    /// Half axes of the ellipse that holds the content, the longer first.
    pub axes: [f64; 2],
    /// Angle of the longer axis from the first output towards the second, in degrees.
    pub angle: f64,
    /// Radius of the circle about the means that holds half of all tests.
    pub cep: f64,
    /// Radius of the circle about zero that holds half of all tests.
    pub cep_about_zero: f64,
}

/// Origin of predictions, and the options of the computation.
#[derive(Debug, Clone)]
pub struct PredictedSource {
    /// Origin, as named by the user.
    pub name: String,
    /// Number of tests, or groups of the outermost level, that the population was estimated from; `None` where unknown.
    pub fitted: Option<usize>,
    /// Parameters that were given other values.
    pub changed: Vec<String>,
    /// Whether tests are of units that the fit knows.
    pub known_units: bool,
    /// Whether it is known how far the estimates can be trusted.
    pub estimation: bool,
    /// Whether limits of means are by profile likelihood.
    pub profile: bool,
    /// Whether errors of the means of known units contain those of the estimated covariances; `None` for new units.
    pub covariance_errors: Option<bool>,
}

/// Largest number of tests whose last rows are included.
const MOST_TESTS: usize = 3;

impl PredictedRecord {
    /// A record without tests.
    pub fn new(
        model: &PhasedModel,
        source: PredictedSource,
        Limits { confidence, content, sides }: Limits,
    ) -> PredictedRecord {
        PredictedRecord {
            title: model.shared().title.clone(),
            from: source.name,
            tests: 0,
            rows: 0,
            units: if source.known_units { "known" } else { "new" }.to_owned(),
            confidence,
            content,
            one_sided: sides == Sides::One,
            fitted: source.fitted,
            estimation: source.estimation,
            profile: source.profile,
            covariance_errors: source.covariance_errors,
            changed: source.changed,
            last: Vec::new(),
            pairs: Vec::new(),
        }
    }

    /// Adds the predictions of one test. `outputs`: the outputs of each phase; the sum of two outputs is a third
    /// output, the last.
    pub fn add(
        &mut self,
        (model, outputs, bounds): (&PhasedModel, &[Vec<Output>], &Bounds),
        test: &str,
        phases: &[PhasePredictions],
    ) {
        self.tests += 1;
        self.rows += phases.iter().flat_map(|phase| &phase.steps).map(|step| step.rows.len()).sum::<usize>();
        let Some((phase, step)) = phases.last().and_then(|phase| Some((phase.phase, phase.steps.last()?))) else {
            return;
        };
        if self.tests > MOST_TESTS {
            return;
        }
        let last = step.rows.end - 1;
        let is_last = |value: &&Predicted| matches!(value.what, What::State(_)) || value.row == last;
        let own = step.values.iter().filter(is_last);
        let named = own.filter_map(|value| Some((value, name_of((model, &outputs[phase]), phase, value.what)?)));
        let records = named.map(|(value, (name, what, unit))| {
            let new_test = bounds.of_new_test(value);
            PredictedValueRecord {
                test: test.to_owned(),
                phase: model.phases[phase].name.clone(),
                row: value.row + 1,
                time: step.time,
                name: name.to_owned(),
                what: what.to_owned(),
                unit: unit.map(str::to_owned),
                mean: value.mean,
                std_dev: value.std_dev(),
                std_dev_population: value.population.sqrt(),
                std_dev_process: value.process.sqrt(),
                std_dev_estimation: value.estimation.map(|estimation| estimation.mean.sqrt()),
                confidence: bounds.of_mean(value),
                tolerance: bounds.of_tests(value),
                prediction: new_test.map(|(limits, _)| limits),
                df: new_test.map(|(_, degrees)| degrees).filter(|degrees| degrees.is_finite()),
            }
        });
        self.last.extend(records.collect::<Vec<_>>());
        self.pairs.extend(pair(&outputs[phase], test, step, bounds.limits().content));
    }
}

/// Name, kind and unit of a predicted quantity; `None` for the sum of two outputs.
pub fn name_of<'a>(
    (model, outputs): (&'a PhasedModel, &'a [Output]),
    phase: usize,
    what: What,
) -> Option<(&'a str, &'static str, Option<&'a str>)> {
    match what {
        What::State(state) => {
            let state = &model.phases[phase].model.states[state];
            Some((&state.name, "state", state.unit.as_deref()))
        }
        What::Output(output) => {
            let output = outputs.get(output).filter(|output| !output.name.is_empty())?;
            Some((&output.name, "output", output.unit.as_deref()))
        }
    }
}

fn pair(outputs: &[Output], test: &str, step: &StepPredictions, content: f64) -> Option<PairRecord> {
    let [first, second, sum] = outputs else { return None };
    if !sum.name.is_empty() {
        return None;
    }
    let last = step.rows.end - 1;
    let of = |output: usize| step.values.iter().find(|value| value.what == What::Output(output) && value.row == last);
    let [a, b, both] = [of(0)?, of(1)?, of(2)?];
    let variance = |value: &Predicted| value.std_dev().powi(2);
    let covariance = 0.5 * (variance(both) - variance(a) - variance(b));
    let pair = Pair { mean: [a.mean, b.mean], variances: [variance(a), variance(b), covariance] };
    let Ellipse { axes, angle } = pair.ellipse(content);
    Some(PairRecord {
        test: test.to_owned(),
        row: last + 1,
        time: step.time,
        names: [first.name.clone(), second.name.clone()],
        axes,
        angle: angle.to_degrees(),
        cep: pair.circle(0.5),
        cep_about_zero: pair.circle_about_zero(0.5),
    })
}
