//! The exported matrices in a textbook filter, compared with the innovations of the model.

use nalgebra::{DMatrix, DVector};

use crate::apply::{Applied, StateKind};
use crate::export::{ExportError, Exported, Wanted, export};
use kalfit_filter::reduce::Preparer;
use kalfit_fixtures::near;
use kalfit_model::Labels;
use kalfit_model::build::{
    Columns, ModelBuilder, constant, fixed, gauss_markov, gauss_markov_2, integral, measurement, moving, name, phase,
    random_walk, stepping, text_is,
};
use kalfit_model::{Alpha, Model, PhasedModel, Population, Scope};
use kalfit_model::{Evidence, PhasedTest};

const STEP: f64 = 0.25;
const ROWS: usize = 40;

fn wave(seed: usize) -> Vec<f64> {
    (0..ROWS).map(|k| ((seed * 37 + k * 17) % 29) as f64 / 7.0 - 2.0).collect()
}

/// A wave with some missing values.
fn gappy(seed: usize) -> Vec<f64> {
    wave(seed).into_iter().enumerate().map(|(k, x)| if (k + seed) % 7 == 3 { f64::NAN } else { x }).collect()
}

fn test(model: &PhasedModel) -> PhasedTest {
    let times = (0..ROWS).map(|k| 3.0 + STEP * k as f64);
    let columns = Columns::new("record").numbers("t", times).numbers("u", wave(1)).numbers("v", wave(2));
    let columns = columns.numbers("y", gappy(3)).numbers("z", gappy(4)).every_number("T", 27.0).every_text("lot", "B");
    columns.test(model, &mut Labels::new(&model.shared().literals)).expect("it is of the model")
}

fn population(p: usize) -> Population {
    let root = DMatrix::from_fn(p, p, |i, k| if i >= k { 0.3 + ((i * 5 + k * 3) % 7) as f64 / 9.0 } else { 0.0 });
    let mean = (0..p).map(|i| 0.7 * i as f64 - 0.9).collect();
    Population { mean, coefficients: vec![], covariance: &root * root.transpose() }
}

/// (value, standard deviation) of the prediction of each measured value, row after row, by a textbook filter.
fn run(filter: &Exported, model: &PhasedModel, rows: &kalfit_model::Test) -> Vec<(f64, f64)> {
    let model = &model.phases[filter.phase].model;
    let u = |row: usize| {
        let scope = Scope { numbers: rows.numbers(row), texts: rows.texts(row), step: STEP, alpha: &Alpha::default() };
        DVector::from_iterator(filter.inputs.len(), filter.inputs.iter().map(|u| u.evaluate(&scope).expect("a number")))
    };
    let (mut x, mut p) = filter.start.clone().expect("it starts");
    let mut found = Vec::new();
    for row in 0..rows.rows() {
        if row > 0 || model.clock.step_first {
            let source = if model.clock.previous_inputs && row > 0 { row - 1 } else { row };
            x = &filter.F * x + &filter.B * u(source);
            p = &filter.F * p * filter.F.transpose() + &filter.Q;
        }
        let column = |m: &usize| rows.numbers(row)[model.measurements[*m].column];
        let seen: Vec<usize> =
            (0..filter.measurements.len()).filter(|&m| !column(&filter.measurements[m]).is_nan()).collect();
        let z = DVector::from_iterator(seen.len(), seen.iter().map(|&m| column(&filter.measurements[m])));
        let (h, r) = (filter.H.select_rows(&seen), filter.R.select_rows(&seen).select_columns(&seen));
        let predicted = &h * &x + filter.D.select_rows(&seen) * u(row);
        let s = &h * &p * h.transpose() + r;
        found.extend(predicted.iter().zip(s.diagonal().iter()).map(|(value, variance)| (*value, variance.sqrt())));
        let gain = &p * h.transpose() * s.clone().try_inverse().expect("positive");
        x += &gain * (z - predicted);
        p -= &gain * s * gain.transpose();
    }
    found
}

fn compare(what: &str, model: &PhasedModel, wanted: &Wanted) -> Exported {
    let alpha = Alpha::fixed(&model.shared().parameters).expect("all are known");
    let population = population(model.element_names().len());
    let tests = [test(model)];
    let filter = export(model, &alpha, &population, wanted).expect("it has constant matrices");
    let Evidence::Rows(rows) = &tests[0].phases[0] else { panic!("rows") };
    let found = run(&filter, model, rows);
    let applied = Applied::new(model, &alpha, &population, &tests).expect("it applies");
    let states = applied.states(StateKind::Predicted, 0..1).expect("states");
    let expected: Vec<_> = states[0][0].steps.iter().flat_map(|step| &step.measurements).collect();
    assert_eq!(found.len(), expected.len(), "{what}: measured values");
    for (k, ((value, deviation), own)) in found.into_iter().zip(expected).enumerate() {
        near::mixed(format_args!("{what}: value {k}"), value, own.value, 1e-10);
        near::mixed(format_args!("{what}: deviation {k}"), deviation, own.std_dev, 1e-10);
    }
    filter
}

