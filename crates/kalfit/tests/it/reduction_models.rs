//! Reductions of models: the motion, start and measurements a model says against matrices written down by hand.

use crate::dense;

use std::collections::BTreeMap;

use dense::dense;
use kalfit::model::{
    Clock, Column, CovarianceStructure, Function, Initial, Level, Linear, MeanStructure, Measurement, Motion, Operator,
    Parameter, Regression, State, Value,
};
use kalfit::reduce::{Plain, ReduceError, ReduceErrorKind, Reducer, Reduction, Reductions, StepMatrices, Work};
use kalfit::{Alpha, Expression, Label, Model, Source, Test};
use nalgebra::{DMatrix, DVector};

fn number(x: f64) -> Expression {
    Expression::Number(x)
}

fn column(c: usize) -> Expression {
    Expression::Column(c)
}

fn binary(operator: Operator, a: Expression, b: Expression) -> Expression {
    Expression::Binary(operator, Box::new(a), Box::new(b))
}

fn linear(terms: &[(usize, f64)]) -> Linear {
    Linear { terms: terms.iter().map(|&(state, x)| (state, number(x))).collect(), constant: number(0.0) }
}

fn state(name: &str, motion: Motion, initial: Initial) -> State {
    State { name: name.to_owned(), unit: None, motion, initial, offset: None, random: true }
}

fn constant(name: &str) -> State {
    state(name, Motion::Constant, Initial::Estimated)
}

fn known(mean: f64, variance: f64) -> Initial {
    Initial::Known { mean: number(mean), variance: number(variance) }
}

fn continuous(terms: &[(usize, f64)], noise: f64) -> Motion {
    Motion::Continuous { derivative: linear(terms), noise_variance: number(noise) }
}

fn discrete(terms: &[(usize, f64)], noise: f64) -> Motion {
    Motion::Discrete { next: linear(terms), noise_variance: number(noise) }
}

/// A first-order Gauss-Markov state with this index.
fn gauss_markov(index: usize, tau: f64, sigma: f64) -> State {
    state("drift", continuous(&[(index, -1.0 / tau)], 2.0 * sigma * sigma / tau), Initial::Stationary)
}

fn meter(name: &str, column: usize, terms: &[(usize, f64)], noise: f64) -> Measurement {
    Measurement { name: name.to_owned(), column, filter: None, equation: linear(terms), noise_variance: number(noise) }
}

