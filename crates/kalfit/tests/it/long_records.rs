//! Long uniform records: equal steps kept once and gains frozen where they have converged change nothing but the cost.

use kalfit::innovations::{Change, InnovationFilter, innovations};
use kalfit::model::{
    Clock, Column, CovarianceStructure, Initial, Linear, MeanStructure, Measurement, Motion, Operator, State,
};
use kalfit::reduce::{Evidence, Path, PhasedTest, Plain, Reducer, ReductionRef, StepMatrices};
use kalfit::{Alpha, Expression, Model, PhasedModel, Population, Source, Test};
use kalfit_fixtures::near;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const ROWS: usize = 20_000;
const STEP: f64 = 0.01;

fn number(x: f64) -> Expression {
    Expression::Number(x)
}

fn linear(terms: &[(usize, f64)]) -> Linear {
    Linear { terms: terms.iter().map(|&(state, x)| (state, number(x))).collect(), constant: number(0.0) }
}

fn state(name: &str, motion: Motion, initial: Initial) -> State {
    State { name: name.to_owned(), unit: None, motion, initial, offset: None, random: true }
}

fn walk(noise: f64, variance: f64) -> State {
    let motion = Motion::Continuous { derivative: linear(&[]), noise_variance: number(noise) };
    state("walk", motion, Initial::Known { mean: number(0.5), variance: number(variance) })
}

fn drift(index: usize, tau: f64, sigma: f64) -> State {
    let noise_variance = number(2.0 * sigma * sigma / tau);
    let motion = Motion::Continuous { derivative: linear(&[(index, -1.0 / tau)]), noise_variance };
    state("drift", motion, Initial::Stationary)
}

fn bias() -> State {
    state("bias", Motion::Constant, Initial::Estimated)
}

/// A state that moves with another one: dx/dt = that one.
fn ramp(of: usize) -> State {
    let motion = Motion::Continuous { derivative: linear(&[(of, 1.0)]), noise_variance: number(0.0) };
    state("ramp", motion, Initial::Estimated)
}

fn meter(column: usize, terms: &[(usize, f64)], noise: f64) -> Measurement {
    Measurement {
        name: format!("z{column}"),
        column,
        filter: None,
        equation: linear(terms),
        noise_variance: number(noise),
    }
}

/// Columns: 0 time, 1 and 2 measured, 3 a known input.
fn model(states: Vec<State>, measurements: Vec<Measurement>) -> Model {
    let named = |name: &&str| Column { name: (*name).to_owned(), used_in: String::new() };
    let estimated: Vec<usize> = (0..states.len()).filter(|&i| states[i].initial == Initial::Estimated).collect();
    Model {
        title: String::new(),
        columns: ["t", "z", "y", "u"].iter().map(named).collect(),
        text_columns: Vec::new(),
        literals: Vec::new(),
        parameters: Vec::new(),
        process_noise_covariance: Vec::new(),
        measurements,
        noise_covariance: Vec::new(),
        clock: Clock { time: Some(0), ..Clock::default() },
        group: None,
        mean: MeanStructure::free(estimated.len()),
        covariance: CovarianceStructure::full(),
        estimated,
        states,
    }
}

/// Rows at decimal times; `missing` says where z is.
fn record(rows: usize, missing: impl Fn(usize) -> bool) -> Test {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut test = Test::new("long", 4, 0);
    for k in 0..rows {
        let time: f64 = format!("{:.2}", k as f64 * STEP).parse().expect("a number");
        let mut normal = || -> f64 { rng.sample(StandardNormal) };
        let (z, y, u) = (3.0 + normal(), 3.0 + normal(), normal());
        test.push(&[time, if missing(k) { f64::NAN } else { z }, y, u], &[], Source { file: 0, row: k as u64 });
    }
    test
}