fn stepped() -> Wanted {
    Wanted { step: Some(STEP), ..Wanted::default() }
}

fn at(wanted: Wanted, column: &str, value: &str) -> Wanted {
    let mut at = wanted.at.clone();
    at.push((column.to_owned(), value.to_owned()));
    Wanted { at, ..wanted }
}

/// Every process type in continuous time, with inputs and correlated noises.
fn instrument() -> ModelBuilder {
    let rate = name("bias") + name("drift") + 0.5 * name("slow") + name("gain") * (name("u") - 1.5) + 2.0;
    Model::builder("an instrument")
        .time("t")
        .state(constant("bias"))
        .state(moving("angle", rate, 0.2).estimated())
        .state(gauss_markov("drift", name("tau"), 0.4))
        .state(gauss_markov_2("slow", 3.0, 0.6))
        .state(random_walk("walk", 0.3).known(0.5, 0.1))
        .state(integral("sum", name("walk") + name("v")).estimated())
        .process_noise_covariance("angle", "walk", 0.03)
        .measurement(measurement("y", name("angle") + 0.3 * name("v") * name("u") - 4.0, 0.5))
        .measurement(measurement("z", name("sum") + name("drift"), 0.7))
        .noise_covariance("y", "z", 0.2)
        .parameter(fixed("tau", 2.0))
        .parameter(fixed("gain", 0.8))
}

#[test]
fn constant_matrices_give_the_innovations_of_the_model() {
    let model = instrument().build().expect("a model");
    let filter = compare("continuous", &model, &stepped());
    assert_eq!(filter.inputs.len(), 4, "u, v, their product and the constant: {:?}", filter.inputs);
    assert_eq!(filter.F.nrows(), 7, "the hidden rate is a state");
    compare("previous inputs", &instrument().previous_inputs().build().expect("a model"), &stepped());
}

#[test]
fn a_model_of_rows_needs_no_step() {
    let model = Model::builder("rows")
        .state(stepping("a", 0.8 * name("a") + 0.5 * name("u") + 0.1, 0.3).estimated())
        .state(stepping("b", 0.5 * name("b") + name("a"), 0.2).estimated())
        .process_noise_covariance("a", "b", 0.02)
        .measurement(measurement("y", name("a"), 0.5))
        .measurement(measurement("z", name("b") + 1.0, 0.4))
        .step_first();
    compare("rows", &model.build().expect("a model"), &Wanted::default());
    let refused = export(&model.build().expect("a model"), &Alpha::default(), &population(2), &stepped());
    assert!(matches!(refused, Err(ExportError::StepWithoutTime { .. })), "{refused:?}");
}

/// Coefficients that depend on columns are constant where the columns are constant.
#[test]
fn columns_that_multiply_states_are_fixed_or_named() {
    let noise = kalfit_model::build::when(text_is("lot", "B"), 0.5, 0.9);
    let model = Model::builder("fixed columns")
        .time("t")
        .state(constant("bias"))
        .state(constant("slope").offset(0.1 * name("T")))
        .state(random_walk("walk", name("q")).known(0.0, 0.2))
        .measurement(measurement("y", name("bias") + name("T") * name("slope") + name("walk"), noise))
        .measurement(measurement("z", name("bias") + 2.0, 0.3).only_where(text_is("lot", "B")))
        .parameter(fixed("q", 0.3).per("lot").fixed_at("B", 0.6))
        .build()
        .expect("a model");
    let alpha = Alpha::fixed(&model.shared().parameters).expect("all are known");
    let refused = |wanted: &Wanted| export(&model, &alpha, &population(2), wanted).expect_err("it varies");
    let error = refused(&stepped());
    let ExportError::Varies { varies } = &error else { panic!("{error}") };
    let named: Vec<(&str, &str)> = varies.iter().map(|one| (one.what.as_str(), one.column.as_str())).collect();
    let expected = [
        ("offset of state `slope`", "T"),
        ("process noise variance of state `walk`", "lot"),
        ("equation of measurement `y`", "T"),
        ("noise variance of measurement `y`", "lot"),
    ];
    assert_eq!(named, expected);
    assert_eq!(error.hint().as_deref(), Some("fix what they depend on: `--at T=VALUE`, `--at lot=VALUE`"));
    let wanted = at(at(stepped(), "T", "27"), "lot", "B");
    compare("fixed columns", &model, &wanted);
    assert!(matches!(refused(&at(wanted.clone(), "u", "1")), ExportError::NoEffect { .. }));
    assert!(matches!(refused(&at(wanted.clone(), "y", "1")), ExportError::NoEffect { .. }));
    assert!(matches!(refused(&at(stepped(), "T", "warm")), ExportError::NotANumber { .. }));
    assert!(matches!(refused(&at(wanted.clone(), "T", "28")), ExportError::GivenTwice { .. }));
    // in another lot, `z` is never measured
    let other = export(&model, &alpha, &population(2), &at(at(stepped(), "T", "27"), "lot", "A")).expect("constant");
    assert_eq!(other.measurements, [0]);
    near::mixed("the noise of other lots", other.R[(0, 0)], 0.81, 1e-10);
    let no_step = refused(&at(at(Wanted::default(), "T", "27"), "lot", "B"));
    assert!(matches!(&no_step, ExportError::NoStep { what } if what.contains("walk")), "{no_step}");
}