/// Columns: 0 time, 1 z, 2 u, 3 w; text column 0 sensor, with literals A and B.
fn model(states: Vec<State>, measurements: Vec<Measurement>) -> Model {
    let named = |name: &&str| Column { name: (*name).to_owned(), used_in: String::new() };
    let estimated: Vec<usize> = (0..states.len()).filter(|&i| states[i].initial == Initial::Estimated).collect();
    Model {
        title: String::new(),
        columns: ["t", "z", "u", "w"].iter().map(named).collect(),
        text_columns: ["sensor"].iter().map(named).collect(),
        literals: vec!["A".to_owned(), "B".to_owned()],
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

const EMPTY: f64 = f64::NAN;

fn labelled(id: &str, rows: &[([f64; 4], usize)]) -> Test {
    let mut test = Test::new(id, 4, 1);
    for (k, (numbers, label)) in rows.iter().enumerate() {
        test.push(numbers, &[Label::literal(*label)], Source { file: 0, row: k as u64 + 2 });
    }
    test
}

fn test(rows: &[[f64; 4]]) -> Test {
    labelled("t1", &rows.iter().map(|row| (*row, 0)).collect::<Vec<_>>())
}

fn reduce_all(model: &Model, tests: &[Test]) -> Result<Reductions, ReduceError> {
    Reducer::new(model, &Alpha::fixed(&model.parameters).expect("all is fixed"))?.reduce(tests)
}

fn reduce(model: &Model, test: &Test) -> Reduction {
    reduce_all(model, std::slice::from_ref(test)).expect("sound").get(0).into()
}

fn refusal(model: &Model, test: &Test) -> ReduceError {
    reduce_all(model, std::slice::from_ref(test)).expect_err("refused")
}

fn log_likelihood(reduction: &Reduction, xi: &[f64]) -> f64 {
    let p = xi.len();
    let left =
        |i: usize| reduction.data[i] - (i..p).map(|k| reduction.factor[i + k * (k + 1) / 2] * xi[k]).sum::<f64>();
    reduction.constant - 0.5 * (0..p).map(|i| left(i).powi(2)).sum::<f64>()
}

fn m(rows: usize, columns: usize, entries: &[f64]) -> DMatrix<f64> {
    DMatrix::from_row_slice(rows, columns, entries)
}

fn v(entries: &[f64]) -> DVector<f64> {
    DVector::from_row_slice(entries)
}

/// z = `h` x + v, one scalar.
fn scalar(h: &[f64], noise: f64, z: f64) -> StepMatrices {
    StepMatrices::new(m(1, h.len(), h), m(1, 1, &[noise]), v(&[z]))
}

/// Compares a reduction with the oracle's for several ξ.
#[track_caller]
fn assert_equal(found: &Reduction, expected: &Plain) {
    let law = dense(expected);
    let p = expected.sensitivity.ncols();
    for k in 0..3 {
        let xi: Vec<f64> = (0..p).map(|i| 0.3 + f64::from(k) - 0.4 * (i * k as usize) as f64).collect();
        let (a, b) = (log_likelihood(found, &xi), law.log_likelihood(&DVector::from_vec(xi.clone())));
        assert!((a - b).abs() <= 1e-11 * (1.0 + b.abs()), "ξ = {xi:?}: {a:.14} against {b:.14}");
    }
}

/// Independent exponential: Taylor over 2^-20 of the step, squared.
fn exponential(f: &DMatrix<f64>) -> DMatrix<f64> {
    let small = f / 1_048_576.0;
    let mut sum = DMatrix::identity(f.nrows(), f.nrows());
    let mut power = sum.clone();
    for k in 1..8 {
        power = &power * &small / f64::from(k);
        sum += &power;
    }
    (0..20).fold(sum, |x, _| &x * &x)
}

const ROWS: [[f64; 4]; 4] =
    [[0.0, 1.2, 0.5, 2.0], [0.7, 0.4, -1.0, 2.0], [1.0, EMPTY, 0.2, 2.0], [4.0, -0.9, 1.5, 2.0]];

#[test]
fn random_coefficients_are_a_regression() {
    let mut model = model(vec![constant("a"), constant("b")], vec![meter("z", 1, &[(0, 1.0)], 0.25)]);
    model.clock.time = None;
    model.measurements[0].equation.terms.push((1, column(2)));
    model.measurements[0].equation.constant = Expression::Call(Function::Sin, vec![column(3)]);
    let mut plain = Plain::new("", DVector::zeros(2), DMatrix::identity(2, 2), DMatrix::zeros(2, 2));
    for row in ROWS {
        plain.steps.push(scalar(&[1.0, row[2]], 0.25, row[1]).with_constant(v(&[2f64.sin()])));
    }
    let found = reduce(&model, &test(&ROWS));
    assert_equal(&found, &plain);
    assert_eq!((found.steps, found.observations), (4, 3));
}

#[test]
fn gauss_markov_has_its_closed_form_and_starts_stationary() {
    let (tau, sigma) = (2.0, 0.8);
    let found = reduce(
        &model(vec![constant("bias"), gauss_markov(1, tau, sigma)], vec![meter("z", 1, &[(0, 1.0), (1, 1.0)], 0.01)]),
        &test(&ROWS),
    );
    let start = m(2, 2, &[0.0, 0.0, 0.0, sigma * sigma]);
    let mut plain = Plain::new("", DVector::zeros(2), m(2, 1, &[1.0, 0.0]), start);
    for (k, row) in ROWS.iter().enumerate() {
        let mut step = scalar(&[1.0, 1.0], 0.01, row[1]);
        if k > 0 {
            let phi = (-(row[0] - ROWS[k - 1][0]) / tau).exp();
            let q = sigma * sigma * (1.0 - phi * phi);
            step = step.moving(m(2, 2, &[1.0, 0.0, 0.0, phi]), m(2, 2, &[0.0, 0.0, 0.0, q]));
        }
        plain.steps.push(step);
    }
    assert_equal(&found, &plain);
}

#[test]
fn second_order_gauss_markov_has_its_autocovariance() {
    // σ²(1 + δ/τ) e^{-δ/τ} between any two times.
    let (tau, sigma) = (1.3, 0.7);
    let rate = continuous(&[(0, -1.0 / (tau * tau)), (1, -2.0 / tau)], 4.0 * sigma * sigma / (tau * tau * tau));
    let states = vec![
        state("drift", continuous(&[(1, 1.0)], 0.0), Initial::Stationary),
        state("rate", rate, Initial::Stationary),
    ];
    let found = reduce(&model(states, vec![meter("z", 1, &[(0, 1.0)], 0.01)]), &test(&ROWS));
    let seen: Vec<[f64; 4]> = ROWS.iter().filter(|row| !row[1].is_nan()).copied().collect();
    let covariance = DMatrix::from_fn(3, 3, |i, j| {
        let lag = (seen[i][0] - seen[j][0]).abs() / tau;
        sigma * sigma * (1.0 + lag) * (-lag).exp() + if i == j { 0.01 } else { 0.0 }
    });
    let expected = dense::log_density(&DVector::from_fn(3, |i, _| seen[i][1]), &covariance);
    assert!((found.constant - expected).abs() < 1e-12, "{} against {expected}", found.constant);
}

#[test]
fn own_motion_moves_as_the_exponential_of_its_equations() {
    // angle' = bias + 0.5 drift + u, drift' = -drift/3 - 0.1 angle + noise, correlated with the angle's; bias constant.
    let mut angle = state("angle", continuous(&[(0, 1.0), (2, 0.5)], 0.04), known(0.2, 0.0));
    let Motion::Continuous { derivative, .. } = &mut angle.motion else { unreachable!() };
    derivative.constant = column(2);
    let drift = state("drift", continuous(&[(1, -0.1), (2, -1.0 / 3.0)], 0.09), known(0.0, 1.0));
    let mut model = model(vec![constant("bias"), angle, drift], vec![meter("z", 1, &[(1, 1.0)], 0.01)]);
    model.process_noise_covariance.push((1, 2, number(0.03)));
    let q = m(3, 3, &[0.0, 0.0, 0.0, 0.0, 0.04, 0.03, 0.0, 0.03, 0.09]);
    let f = m(3, 3, &[0.0, 0.0, 0.0, 1.0, 0.0, 0.5, 0.0, -0.1, -1.0 / 3.0]);
    for previous in [false, true] {
        model.clock.previous_inputs = previous;
        let start = m(3, 3, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        let mut plain = Plain::new("", v(&[0.0, 0.2, 0.0]), m(3, 1, &[1.0, 0.0, 0.0]), start);
        for (k, row) in ROWS.iter().enumerate() {
            let mut step = scalar(&[0.0, 1.0, 0.0], 0.01, row[1]);
            if k > 0 {
                // Van Loan: exp([[-F, Q], [0, F']]δ), and the input as a constant state.
                let dt = row[0] - ROWS[k - 1][0];
                let mut block = DMatrix::zeros(6, 6);
                block.view_mut((0, 0), (3, 3)).copy_from(&(-&f * dt));
                block.view_mut((0, 3), (3, 3)).copy_from(&(&q * dt));
                block.view_mut((3, 3), (3, 3)).copy_from(&(f.transpose() * dt));
                let block = exponential(&block);
                let phi = block.view((3, 3), (3, 3)).transpose();
                let noise = &phi * block.view((0, 3), (3, 3));
                let mut driven = DMatrix::zeros(4, 4);
                driven.view_mut((0, 0), (3, 3)).copy_from(&(&f * dt));
                driven[(1, 3)] = dt * if previous { ROWS[k - 1][2] } else { row[2] };
                let input = exponential(&driven).view((0, 3), (3, 1)).column(0).into_owned();
                let noise = (&noise + noise.transpose()) / 2.0;
                step = step.moving(phi, noise).with_input(input);
            }
            plain.steps.push(step);
        }
        let found = reduce(&model, &test(&ROWS));
        let law = dense(&plain);
        for xi in [-1.0, 2.0] {
            let (a, b) = (log_likelihood(&found, &[xi]), law.log_likelihood(&v(&[xi])));
            // The test's own exponential has 1e-16 × 2^20 to offer.
            assert!((a - b).abs() < 1e-8 * (1.0 + b.abs()), "previous {previous}: {a} against {b}");
        }
    }
}

#[test]
fn random_walk_and_integral_have_their_covariances() {
    // walk' = white(0.3), area' = walk: Q = 0.3 [δ, δ²/2; δ²/2, δ³/3].
    let states = vec![
        state("walk", continuous(&[], 0.3), Initial::Estimated),
        state("area", continuous(&[(0, 1.0)], 0.0), Initial::Estimated),
    ];
    let found = reduce(&model(states, vec![meter("z", 1, &[(1, 1.0)], 0.01)]), &test(&ROWS));
    let mut plain = Plain::new("", DVector::zeros(2), DMatrix::identity(2, 2), DMatrix::zeros(2, 2));
    for (k, row) in ROWS.iter().enumerate() {
        let mut step = scalar(&[0.0, 1.0], 0.01, row[1]);
        if k > 0 {
            let d = row[0] - ROWS[k - 1][0];
            let q = [d, d * d / 2.0, d * d / 2.0, d * d * d / 3.0].map(|x| 0.3 * x);
            step = step.moving(m(2, 2, &[1.0, 0.0, d, 1.0]), m(2, 2, &q));
        }
        plain.steps.push(step);
    }
    assert_equal(&found, &plain);
}

/// x1 ← 0.9 x1 + 0.5 u + w1, x2 ← 0.4 x2 + x1 + w2, cov(w1, w2) = 0.02, measured together.
fn two_discrete() -> Model {
    let mut first = state("x1", discrete(&[(0, 0.9)], 0.09), Initial::Estimated);
    let Motion::Discrete { next, .. } = &mut first.motion else { unreachable!() };
    next.constant = binary(Operator::Multiply, number(0.5), column(2));
    let second = state("x2", discrete(&[(0, 1.0), (1, 0.4)], 0.04), known(1.0, 0.3));
    let mut model = model(vec![first, second], vec![meter("z", 1, &[(0, 1.0), (1, 0.5)], 0.01)]);
    model.clock.time = None;
    model.process_noise_covariance.push((0, 1, number(0.02)));
    model
}

#[test]
fn discrete_motion_uses_the_step_before_and_step_first_moves_before_the_first_row() {
    for step_first in [false, true] {
        let mut model = two_discrete();
        model.clock.step_first = step_first;
        let start = m(2, 2, &[0.0, 0.0, 0.0, 0.3]);
        let mut plain = Plain::new("", v(&[0.0, 1.0]), m(2, 1, &[1.0, 0.0]), start);
        for (k, row) in ROWS.iter().enumerate() {
            let mut step = scalar(&[1.0, 0.5], 0.01, row[1]);
            if k > 0 || step_first {
                step = step
                    .moving(m(2, 2, &[0.9, 0.0, 1.0, 0.4]), m(2, 2, &[0.09, 0.02, 0.02, 0.04]))
                    .with_input(v(&[0.5 * row[2], 0.0]));
            }
            plain.steps.push(step);
        }
        assert_equal(&reduce(&model, &test(&ROWS)), &plain);
    }
}

#[test]
fn discrete_states_are_held_while_continuous_ones_move() {
    let states = vec![
        state("level", discrete(&[(0, 0.5)], 0.2), Initial::Estimated),
        state("area", continuous(&[(0, 2.0), (1, -1.0)], 0.0), Initial::Estimated),
    ];
    let found = reduce(&model(states, vec![meter("z", 1, &[(1, 1.0)], 0.01)]), &test(&ROWS));
    let mut plain = Plain::new("", DVector::zeros(2), DMatrix::identity(2, 2), DMatrix::zeros(2, 2));
    for (k, row) in ROWS.iter().enumerate() {
        let mut step = scalar(&[0.0, 1.0], 0.01, row[1]);
        if k > 0 {
            let decay = (-(row[0] - ROWS[k - 1][0])).exp();
            step = step.moving(m(2, 2, &[0.5, 0.0, 2.0 * (1.0 - decay), decay]), m(2, 2, &[0.2, 0.0, 0.0, 0.0]));
        }
        plain.steps.push(step);
    }
    assert_equal(&found, &plain);
}

#[test]
fn initial_time_puts_a_step_before_the_first_row_unless_it_is_that_row() {
    let walk = || vec![state("walk", continuous(&[], 0.3), Initial::Estimated)];
    let mut model = model(walk(), vec![meter("z", 1, &[(0, 1.0)], 0.01)]);
    for (initial, dt) in [(None, 0.0), (Some(-1.5), 1.5), (Some(0.0), 0.0)] {
        model.clock.initial_time = initial.map(number);
        let first = scalar(&[1.0], 0.01, 1.2).moving(m(1, 1, &[1.0]), m(1, 1, &[0.3 * dt]));
        let mut plain = Plain::new("", DVector::zeros(1), DMatrix::identity(1, 1), DMatrix::zeros(1, 1));
        plain.steps.push(first);
        assert_equal(&reduce(&model, &test(&ROWS[..1])), &plain);
    }
    model.clock.initial_time = Some(column(3));
    let error = refusal(&model, &test(&ROWS));
    assert_eq!(*error.kind, ReduceErrorKind::InitialTimeAfterStart { initial: 2.0, first: 0.0 });
    assert_eq!(
        error.to_string(),
        "test `t1`, row 2: initial time: the initial time 2 is later than the first row's time 0"
    );
    model.clock.initial_time = None;
    model.clock.step_first = true;
    let error = refusal(&model, &test(&ROWS));
    assert_eq!(
        (&*error.kind, error.hint()),
        (&ReduceErrorKind::UnknownFirstStep, Some("give `initial_time` in [data]"))
    );
}

#[test]
fn times_that_lose_their_steps_are_refused_and_the_same_from_their_start_are_not() {
    let model =
        model(vec![state("walk", continuous(&[], 0.3), Initial::Estimated)], vec![meter("z", 1, &[(0, 1.0)], 0.01)]);
    // steps of 100 ns: numbers as large as nanoseconds since 1970 are 256 apart
    let rows = |start: f64| (0..6).map(|k| [start + 100.0 * f64::from(k), 0.1, 0.0, 0.0]).collect::<Vec<_>>();
    let error = refusal(&model, &test(&rows(1.7e18)));
    assert!(matches!(*error.kind, ReduceErrorKind::TimesTooLarge { time, .. } if time > 1.7e18), "{error}");
    assert!(error.hint().is_some_and(|hint| hint.starts_with("count times from the start")), "{error}");
    assert_eq!(reduce(&model, &test(&rows(0.0))).steps, 6);
}

#[test]
fn rows_of_equal_time_are_one_step_and_where_chooses_rows() {
    let mut model = model(
        vec![state("walk", continuous(&[], 0.3), Initial::Estimated), constant("b")],
        vec![meter("a", 1, &[(0, 1.0)], 0.04), meter("b", 1, &[(0, 1.0), (1, 1.0)], 0.09)],
    );
    for (k, measurement) in model.measurements.iter_mut().enumerate() {
        measurement.filter = Some(Expression::TextEquals { column: 0, literal: k });
    }
    model.noise_covariance.push((0, 1, column(3)));
    let rows = [([0.0, 1.0, 0.0, 0.01], 0), ([0.0, 2.0, 0.0, EMPTY], 1), ([2.0, 1.5, 0.0, EMPTY], 1)];
    let mut plain = Plain::new("", DVector::zeros(2), DMatrix::identity(2, 2), DMatrix::zeros(2, 2));
    let h = m(2, 2, &[1.0, 0.0, 1.0, 1.0]);
    plain.steps.push(StepMatrices::new(h, m(2, 2, &[0.04, 0.01, 0.01, 0.09]), v(&[1.0, 2.0])));
    let q = m(2, 2, &[0.6, 0.0, 0.0, 0.0]);
    plain.steps.push(scalar(&[1.0, 1.0], 0.09, 1.5).moving(DMatrix::identity(2, 2), q));
    let found = reduce(&model, &labelled("t", &rows));
    assert_equal(&found, &plain);
    assert_eq!(found.steps, 2);
    // The covariance may stand in the row of the other measurement.
    let mut turned = rows;
    (turned[0].0[3], turned[1].0[3]) = (EMPTY, 0.01);
    assert_equal(&reduce(&model, &labelled("t", &turned)), &plain);
    let several = [rows[0], rows[1], rows[1], rows[0]];
    assert_eq!(
        *refusal(&model, &labelled("t", &several)).kind,
        ReduceErrorKind::AmbiguousCovariance { first: "a".to_owned(), second: "b".to_owned() }
    );
}

#[test]
fn expressions_follow_the_row_and_the_time_step() {
    // z = dt a + v, var v = u²: dt is the time since the step before.
    let mut model = model(vec![constant("a")], vec![meter("z", 1, &[], 1.0)]);
    model.measurements[0].equation.terms = vec![(0, Expression::Step)];
    model.measurements[0].noise_variance = binary(Operator::Power, column(2), number(2.0));
    let mut plain = Plain::new("", DVector::zeros(1), DMatrix::identity(1, 1), DMatrix::zeros(1, 1));
    for (k, row) in ROWS.iter().enumerate() {
        let dt = if k == 0 { 0.0 } else { row[0] - ROWS[k - 1][0] };
        plain.steps.push(scalar(&[dt], row[2] * row[2], row[1]));
    }
    assert_equal(&reduce(&model, &test(&ROWS)), &plain);
}

#[test]
fn offsets_known_covariance_and_covariates_come_from_the_test() {
    let mut model = model(vec![constant("a"), constant("b")], vec![meter("z", 1, &[(0, 1.0), (1, 2.0)], 0.25)]);
    model.states[1].offset = Some(column(3));
    model.mean.regression.push(Regression { element: 0, column: 3 });
    let half = |a, b| vec![vec![number(a), number(b)], vec![number(b), number(a)]];
    model.covariance.known = Some(half(0.5, 0.2));
    let start = m(2, 2, &[0.5, 0.2, 0.2, 0.5]);
    let mut plain = Plain::new("", v(&[0.0, 2.0]), DMatrix::identity(2, 2), start);
    plain.steps.extend(ROWS.iter().map(|row| scalar(&[1.0, 2.0], 0.25, row[1])));
    // The cell need not stand in every row.
    let mut rows = ROWS;
    (rows[0][3], rows[2][3]) = (EMPTY, EMPTY);
    let found = reduce(&model, &test(&rows));
    assert_equal(&found, &plain);
    assert_eq!(found.covariates, [2.0]);
    model.covariance.known = Some(half(0.5, 0.6));
    let error = refusal(&model, &test(&rows));
    assert!(matches!(*error.kind, ReduceErrorKind::NotSemidefinite { .. }) && error.test.is_none(), "{error}");
}

#[test]
fn stationary_states_settle_around_the_fixed_point_of_constant_inputs() {
    let with_input = |motion: &mut Motion, input| match motion {
        Motion::Continuous { derivative, .. } => derivative.constant = input,
        Motion::Discrete { next, .. } => next.constant = input,
        Motion::Constant => unreachable!(),
    };
    let mut one = state("c", continuous(&[(0, -0.5)], 0.2), Initial::Stationary);
    with_input(&mut one.motion, number(1.5));
    let mut two = state("d", discrete(&[(1, 0.6)], 0.32), Initial::Stationary);
    with_input(&mut two.motion, number(0.8));
    let mut model = model(vec![one, two], vec![meter("z", 1, &[(0, 1.0), (1, 1.0)], 0.1)]);
    let found = reduce(&model, &test(&ROWS[..1]));
    // Means 1.5/0.5 and 0.8/0.4, variances 0.2/(2 × 0.5) and 0.32/(1 - 0.36).
    let expected = dense::log_density(&v(&[1.2 - 5.0]), &m(1, 1, &[0.2 + 0.5 + 0.1]));
    assert!((found.constant - expected).abs() < 1e-14, "{} against {expected}", found.constant);
    with_input(&mut model.states[0].motion, column(2));
    assert_eq!(*refusal(&model, &test(&ROWS)).kind, ReduceErrorKind::StationaryInput { state: "c".to_owned() });
}

fn many() -> Vec<Test> {
    (0..200)
        .map(|j| {
            let noise = |k: usize| ((j * 7919 + k * 104_729) % 1000) as f64 / 250.0 - 2.0;
            let stretch = if j % 4 == 0 { 1.5 } else { 1.0 };
            let rows: Vec<_> =
                ROWS.iter().enumerate().map(|(k, r)| ([r[0] * stretch, noise(k), r[2], 2.0], 0)).collect();
            labelled(&format!("t{j}"), &rows)
        })
        .collect()
}

/// `transitions`: how many there are to compute for all tests of [`many`].
fn sharing_changes_no_bit(model: &Model, transitions: u64) {
    let (tests, alpha) = (many(), Alpha::default());
    let reducer = Reducer::new(model, &alpha).expect("sound");
    let together = reducer.reduce(&tests).expect("sound");
    assert_eq!(reducer.work(), Work { design_runs: 2, root_runs: 0, data_runs: 200, transitions });
    for (test, shared) in tests.iter().zip(&together) {
        assert_eq!(reduce(model, test).view(), shared);
    }
    let mut turned: Vec<Test> = tests.iter().rev().cloned().collect();
    let mut backwards = Reductions::new();
    let one = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads");
    for (k, batch) in turned.chunks_mut(33).enumerate() {
        backwards.append(one(1 + k % 4).install(|| reducer.reduce(batch)).expect("sound"));
    }
    assert!(backwards.iter().rev().eq(&together));
    assert_eq!(together.get(1).design, together.get(2).design);
    assert_ne!(together.get(0).design, together.get(1).design);
}

#[test]
fn sharing_designs_threads_batches_and_order_change_no_bit() {
    let states = || vec![constant("bias"), gauss_markov(1, 2.0, 0.8)];
    let quick = model(states(), vec![meter("z", 1, &[(0, 1.0), (1, 1.0)], 0.01)]);
    sharing_changes_no_bit(&quick, 0);
    // an angle that the drift adds up to calls for a matrix exponential
    let angle = state("angle", continuous(&[(1, 1.0)], 0.0), known(0.0, 1.0));
    let angle = model([states(), vec![angle]].concat(), vec![meter("z", 1, &[(0, 1.0), (2, 1.0)], 0.01)]);
    sharing_changes_no_bit(&angle, 6);
}

#[test]
fn parameters_have_their_level() {
    let mut model = model(vec![constant("a")], vec![meter("z", 1, &[(0, 1.0)], 1.0)]);
    model.measurements[0].noise_variance = Expression::Parameter(0);
    model.parameters.push(Parameter {
        name: "v".to_owned(),
        unit: None,
        value: Value::Free { start: None },
        per: Some(0),
        fixed_levels: BTreeMap::new(),
        lower: None,
        upper: None,
        positive: true,
    });
    let values = BTreeMap::from([(Label::literal(0), 0.5)]);
    let alpha = Alpha { values: vec![Level::Each { column: 0, values, other: None }] };
    let reducer = Reducer::new(&model, &alpha).expect("sound");
    let found = reducer.reduce(&[labelled("t", &[(ROWS[0], 0)])]).expect("sound");
    let found = found.get(0);
    assert!((found.factor[0] - 2f64.sqrt()).abs() < 1e-15, "{}", found.factor[0]);
    let error = reducer.reduce(&[labelled("t", &[(ROWS[0], 1)])]).expect_err("refused");
    assert_eq!(
        error.to_string(),
        "test `t`, row 2: noise variance of measurement `z`: parameter `v` has no value for the level of this row"
    );
}

type Spoil = fn(&mut Model, &mut Vec<[f64; 4]>);

/// Every refusal of a model or its data, with its whole message.
const REFUSALS: &[(Spoil, &str)] = &[
    (|_, rows| rows.clear(), "test `t1`: the test: the test has no rows"),
    (
        |_, rows| rows[1][0] = EMPTY,
        "test `t1`, row 3: time of a row: the cell of column `t` is empty, and it is needed",
    ),
    (|_, rows| rows[3][0] = 0.9, "test `t1`, row 5: time of a row: time 0.9 follows time 1"),
    (
        |_, rows| rows[1][1] = f64::INFINITY,
        "test `t1`, row 3: measurement `z`: the cell of column `z` is inf, expected a finite number",
    ),
    (
        |model, rows| {
            model.measurements[0].equation.constant = column(2);
            rows[1][2] = EMPTY;
        },
        "test `t1`, row 3: equation of measurement `z`: the cell of column `u` is empty, and it is needed",
    ),
    (
        |model, _| model.measurements[0].noise_variance = column(2),
        "test `t1`, row 3: noise variance of measurement `z`: found a variance of -1, expected 0 or more",
    ),
    (
        |model, _| model.measurements[0].noise_variance = number(-1.0),
        "noise variance of measurement `z`: found a variance of -1, expected 0 or more",
    ),
    (
        |model, _| model.measurements[0].filter = Some(binary(Operator::Divide, number(1.0), number(0.0))),
        "`where` of measurement `z`: the value is not a finite number",
    ),
    (
        |model, _| {
            model.states[0].motion = Motion::Continuous { derivative: linear(&[(0, 1e4)]), noise_variance: number(0.0) }
        },
        "test `t1`, row 3: derivative of state `a`: the value is not a finite number",
    ),
    (
        |model, _| model.states[0].offset = Some(column(2)),
        "test `t1`, row 3: the test: column `u` varies within the test: 0.5 and -1",
    ),
    (
        |model, rows| {
            model.states[1].motion = Motion::Discrete { next: linear(&[]), noise_variance: column(3) };
            (rows[1][0], rows[1][3]) = (0.0, 3.0);
            rows[2][0] = 0.0;
            rows.insert(0, [-1.0, EMPTY, 0.0, 0.0]);
        },
        "test `t1`, row 4: transition of a step: rows of one step disagree in column `w`: 2 and 3",
    ),
    (
        |model, _| model.states[1].initial = Initial::Stationary,
        "stationary start of state `b`: the motion has no stationary distribution: it is not stable (b)",
    ),
    (
        |model, _| {
            model.states[1].initial = Initial::Stationary;
            model.states[1].motion = continuous(&[(0, 1.0), (1, -1.0)], 1.0);
        },
        "stationary start of state `b`: `b` starts in its stationary distribution but depends on `a`, which does not",
    ),
    (
        |model, _| {
            model.estimated.clear();
            model.mean = MeanStructure::free(0);
            model.states[0] = state("a", continuous(&[(0, -1.0), (1, 1.0)], 1.0), Initial::Stationary);
            model.states[1] = state("b", discrete(&[(1, 0.5)], 1.0), Initial::Stationary);
        },
        "stationary start of state `a`: `a` and `b` have no stationary distribution together: one moves in continuous time, the other from step to step",
    ),
    (
        |model, _| {
            model.states[0].motion = continuous(&[], 1.0);
            model.process_noise_covariance.push((0, 1, number(0.1)));
        },
        "process noise covariance of states `a` and `b`: `a` moves in continuous time and `b` does not: their noises cannot be correlated",
    ),
    (
        |model, _| model.noise_covariance.push((0, 0, number(0.1))),
        "noise covariance of measurements `z` and `z`: found a covariance of `z` with itself, expected two different names",
    ),
    (
        |model, _| {
            model.states[0].motion = continuous(&[], 1.0);
            model.states[1].motion = continuous(&[], 1.0);
            model.process_noise_covariance.push((0, 1, number(2.0)));
        },
        "test `t1`, row 3: process noise variance of state `a`: the covariance matrix is not positive semidefinite: -3.000e0 of variance 1.000e0 is left after regression on the others",
    ),
    (
        |model, _| {
            model.measurements.push(meter("y", 3, &[(1, 1.0)], 1.0));
            model.noise_covariance.push((0, 1, number(1.0)));
            model.measurements[0].noise_variance = number(0.0);
        },
        "test `t1`, row 2: noise covariance of a step: the covariance matrix is not positive semidefinite: -1.000e0 of variance 0.000e0 is left after regression on the others",
    ),
    (
        |model, _| model.measurements[0].noise_variance = number(0.0),
        "test `t1`, row 3: measurement `z`: measured without any noise, the value is off by -8.000e-1, which is impossible",
    ),
    (
        |model, _| {
            model.measurements[0].noise_variance = number(0.0);
            model.measurements[0].equation = linear(&[(1, 1.0)]);
            model.estimated = vec![0];
            model.mean = MeanStructure::free(1);
            model.states[1].initial = known(1.0, 0.0);
        },
        "test `t1`, row 2: measurement `z`: measured without any noise, the value is off by 2.000e-1, which is impossible",
    ),
    (
        |model, _| {
            model.clock.initial_time = Some(number(0.0));
            model.clock.time = None;
        },
        "initial time: an initial time is given, but the rows have no times",
    ),
    (
        |model, rows| {
            model.mean.regression.push(Regression { element: 1, column: 3 });
            rows.iter_mut().for_each(|row| row[3] = EMPTY);
        },
        "test `t1`: regression of the mean of state `b`: the cell of column `w` is empty, and it is needed",
    ),
];

#[test]
fn every_refusal_says_what_and_where() {
    for (spoil, message) in REFUSALS {
        let mut model = model(vec![constant("a"), constant("b")], vec![meter("z", 1, &[(0, 1.0)], 0.5)]);
        let mut rows = ROWS.to_vec();
        reduce(&model, &test(&rows));
        spoil(&mut model, &mut rows);
        match reduce_all(&model, &[test(&rows)]) {
            Ok(found) => panic!("{message}: not refused, {found:?}"),
            Err(error) => assert_eq!(error.to_string(), *message),
        }
    }
}

#[test]
fn of_several_bad_tests_the_first_is_named() {
    let model = model(vec![constant("a")], vec![meter("z", 1, &[(0, 1.0)], 0.5)]);
    let mut tests = many();
    tests[150] = Test::new("late", 4, 1);
    tests[20] = Test::new("early", 4, 1);
    assert_eq!(reduce_all(&model, &tests).expect_err("refused").test.as_deref(), Some("early"));
}