fn models() -> Vec<(&'static str, Model)> {
    let one = |states: usize| (0..states).map(|i| (i, 1.0)).collect::<Vec<_>>();
    let single = |states: Vec<State>| {
        let terms = one(states.len());
        model(states, vec![meter(1, &terms, 1.0)])
    };
    let mut driven = single(vec![bias(), walk(1e-2, 0.0)]);
    let Motion::Continuous { derivative, .. } = &mut driven.states[1].motion else { panic!("a walk is continuous") };
    derivative.constant = Expression::Column(3);
    let mut known = single(vec![bias(), drift(1, 1.0, 1.0)]);
    let term = Expression::Binary(Operator::Multiply, Box::new(number(0.1)), Box::new(Expression::Column(3)));
    known.measurements[0].equation.constant = term;
    let pair = vec![meter(1, &[(0, 1.0), (1, 1.0)], 1.0), meter(2, &[(0, 1.0), (1, -0.5)], 0.5)];
    let still = model(vec![bias()], vec![meter(1, &[(0, 2.0)], 1.0)]);
    let slope = vec![meter(1, &[(0, 1.0), (2, 1.0)], 1.0)];
    vec![
        ("walk", single(vec![bias(), walk(1e-2, 0.0)])),
        ("walk and drift", single(vec![bias(), walk(1e-2, 0.1), drift(2, 0.5, 1.0)])),
        ("slow drift", single(vec![bias(), drift(1, 100.0, 1.0)])),
        ("no process noise", single(vec![bias(), walk(0.0, 2.0)])),
        ("nothing moves", still),
        ("ramp that never settles", model(vec![ramp(1), bias(), walk(1e-2, 0.0)], slope)),
        ("two measurements", model(vec![bias(), walk(1e-2, 0.0)], pair)),
        ("driven walk", driven),
        ("known inputs", known),
    ]
}

fn close(what: &str, found: ReductionRef<'_>, expected: ReductionRef<'_>, tolerance: f64) {
    near::relative(format_args!("{what}: constant"), found.constant, expected.constant, tolerance);
    for (name, found, expected) in [("data", found.data, expected.data), ("factor", found.factor, expected.factor)] {
        let bound = tolerance * near::largest(expected);
        for (a, b) in found.iter().zip(expected) {
            near::absolute(format_args!("{what}: {name}"), *a, *b, bound);
        }
    }
    let count = |r: ReductionRef<'_>| (r.steps, r.observations, r.path);
    assert_eq!(count(found), count(expected), "{what}");
}

#[test]
fn frozen_gains_leave_the_reduction_as_it_is() {
    let gaps = |k: usize| k % 7_001 == 6_000 || (9_000..9_100).contains(&k);
    for (name, model) in models() {
        for (gap, test) in [("whole", record(ROWS, |_| false)), ("gaps", record(ROWS, gaps))] {
            let tests = [test];
            let reducer = || Reducer::new(&model, &Alpha::default()).expect("the model is sound");
            let found = reducer().reduce(&tests).expect("the test is sound");
            let expected = reducer().unfrozen().reduce(&tests).expect("the test is sound");
            close(&format!("{name}, {gap}"), found.get(0), expected.get(0), 1e-10);
            assert_eq!(expected.get(0).path, Path::Information, "{name}");
        }
    }
}

#[test]
fn a_long_record_is_what_its_matrices_say() {
    let rows = 3_000;
    let (tau, sigma, noise) = (0.5_f64, 1.0_f64, 1e-2);
    let model = model(
        vec![bias(), walk(noise, 0.1), drift(2, tau, sigma)],
        vec![meter(1, &[(0, 1.0), (1, 1.0), (2, 1.0)], 1.0)],
    );
    let test = record(rows, |k| k == 2_000);
    let mut plain = Plain::new(
        "long",
        DVector::from_column_slice(&[0.0, 0.5, 0.0]),
        DMatrix::from_column_slice(3, 1, &[1.0, 0.0, 0.0]),
        DMatrix::from_diagonal(&DVector::from_column_slice(&[0.0, 0.1, sigma * sigma])),
    );
    let dt = STEP;
    let phi = DMatrix::from_diagonal(&DVector::from_column_slice(&[1.0, 1.0, (-dt / tau).exp()]));
    let q = -sigma * sigma * (-2.0 * dt / tau).exp_m1();
    let process = DMatrix::from_diagonal(&DVector::from_column_slice(&[0.0, noise * dt, q]));
    for k in 0..rows {
        let value = DVector::from_element(1, test.numbers(k)[1]);
        let step = StepMatrices::new(DMatrix::from_element(1, 3, 1.0), DMatrix::from_element(1, 1, 1.0), value);
        plain.steps.push(if k == 0 { step } else { step.moving(phi.clone(), process.clone()) });
    }
    let found = Reducer::new(&model, &Alpha::default()).expect("sound").reduce(&[test]).expect("sound");
    close("matrices", found.get(0), plain.reduce().expect("sound").view(), 1e-10);
}