#[test]
fn a_level_without_a_value_is_refused_with_those_that_have_one() {
    let model = Model::builder("levels")
        .state(constant("bias"))
        .measurement(measurement("y", name("bias"), name("sigma")))
        .parameter(kalfit_model::build::free("sigma").per("lot").fixed_at("A", 0.5).fixed_at("B", 0.7))
        .build()
        .expect("a model");
    let alpha = Alpha::fixed(&model.shared().parameters).expect("two levels are known");
    let error = export(&model, &alpha, &population(1), &at(Wanted::default(), "lot", "C")).expect_err("no such level");
    assert_eq!(error.to_string(), "parameter `sigma` has no value where `lot` is `C`, expected one of `A`, `B`");
    let known = export(&model, &alpha, &population(1), &at(Wanted::default(), "lot", "B")).expect("constant");
    near::mixed("R", known.R[(0, 0)], 0.49, 1e-10);
}

#[test]
fn the_mean_of_a_regression_is_that_of_its_column() {
    let model = Model::builder("regression")
        .state(constant("bias"))
        .measurement(measurement("y", name("bias"), 0.5))
        .regress_mean("bias", "T")
        .build()
        .expect("a model");
    let own = Population { coefficients: vec![0.2], ..population(1) };
    let error = export(&model, &Alpha::default(), &own, &Wanted::default()).expect_err("it varies");
    assert!(error.to_string().contains("regression of the mean of state `bias` depends on column `T`"), "{error}");
    let known = export(&model, &Alpha::default(), &own, &at(Wanted::default(), "T", "10")).expect("constant");
    near::mixed("x0", known.start.expect("it starts").0[0], own.mean[0] + 2.0, 1e-10);
}

#[test]
fn a_phase_that_inherits_has_no_start_of_its_own() {
    let first = Model::builder("one").state(constant("bias")).measurement(measurement("y", name("bias"), 0.5));
    let second =
        Model::builder("one").state(constant("bias").known(0.0, 0.0)).measurement(measurement("y", name("bias"), 0.9));
    let onward = phase("after", &second).carry("bias", name("bias"));
    let model = PhasedModel::builder("phase").phase(phase("before", &first)).phase(onward).build().expect("a model");
    let of = |phase: Option<&str>| {
        let wanted = Wanted { phase: phase.map(str::to_owned), ..Wanted::default() };
        export(&model, &Alpha::default(), &population(1), &wanted)
    };
    assert!(of(Some("before")).expect("constant").start.is_some());
    let after = of(Some("after")).expect("constant");
    assert!(after.start.is_none());
    near::mixed("R", after.R[(0, 0)], 0.81, 1e-10);
    assert!(matches!(of(None), Err(ExportError::WhichPhase { .. })));
    assert!(matches!(of(Some("later")), Err(ExportError::UnknownPhase { .. })));
}

/// x0 and P0 are the start of the reducer plus the law of the estimated states.
#[test]
fn the_start_is_that_of_the_reducer() {
    let model = instrument().build().expect("a model");
    let alpha = Alpha::fixed(&model.shared().parameters).expect("all are known");
    let filter = export(&model, &alpha, &population(3), &stepped()).expect("constant");
    let preparer = Preparer::new(&model.shared().clone(), &alpha).expect("it is sound");
    let mut work = preparer.workspace();
    let test = test(&model);
    let Evidence::Rows(rows) = &test.phases[0] else { panic!("rows") };
    preparer.prepare(rows, &mut work).expect("it is sound");
    let (x0, p0) = filter.start.expect("it starts");
    let own = population(3);
    let (r, place) = (work.design.frame.r, &preparer.order.place);
    for i in 0..x0.len() {
        let estimated = |state: usize| model.shared().estimated.iter().position(|&own| own == state);
        let mean = work.data.start[place[i]] + estimated(i).map_or(0.0, |i| own.mean[i]);
        near::mixed("x0", x0[i], mean, 1e-10);
        for k in 0..=i {
            let (a, b) = (place[i].max(place[k]), place[i].min(place[k]));
            let known = if a < r { work.design.variance[a * r + b] } else { 0.0 };
            let added = estimated(i).zip(estimated(k)).map_or(0.0, |(i, k)| own.covariance[(i, k)]);
            near::mixed("P0", p0[(i, k)], known + added, 1e-10);
        }
    }
}
