//! Predictions compared with the law of a random walk, written out.

use nalgebra::DMatrix;

use crate::predict::{Initial, Output, PhasePredictions, Predicted, Predictor, What};
use kalfit_fixtures::near;
use kalfit_infer::{Estimand, Estimated, Knowledge};
use kalfit_model::Labels;
use kalfit_model::PhasedTest;
use kalfit_model::build::{Columns, ModelBuilder, constant, fixed, measurement, name, phase, random_walk};
use kalfit_model::{Alpha, Model, PhasedModel, Population};

const TIMES: [f64; 6] = [0.0, 0.5, 0.5, 2.0, 4.0, 4.5];
const U: [f64; 6] = [1.0, -0.5, 2.0, 0.3, 0.0, -1.5];
const START: f64 = 0.3;
const DENSITY: f64 = 0.6;
const MEAN: [f64; 2] = [0.5, -0.3];
const SIGMA: [f64; 4] = [1.2, 0.4, 0.4, 0.7];

/// y = bias + u slope + walk + 1.5; the walk has a known start.
fn states(walk: (f64, f64), unknown: bool) -> ModelBuilder {
    let own = |name: &str| if unknown { constant(name) } else { constant(name).known(0.0, 0.0) };
    Model::builder("a walk")
        .time("t")
        .parameter(fixed("q", DENSITY))
        .state(own("bias"))
        .state(own("slope"))
        .state(random_walk("walk", name("q")).known(walk.0, walk.1))
        .measurement(measurement("y", name("bias") + name("u") * name("slope") + name("walk") + 1.5, 1.0))
}

fn population() -> Population {
    Population { mean: MEAN.to_vec(), coefficients: vec![], covariance: DMatrix::from_row_slice(2, 2, &SIGMA) }
}

fn cells(model: &PhasedModel, rows: std::ops::Range<usize>) -> PhasedTest {
    let mut labels = Labels::new(&model.shared().literals);
    let columns = Columns::new("mission").numbers("t", TIMES[rows.clone()].to_vec());
    let columns = columns.numbers("u", U[rows.clone()].to_vec()).numbers("y", vec![f64::NAN; rows.len()]);
    columns.test(model, &mut labels).expect("it is of the model")
}

/// The measurement of each phase as an output.
fn outputs(model: &PhasedModel) -> Vec<Vec<Output>> {
    let of = |model: &Model| {
        let one = &model.measurements[0];
        vec![Output { name: one.name.clone(), unit: None, equation: one.equation.clone() }]
    };
    model.phases.iter().map(|phase| of(&phase.model)).collect()
}

fn predicted(model: &PhasedModel, test: PhasedTest, knowledge: Knowledge) -> Vec<PhasePredictions> {
    let alpha = Alpha::fixed(&model.shared().parameters).expect("all are fixed");
    let predictor = Predictor::new(model, &outputs(model), (&alpha, &[]), Some(knowledge)).expect("it predicts");
    let initial = Initial::new(model, &population());
    predictor.predict(&[test], &[&initial]).expect("rows").remove(0)
}

/// Mean, variance by the initial state and variance by process noise of (bias, slope, walk, y).
fn expected(what: What, time: f64, u: f64) -> [f64; 3] {
    let walk = START * START + DENSITY * DENSITY * time;
    let [a, b, _, c] = SIGMA;
    match what {
        What::State(0) => [MEAN[0], a, 0.0],
        What::State(1) => [MEAN[1], c, 0.0],
        What::State(_) => [0.0, 0.0, walk],
        What::Output(_) => [MEAN[0] + u * MEAN[1] + 1.5, a + 2.0 * u * b + u * u * c, walk],
    }
}

fn compare(value: &Predicted, (time, row): (f64, usize)) {
    let [mean, population, process] = expected(value.what, time, U[row]);
    near::mixed(format_args!("mean of {:?} in row {row}", value.what), value.mean, mean, 1e-9);
    near::mixed("by the initial state", value.population, population, 1e-9);
    near::mixed("by process noise", value.process, process, 1e-9);
}

#[test]
fn every_part_is_that_of_the_walk() {
    let model = states((0.0, START), true).build().expect("a model");
    let found = predicted(&model, cells(&model, 0..TIMES.len()), Knowledge::exact());
    let steps = &found[0].steps;
    assert_eq!(steps.len(), 5, "two rows are of one time");
    assert_eq!(steps[1].values.len(), 3 + 2, "three states, and the output in two rows");
    for step in steps {
        let time = step.time.expect("there are times");
        step.values.iter().for_each(|value| compare(value, (time, value.row)));
    }
}

