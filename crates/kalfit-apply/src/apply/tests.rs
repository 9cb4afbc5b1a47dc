//! States compared with the joint Gaussian of a whole record, computed densely.

use nalgebra::{DMatrix, DVector};

use crate::apply::{Applied, Laws, StateKind, StepStates};
use kalfit_fixtures::dense::Linear;
use kalfit_fixtures::near;
use kalfit_model::Labels;
use kalfit_model::PhasedTest;
use kalfit_model::build::{Columns, ModelBuilder, constant, measurement, name, phase, random_walk};
use kalfit_model::{Alpha, Model, PhasedModel, Population};

/// Times of the rows: two rows have equal times, and one row has no measurements.
const TIMES: [f64; 7] = [0.0, 0.5, 0.5, 2.0, 2.3, 4.0, 4.5];
const U: [f64; 7] = [1.0, -0.5, 2.0, 0.3, 0.0, -1.5, 0.7];
const NAN: f64 = f64::NAN;
const Y: [f64; 7] = [1.3, 0.2, 2.9, NAN, 0.4, NAN, 2.0];
const Z: [f64; 7] = [NAN, 2.1, NAN, 1.4, NAN, NAN, 3.2];
const DENSITY: f64 = 0.6;
const START: f64 = 0.3;
/// Standard deviations of y and z.
const NOISE: [f64; 2] = [0.5, 0.8];
const CONSTANT: f64 = 1.5;

/// y = bias + u slope + walk, z = 2 walk + 1.5; the walk has a known start.
fn states(walk: (f64, f64), unknown: bool) -> ModelBuilder {
    let own = |name: &str| if unknown { constant(name) } else { constant(name).known(0.0, 0.0) };
    Model::builder("a walk")
        .time("t")
        .state(own("bias"))
        .state(own("slope"))
        .state(random_walk("walk", DENSITY).known(walk.0, walk.1))
        .measurement(measurement("y", name("bias") + name("u") * name("slope") + name("walk"), NOISE[0]))
        .measurement(measurement("z", 2.0 * name("walk") + CONSTANT, NOISE[1]))
}

fn population() -> Population {
    let covariance = DMatrix::from_row_slice(2, 2, &[1.2, 0.4, 0.4, 0.7]);
    Population { mean: vec![0.5, -0.3], coefficients: vec![], covariance }
}

/// Joint law of (bias, slope, walk at each distinct time), and the measurements.
struct Dense {
    times: Vec<f64>,
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// (step, row of H, value - constant, variance) of each measurement, in order.
    seen: Vec<(usize, DVector<f64>, f64, f64)>,
}

impl Dense {
    fn new() -> Dense {
        let mut times = TIMES.to_vec();
        times.dedup();
        let (own, n) = (population(), 2 + times.len());
        let mut mean = DVector::zeros(n);
        (mean[0], mean[1]) = (own.mean[0], own.mean[1]);
        let walk = |i: usize, k: usize| START * START + DENSITY * DENSITY * times[i.min(k)];
        let covariance = DMatrix::from_fn(n, n, |i, k| match (i.checked_sub(2), k.checked_sub(2)) {
            (None, None) => own.covariance[(i, k)],
            (Some(i), Some(k)) => walk(i, k),
            _ => 0.0,
        });
        let mut dense = Dense { times, mean, covariance, seen: Vec::new() };
        for row in 0..TIMES.len() {
            let step = dense.times.iter().position(|time| *time == TIMES[row]).expect("it is one of them");
            let mut y = DVector::zeros(n);
            (y[0], y[1], y[2 + step]) = (1.0, U[row], 1.0);
            let mut z = DVector::zeros(n);
            z[2 + step] = 2.0;
            dense.see(step, y, Y[row], NOISE[0]);
            dense.see(step, z, Z[row] - CONSTANT, NOISE[1]);
        }
        dense
    }

    fn see(&mut self, step: usize, h: DVector<f64>, value: f64, noise: f64) {
        if !value.is_nan() {
            self.seen.push((step, h, value, noise * noise));
        }
    }