#[test]
fn innovations_of_a_long_record_have_the_likelihood_of_its_reduction() {
    for (name, model) in models() {
        let tests = [record(ROWS, |k| k % 5_000 == 4_999)];
        let p = model.estimated.len();
        let population = Population {
            mean: vec![3.0; p],
            coefficients: Vec::new(),
            covariance: DMatrix::from_diagonal_element(p, p, 0.0),
        };
        let series = innovations(&model.clone().into(), &Alpha::default(), &population, &[tests[0].clone().into()]);
        let series = series.expect("the test is sound").remove(0).expect("rows");
        let reductions = Reducer::new(&model, &Alpha::default()).expect("sound").reduce(&tests).expect("sound");
        let reduction = reductions.get(0);
        let mut residual = reduction.data.to_vec();
        for k in 0..p {
            (0..=k).for_each(|i| residual[i] -= reduction.factor[k * (k + 1) / 2 + i] * 3.0);
        }
        let expected = reduction.constant - 0.5 * residual.iter().map(|x| x * x).sum::<f64>();
        let (found, steps) = (series.log_likelihood, series.series.last().map(|one| (one.step, one.time)));
        assert!((found / expected - 1.0).abs() < 1e-10, "{name}: {found} against {expected}");
        let last = ROWS - if model.measurements.len() == 2 { 1 } else { 2 };
        assert_eq!(steps, Some((last, Some(last as f64 / 100.0))), "{name}");
    }
}

/// A filter of a model that knows the estimated states to a standard deviation of 1/2.
fn filter_of(model: Model) -> InnovationFilter {
    let p = model.estimated.len();
    let covariance = DMatrix::from_diagonal_element(p, p, 0.25);
    let population = Population { mean: vec![3.0; p], coefficients: Vec::new(), covariance };
    let model: PhasedModel = model.into();
    let filter = InnovationFilter::new(&model, &Alpha::default(), &population).expect("sound");
    let other = Population { mean: vec![-7.0; p], ..population.clone() };
    let elsewhere = filter.at(&model, &other).expect("sound");
    elsewhere.at(&model, &population).expect("sound")
}

/// Records that differ in measured values alone.
fn alike(records: usize, rows: usize) -> Vec<PhasedTest> {
    let one = |number: usize| {
        let mut test = record(rows, |k| k == 400);
        for row in 0..rows {
            let wave = (row as f64 / 90.0 + number as f64).sin();
            [1, 2].iter().for_each(|&column| test.set_number(row, column, test.numbers(row)[column] + wave));
        }
        test.id = format!("r{number}").into();
        test.into()
    };
    (0..records).map(one).collect()
}

#[test]
fn records_side_by_side_have_the_innovations_of_each_alone() {
    let mut tests = alike(60, 1200);
    if let Some(Evidence::Rows(rows)) = tests[17].phases.get_mut(0) {
        rows.set_number(900, 1, f64::INFINITY);
    }
    for (name, model) in models() {
        let filter = filter_of(model.clone());
        let together = filter.run(&tests);
        for (number, (test, found)) in tests.iter().zip(&together).enumerate() {
            let alone = filter_of(model.clone()).run(std::slice::from_ref(test)).remove(0);
            assert_eq!(*found, alone, "{name}, record {number}");
        }
        let bare = filter.standardised(&tests);
        let all = |found: &kalfit::innovations::Innovations| -> Vec<f64> {
            found.series.iter().map(|one| one.standardised).collect()
        };
        for (found, bare) in together.iter().zip(&bare) {
            let found = found.as_ref().map(|found| found.as_ref().map(all));
            assert_eq!(found.as_ref().ok(), bare.as_ref().ok(), "{name}");
        }
    }
}

#[test]
fn a_changed_record_has_the_innovations_of_its_changed_copy() {
    for (name, model) in models() {
        for rows in [30, 3000] {
            let test = record(rows, |k| k == 20);
            let mut copies = vec![test.clone(), test.clone()];
            copies[0].set_number(11, 1, test.numbers(11)[1] + 0.5);
            (0..rows).for_each(|row| copies[1].set_number(row, 1, 2.0 * test.numbers(row)[1]));
            let copies: Vec<PhasedTest> = copies.into_iter().map(PhasedTest::from).collect();
            let changes = [
                Change {
                    phase: 0,
                    measurement: 0,
                    value: Box::new(|row, value| if row == 11 { value + 0.5 } else { value }),
                },
                Change { phase: 0, measurement: 0, value: Box::new(|_, value| 2.0 * value) },
            ];
            let filter = filter_of(model.clone());
            let expected: Vec<Option<Vec<f64>>> =
                filter.standardised(&copies).into_iter().map(|found| found.expect("sound")).collect();
            assert_eq!(filter.changed(&test.into(), &changes), expected, "{name}, {rows} rows");
        }
    }
}