/// A mission in two phases, cut between two rows of the same time, has the predictions of the whole.
#[test]
fn phases_go_on_where_the_last_one_ended() {
    let (first, second) = (states((0.0, START), true), states((0.0, 0.0), false));
    let onward = ["bias", "slope", "walk"].iter().fold(phase("on", &second), |phase, name| phase.carry(*name, *name));
    let model = PhasedModel::builder("phase").phase(phase("first", &first)).phase(onward).build().expect("a model");
    let single = first.build().expect("a model");
    let phases = [0..2, 2..TIMES.len()].into_iter().map(|rows| cells(&single, rows).phases[0].clone()).collect();
    let found = predicted(&model, PhasedTest { id: "mission".into(), phases }, Knowledge::exact());
    for (phase, first) in found.iter().zip([0, 2]) {
        for step in &phase.steps {
            let time = step.time.expect("there are times");
            step.values.iter().for_each(|value| compare(value, (time, first + value.row)));
        }
    }
}

#[test]
fn what_estimates_leave_open_follows_by_derivatives() {
    let model = states((0.0, START), true).build().expect("a model");
    let quantities = [
        Estimand::Population(Estimated::Mean(0)),
        Estimand::Population(Estimated::Mean(1)),
        Estimand::Population(Estimated::Covariance(1, 0)),
        Estimand::Population(Estimated::Covariance(1, 1)),
        Estimand::Parameter { parameter: 0, level: None },
    ];
    let root = DMatrix::from_fn(5, 5, |i, k| if k > i { 0.0 } else { 0.1 + 0.05 * (i * 5 + k) as f64 % 0.3 });
    let covariance = &root * root.transpose();
    let knowledge = Knowledge {
        quantities: quantities.to_vec(),
        covariance: covariance.clone(),
        open: vec![],
        at_zero: vec![],
        tests: 100.0,
        few_tests: None,
        is_restricted: false,
    };
    let found = predicted(&model, cells(&model, 0..TIMES.len()), knowledge.clone());
    for step in &found[0].steps {
        let time = step.time.expect("there are times");
        for value in step.values.iter().filter(|value| matches!(value.what, What::Output(_))) {
            let u = U[value.row];
            let slope = 2.0 * DENSITY * time;
            let by_mean = [1.0, u, 0.0, 0.0, 0.0];
            let by_variance = [0.0, 0.0, 2.0 * u, u * u, slope];
            let by_population = [0.0, 0.0, 2.0 * u, u * u, 0.0];
            let variance = |of: [f64; 5]| -> f64 {
                (0..5).map(|i| (0..5).map(|k| of[i] * of[k] * covariance[(i, k)]).sum::<f64>()).sum()
            };
            let estimation = value.estimation.expect("all is determined");
            near::mixed("of the mean", estimation.mean, variance(by_mean), 1e-9);
            near::mixed("of the variance", estimation.variance, variance(by_variance), 1e-9);
            near::mixed("of that by the initial state", estimation.population, variance(by_population), 1e-9);
            assert_eq!(estimation.lost, 1);
        }
    }
    // the walk depends on q alone, the bias on no open quantity
    let open = Knowledge { open: vec![Estimand::Parameter { parameter: 0, level: None }], ..Knowledge::exact() };
    let found = predicted(&model, cells(&model, 0..TIMES.len()), open);
    let last = &found[0].steps[4].values;
    assert!(last[0].estimation.is_some(), "{:?}", last[0]);
    assert!(last[2].estimation.is_none() && last[3].estimation.is_none(), "{last:?}");
}

#[test]
fn a_known_group_is_told_from_a_new_one() {
    let model = states((0.0, START), true).build().expect("a model");
    let level = DMatrix::from_row_slice(2, 2, &[0.5, 0.1, 0.1, 0.3]);
    let mut both = DMatrix::zeros(4, 4);
    both.view_mut((0, 0), (2, 2)).copy_from(&population().covariance);
    both.view_mut((2, 2), (2, 2)).copy_from(&level);
    let whole = Population { mean: vec![0.5, -0.3, 0.0, 0.0], coefficients: vec![], covariance: both };
    let left = DMatrix::from_row_slice(2, 2, &[0.1, 0.02, 0.02, 0.2]);
    let mut grouped = model.clone();
    grouped.levels = vec![kalfit_model::GroupLevel {
        name: "unit".to_owned(),
        column: 0,
        crossed: false,
        covariance: model.phases[0].model.covariance.clone(),
        members: Vec::new(),
    }];
    let initial = Initial::of_group(&grouped, &whole, (vec![0.9, -0.5], &left), None);
    near::mixed("variance", initial.covariance[(0, 1)], 0.4, 1e-9);
    near::mixed("what is left open", initial.left.as_ref().expect("of a known group")[(0, 1)], 0.02, 1e-9);
    let expected = &left * level.try_inverse().expect("positive");
    let found = initial.shrinkage.expect("there is one level");
    found.iter().zip(&expected).for_each(|(found, expected)| near::mixed("shrinkage", *found, *expected, 1e-9));
    let new = Initial::new(&grouped, &whole);
    near::mixed("of a new group", new.covariance[(1, 1)], 0.7 + 0.3, 1e-9);
}