    /// Mean and covariance given the measurements of the steps at which `counts` holds.
    fn given(&self, counts: impl Fn(usize) -> bool) -> (DVector<f64>, DMatrix<f64>) {
        let seen: Vec<_> = self.seen.iter().filter(|seen| counts(seen.0)).collect();
        let h = DMatrix::from_fn(seen.len(), self.mean.len(), |i, k| seen[i].1[k]);
        let law = Linear {
            residual: DVector::from_fn(seen.len(), |i, _| seen[i].2),
            sensitivity: h,
            covariance: DMatrix::from_diagonal(&DVector::from_fn(seen.len(), |i, _| seen[i].3)),
        };
        law.given(&self.mean, &self.covariance)
    }

    /// Compares states along the record with the joint law.
    fn compare(&self, kind: StateKind, found: &[StepStates]) {
        assert_eq!(found.len(), self.times.len(), "steps");
        for (step, states) in found.iter().enumerate() {
            assert_eq!(states.time, Some(self.times[step]));
            let (mean, covariance) = match kind {
                StateKind::Predicted => self.given(|other| other < step),
                StateKind::Filtered => self.given(|other| other <= step),
                StateKind::Smoothed => self.given(|_| true),
            };
            for (state, at) in [0, 1, 2 + step].into_iter().enumerate() {
                near::mixed(format_args!("{kind:?} {step} {state}"), states.mean[state], mean[at], 1e-11);
                near::mixed(
                    format_args!("its deviation {kind:?} {step}"),
                    states.std_dev[state],
                    covariance[(at, at)].sqrt(),
                    1e-11,
                );
            }
            let own: Vec<_> = self.seen.iter().filter(|seen| seen.0 == step).collect();
            assert_eq!(states.measurements.len(), own.len(), "measurements of step {step}");
            for prediction in &states.measurements {
                let (noise, constant) = (NOISE[prediction.measurement], [0.0, CONSTANT][prediction.measurement]);
                let h = DVector::from_fn(mean.len(), |at, _| match (prediction.measurement, at) {
                    (0, 0) => 1.0,
                    (0, 1) => U[prediction.row],
                    (measurement, at) if at == 2 + step => [1.0, 2.0][measurement],
                    _ => 0.0,
                });
                let noise = if kind == StateKind::Predicted { noise * noise } else { 0.0 };
                near::mixed("prediction", prediction.value, h.dot(&mean) + constant, 1e-11);
                near::mixed("deviation", prediction.std_dev, ((&covariance * &h).dot(&h) + noise).sqrt(), 1e-11);
            }
        }
    }
}

fn cells(model: &PhasedModel, rows: std::ops::Range<usize>) -> PhasedTest {
    let mut labels = Labels::new(&model.shared().literals);
    let some = |cells: &[f64]| cells[rows.clone()].to_vec();
    let columns = Columns::new("record").numbers("t", some(&TIMES)).numbers("u", some(&U));
    columns.numbers("y", some(&Y)).numbers("z", some(&Z)).test(model, &mut labels).expect("it is of the model")
}

#[test]
fn states_are_those_of_the_joint_gaussian() {
    let model = states((0.0, START), true).build().expect("a model");
    let (alpha, population, tests) = (Alpha::default(), population(), [cells(&model, 0..TIMES.len())]);
    let applied = Applied::new(&model, &alpha, &population, &tests).expect("it applies");
    for kind in [StateKind::Predicted, StateKind::Filtered, StateKind::Smoothed] {
        let found = applied.states(kind, 0..1).expect("states");
        Dense::new().compare(kind, &found[0][0].steps);
    }
}

#[test]
fn what_tests_say_is_that_of_the_joint_gaussian() {
    let model = states((0.0, START), true).build().expect("a model");
    let (alpha, population, tests) = (Alpha::default(), population(), [cells(&model, 0..TIMES.len())]);
    let said =
        Applied::new(&model, &alpha, &population, &tests).and_then(|applied| applied.said()).expect("it applies");
    let (mean, covariance) = Dense::new().given(|_| true);
    let own = said.posteriors.get(0);
    for i in 0..2 {
        near::mixed("posterior", own.mean[i], mean[i], 1e-11);
        near::mixed("its variance", own.covariance(0)[(i, i)], covariance[(i, i)], 1e-11);
    }
    let innovations = said.innovations[0].as_ref().expect("rows were filtered");
    near::mixed("log density", own.log_likelihood, innovations.log_likelihood, 1e-11);
    let verdict = said.verdict(&Laws::known(&said));
    near::mixed("of all", verdict.log_density, own.log_likelihood, 1e-11);
    near::mixed("squares", verdict.residual.squared + verdict.distance.squared, innovations.summary.nis, 1e-11);
    assert_eq!(verdict.residual.degrees_of_freedom, Dense::new().seen.len() - 2);
    assert_eq!(verdict.distance.degrees_of_freedom, 2);
}

/// The residual does not depend on the population.
#[test]
fn the_residual_does_not_depend_on_the_population() {
    let model = states((0.0, START), true).build().expect("a model");
    let (alpha, tests) = (Alpha::default(), [cells(&model, 0..TIMES.len())]);
    let other = Population { mean: vec![7.0, -4.0], covariance: DMatrix::identity(2, 2) * 0.2, ..population() };
    let residual = |population: &Population| {
        let said = Applied::new(&model, &alpha, population, &tests).and_then(|applied| applied.said());
        said.expect("it applies").residuals[0].expect("rows were filtered")
    };
    let (found, expected) = (residual(&other), residual(&population()));
    near::mixed("squares", found.0, expected.0, 1e-11);
    assert_eq!(found.1, expected.1);
}

/// A record, cut between two rows of equal time into two phases, of which the second starts at the end of the first.
#[test]
fn a_record_in_two_phases_has_the_states_of_the_whole() {
    let (first, second) = (states((0.0, START), true), states((0.0, 0.0), false));
    let names = ["bias", "slope", "walk"];
    let onward = names.iter().fold(phase("second", &second), |phase, name| phase.carry(*name, *name));
    let model = PhasedModel::builder("phase").phase(phase("first", &first)).phase(onward).build().expect("a model");
    let tests = [PhasedTest {
        id: "record".into(),
        phases: [0..2, 2..TIMES.len()]
            .into_iter()
            .map(|rows| cells(&first.build().expect("a model"), rows).phases[0].clone())
            .collect(),
    }];
    let (alpha, population) = (Alpha::default(), population());
    let applied = Applied::new(&model, &alpha, &population, &tests).expect("it applies");
    let dense = Dense::new();
    let found = applied.states(StateKind::Smoothed, 0..1).expect("states");
    let [before, after] = &found[0][..] else { panic!("two phases: {}", found[0].len()) };
    let (mean, covariance) = dense.given(|_| true);
    // the last step of the first phase and the first step of the second phase have equal times
    let steps = before.steps.iter().enumerate().chain(after.steps.iter().enumerate().map(|(k, step)| (k + 1, step)));
    for (step, states) in steps {
        for (state, at) in [0, 1, 2 + step].into_iter().enumerate() {
            near::mixed(format_args!("step {step}, state {state}"), states.mean[state], mean[at], 1e-11);
            near::mixed("its deviation", states.std_dev[state], covariance[(at, at)].sqrt(), 1e-11);
        }
    }
    // the states of the second phase also depend on the measurements of the first phase
    let filtered = applied.states(StateKind::Filtered, 0..1).expect("states");
    for (step, states) in filtered[0][1].steps.iter().enumerate() {
        let (mean, covariance) = dense.given(|other| other <= step + 1);
        for (state, at) in [0, 1, 3 + step].into_iter().enumerate() {
            near::mixed(format_args!("filtered {step}, state {state}"), states.mean[state], mean[at], 1e-11);
            near::mixed("its deviation", states.std_dev[state], covariance[(at, at)].sqrt(), 1e-11);
        }
    }
}