/// Degrees of freedom are lost to the means of the states in a value and to the columns that the means are regressed
/// on, whatever the values of the columns.
#[test]
fn degrees_of_freedom_are_lost_by_the_fit_not_by_the_place() {
    let model = Model::builder("two")
        .state(constant("a"))
        .state(constant("b"))
        .measurement(measurement("y", name("a") + name("b"), 1.0))
        .regress_mean("a", "lot")
        .regress_mean("b", "lot")
        .build()
        .expect("a model");
    let quantities = [Estimated::Mean(0), Estimated::Mean(1), Estimated::Coefficient(0), Estimated::Coefficient(1)];
    let knowledge = Knowledge {
        quantities: quantities.map(Estimand::Population).to_vec(),
        covariance: DMatrix::identity(4, 4) * 0.1,
        ..Knowledge::exact()
    };
    let alpha = Alpha::default();
    for lot in [0.0, 1e-300, 2.0] {
        let mut labels = Labels::new(&[]);
        let test = Columns::new("t").numbers("lot", [lot]).numbers("y", [f64::NAN]).test(&model, &mut labels);
        let outputs = outputs(&model);
        let predictor = Predictor::new(&model, &outputs, (&alpha, &[0.3, 0.4]), Some(knowledge.clone()));
        let initial = Initial::new(&model, &population());
        let found = predictor.and_then(|predictor| predictor.predict(&[test.expect("it is")], &[&initial]));
        for value in &found.expect("it predicts")[0][0].steps[0].values {
            assert_eq!(value.estimation.expect("all is known").lost, 2, "{:?} at {lot}", value.what);
        }
    }
}

/// Degrees of freedom lost by a, b and y = a + b/2, where `covariance` is the error covariance of `quantities`.
fn lost(quantities: &[Estimated], covariance: &DMatrix<f64>, sigma: &DMatrix<f64>) -> Vec<usize> {
    let builder = Model::builder("two").state(constant("a")).state(constant("b"));
    let measured = measurement("y", name("a") + name("u") * name("b"), 1.0);
    let model = builder.measurement(measured).build().expect("a model");
    let knowledge = Knowledge {
        quantities: quantities.iter().map(|&own| Estimand::Population(own)).collect(),
        covariance: covariance.clone(),
        ..Knowledge::exact()
    };
    let mut labels = Labels::new(&[]);
    let test = Columns::new("t").numbers("u", [0.5]).numbers("y", [f64::NAN]).test(&model, &mut labels);
    let (outputs, alpha) = (outputs(&model), Alpha::default());
    let predictor = Predictor::new(&model, &outputs, (&alpha, &[]), Some(knowledge)).expect("it predicts");
    let population = Population { mean: MEAN.to_vec(), coefficients: vec![], covariance: sigma.clone() };
    let initial = Initial::new(&model, &population);
    let found = predictor.predict(&[test.expect("it is")], &[&initial]).expect("rows");
    found[0][0].steps[0].values.iter().map(|value| value.estimation.expect("all is known").lost).collect()
}

/// Two variances with perfectly correlated estimates lose two degrees of freedom each; a slope that is identical in all
/// tests costs one degree of freedom where the error of the slope is noticeable.
#[test]
fn degrees_of_freedom_are_lost_to_all_means_beside_one_variance() {
    let (mean, variance) = (Estimated::Mean, |i| Estimated::Covariance(i, i));
    let both = [mean(0), mean(1), variance(0), variance(1)];
    let of = |together: f64| {
        DMatrix::from_row_slice(
            4,
            4,
            &[0.1, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.2, together, 0.0, 0.0, together, 0.2],
        )
    };
    let unit = DMatrix::identity(2, 2);
    assert_eq!(lost(&both, &of(0.0), &unit), [1, 1, 1], "a, b and y of variances by themselves");
    assert_eq!(lost(&both, &of(0.2), &unit), [2, 2, 2], "of equal ones");
    let one = DMatrix::from_element(2, 2, 1.0);
    assert_eq!(lost(&both, &of(0.2), &one), [1, 1, 1], "of states that vary as one");
    let fixed = DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.0, 0.0]);
    for (error, expected) in [(0.1, 2), (1e-4, 1)] {
        let covariance = DMatrix::from_diagonal(&nalgebra::DVector::from_vec(vec![0.1, error, 0.2]));
        let found = lost(&[mean(0), mean(1), variance(0)], &covariance, &fixed);
        assert_eq!([found[0], found[2]], [1, expected], "a and y of a slope known to {error}");
    }
}
