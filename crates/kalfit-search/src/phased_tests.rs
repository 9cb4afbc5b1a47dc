//! Whole searches for α over tests in phases.

use crate::tests::{check_alike, check_gradient, settings};
use crate::{DynamicError, DynamicFit, Method, Settings, fit};
use kalfit_estimate::{Combination, Criterion, Silent, Stop};
use kalfit_filter::reduce::PhasedReducer;
use kalfit_fixtures::by_hand;
use kalfit_fixtures::by_hand::{Lcg, alpha, continuous, gauss_markov, linear, meter, number, square, state};
use kalfit_model::{
    Carry, Clock, CovarianceKind, Expression, Initial, Linear, MeanElement, Model, Motion, Phase, PhasedModel, Slots,
    State, Value,
};
use kalfit_model::{Evidence, PhasedTest};
use kalfit_model::{Label, Labels, Source, Test};

fn known(mean: f64, variance: f64) -> Initial {
    by_hand::known(number(mean), number(variance))
}

/// A Gauss-Markov state: time constant and steady-state standard deviation are parameters 0 and 1.
fn drift(index: usize, initial: Initial) -> State {
    state("drift", gauss_markov(index, alpha(0), alpha(1)), initial)
}

/// Columns t, z, u, before (time of the last row of the phase before); text column phase.
fn model(states: Vec<State>, equation: Linear, noise: usize, parameters: &[(bool, f64)]) -> Model {
    let parameter = |(k, &(positive, start)): (usize, &(bool, f64))| {
        by_hand::parameter(&format!("a{k}"), Some(start), None, positive)
    };
    let names: [&[&str]; 3] = [&["t", "z", "u", "before"], &["phase"], &["first", "second"]];
    let parameters = parameters.iter().enumerate().map(parameter).collect();
    by_hand::model(names, parameters, states, vec![meter("z", 1, equation, square(alpha(noise)))])
}

fn phases(first: Model, second: Model, carry: Vec<Carry>) -> PhasedModel {
    let name = |at: usize| first.literals[at].clone();
    let phases = vec![
        Phase { name: name(0), label: Some(0), model: first.clone(), carry: Vec::new(), filter: None },
        Phase { name: name(1), label: Some(1), model: second, carry, filter: None },
    ];
    PhasedModel { phases, column: Some(0), levels: Vec::new() }
}

const TRUE: [(bool, f64); 6] = [(true, 1.5), (true, 0.5), (true, 0.3), (true, 0.4), (true, 0.5), (false, 0.8)];

/// First phase: bias, slope and a drift; second phase: a rate and an angle that begins at a part of the bias and walks.
/// τ, σ, the noise of the first phase, that of the walk, that of the second phase, and the part of the bias are free.
fn bench_and_flight() -> PhasedModel {
    let first = model(
        vec![
            state("bias", Motion::Constant, Initial::Estimated),
            state("slope", Motion::Constant, Initial::Estimated),
            drift(2, Initial::Stationary),
        ],
        linear(vec![(0, number(1.0)), (1, Expression::Column(2)), (2, number(1.0))], number(0.0)),
        2,
        &TRUE,
    );
    let walk = continuous(Vec::new(), number(0.0), square(alpha(3)));
    let second = model(
        vec![state("angle", walk, known(0.0, 0.04)), state("rate", Motion::Constant, Initial::Estimated)],
        linear(vec![(0, number(1.0)), (1, Expression::Column(2))], number(0.0)),
        4,
        &TRUE,
    );
    let from = linear(vec![(0, alpha(5)), (2, number(0.5))], number(0.1));
    phases(first, second, vec![Carry { state: 0, from }])
}

fn rows(id: &str, at: usize, rows: &[(f64, f64, f64)]) -> Evidence {
    let mut test = Test::new(id, 4, 1);
    rows.iter().for_each(|&(t, z, u)| test.push(&[t, z, u, 0.0], &[Label::literal(at)], Source::default()));
    Evidence::Rows(test)
}

/// Tests drawn from the model; every fifth one lacks the second phase.
fn drawn(tests: usize, seed: u64) -> Vec<PhasedTest> {
    let mut random = Lcg(seed);
    let [tau, sigma, noise, q, late, part] = TRUE.map(|(_, value)| value);
    let test = |j: usize| {
        let id = format!("u{j:02}");
        let (bias, slope, rate) = (1.0 + random.normal(), -0.5 + 0.6 * random.normal(), 0.4 + 0.7 * random.normal());
        let (mut t, mut drift, mut first, mut second) = (0.0, sigma * random.normal(), Vec::new(), Vec::new());
        for k in 0..8 + j % 3 {
            let dt = if k == 0 { 0.0 } else { 0.3 + 0.4 * (random.next() + 0.5) };
            t += dt;
            let phi = f64::exp(-dt / tau);
            drift = phi * drift + sigma * (1.0 - phi * phi).sqrt() * random.normal();
            let u = 3.0 * random.next();
            first.push((t, bias + slope * u + drift + noise * random.normal(), u));
        }
        let mut angle = part * bias + 0.5 * drift + 0.1 + 0.2 * random.normal();
        for k in 0..7 + j % 2 {
            let dt: f64 = if k == 0 { 0.0 } else { 0.5 };
            t += dt;
            angle += q * dt.sqrt() * random.normal();
            let u = 3.0 * random.next();
            second.push((t, angle + rate * u + late * random.normal(), u));
        }
        let mut phases = vec![rows(&id, 0, &first), rows(&id, 1, &second)];
        phases.truncate(if j % 5 == 4 { 1 } else { 2 });
        PhasedTest { id: id.into(), phases: phases.into() }
    };
    (0..tests).map(test).collect()
}

fn certified(model: &PhasedModel, tests: &[PhasedTest], settings: &Settings) -> DynamicFit {
    let labels = Labels::new(&model.shared().literals);
    let fit = fit(model, &labels, tests, settings, &mut Silent).expect("a fit");
    assert_eq!(fit.stop, Stop::Certified, "{settings:?}: {:?}, {}", fit.values, fit.certificate);
    fit
}

#[test]
fn the_gradient_over_phases_equals_differences_of_the_maximum_over_mean_and_covariance() {
    let (model, tests) = (bench_and_flight(), drawn(11, 3));
    let slots = Slots::in_phases(&model, &Labels::new(&model.shared().literals), &tests);
    check_gradient((&model, &tests, &slots), &[1.2, 0.6, 0.35, 0.5, 0.45, 0.7]);
}

#[test]
fn the_methods_end_at_one_point_in_phases() {
    let (model, tests) = (bench_and_flight(), drawn(16, 4));
    for criterion in [Criterion::Ml, Criterion::Reml] {
        let hybrid = certified(&model, &tests, &settings(Method::Hybrid, criterion));
        let others: &[Method] =
            if criterion == Criterion::Ml { &[Method::Innovations, Method::Em] } else { &[Method::Innovations] };
        for &method in others {
            // EM is slow from afar, so it starts near by
            let start = if method == Method::Em { near(&model, &hybrid.values) } else { model.clone() };
            let other = certified(&start, &tests, &settings(method, criterion));
            check_alike(&hybrid, &other, &format!("{method:?}, {criterion:?}"));
        }
        let mut stacked = settings(Method::Hybrid, criterion);
        stacked.inner.phases = Combination::Stacked;
        let stacked = certified(&model, &tests, &stacked);
        let (a, b) = (hybrid.estimate.log_likelihood, stacked.estimate.log_likelihood);
        assert!((a - b).abs() < 1e-9, "{criterion:?}: {a} by the chain, {b} stacked");
    }
}

/// The model with its parameters starting near these values.
fn near(model: &PhasedModel, values: &[f64]) -> PhasedModel {
    let mut near = model.clone();
    for phase in &mut near.phases {
        for (parameter, value) in phase.model.parameters.iter_mut().zip(values) {
            parameter.value = Value::Free { start: Some(1.001 * value) };
        }
    }
    near
}

/// The first phase of the model above, whole and cut in two: the second part begins where the first one ends, with
/// nothing added.
fn whole_and_halves() -> (PhasedModel, PhasedModel) {
    let whole = bench_and_flight().phases[0].model.clone();
    let whole = Model { parameters: whole.parameters[..3].to_vec(), ..whole };
    let mut second = whole.clone();
    second.states[2].initial = known(0.0, 0.0);
    second.clock = Clock { initial_time: Some(Expression::Column(3)), ..second.clock };
    second.mean.elements = vec![MeanElement::Fixed(0.0); 2];
    second.covariance.kind = CovarianceKind::Fixed(vec![vec![number(0.0); 2]; 2]);
    let same = |state: usize| Carry { state, from: linear(vec![(state, number(1.0))], number(0.0)) };
    (whole.clone().into(), phases(whole, second, (0..3).map(same).collect()))
}

/// The rows of the first phase, whole and cut in two.
fn cut(tests: &[PhasedTest]) -> (Vec<PhasedTest>, Vec<PhasedTest>) {
    let (mut wholes, mut halves) = (Vec::new(), Vec::new());
    for (j, test) in tests.iter().enumerate() {
        let Evidence::Rows(rows) = &test.phases[0] else { unreachable!("rows were drawn") };
        let (mut parts, at) = ([Test::new(&test.id, 4, 1), Test::new(&test.id, 4, 1)], 2 + j % 5);
        for k in 0..rows.rows() {
            let mut cells = rows.numbers(k).to_vec();
            cells[3] = rows.numbers(at - 1)[0];
            parts[usize::from(k >= at)].push(&cells, rows.texts(k), rows.source(k));
        }
        wholes.push(rows.clone().into());
        halves.push(PhasedTest { id: test.id.clone(), phases: parts.map(Evidence::Rows).into_iter().collect() });
    }
    (wholes, halves)
}

#[test]
fn tests_cut_in_two_give_the_fit_of_the_whole() {
    let (whole, halves) = whole_and_halves();
    let (tests, cut) = cut(&drawn(12, 5));
    for method in [Method::Hybrid, Method::Innovations, Method::Em] {
        let settings = settings(method, Criterion::Ml);
        let (a, b) = (certified(&whole, &tests, &settings), certified(&halves, &cut, &settings));
        let (x, y) = (a.estimate.log_likelihood, b.estimate.log_likelihood);
        assert!((x - y).abs() < 1e-9 * x.abs(), "{method:?}: {x} whole, {y} in two parts");
        for (x, y) in a.values.iter().zip(&b.values).chain(a.estimate.mean.iter().zip(&b.estimate.mean)) {
            assert!((x - y).abs() < 1e-6 * (1.0 + x.abs()), "{method:?}: {x} whole, {y} in two parts");
        }
    }
}

#[test]
fn marginal_phases_and_fixed_reductions_do_not_go_with_free_parameters() {
    let (model, tests) = (bench_and_flight(), drawn(6, 6));
    let labels = Labels::new(&model.shared().literals);
    let mut marginal = settings(Method::Hybrid, Criterion::Ml);
    marginal.inner.phases = Combination::Marginal;
    let refused = |tests: &[PhasedTest], settings: &Settings| {
        fit(&model, &labels, tests, settings, &mut Silent).expect_err("refused").to_string()
    };
    insta::assert_snapshot!(refused(&tests, &marginal), @"`a0` is free, and `marginal` is for known parameters: found 6 free values, expected none");
    let slots = Slots::in_phases(&model, &labels, &tests);
    let alpha = slots.alpha(model.shared(), &TRUE.map(|(_, value)| value));
    let mut pieces = PhasedReducer::new(&model, &alpha).expect("sound").pieces(&tests).expect("sound");
    let mut reduced = tests.clone();
    reduced[2].phases[1] = Evidence::Reduced(Box::new(pieces.remove(2).remove(1)));
    insta::assert_snapshot!(refused(&reduced, &Settings::default()), @"test `u02` comes as a reduction, made at known parameters, but `a3` of phase `second` is free");
    assert!(matches!(
        fit(&model, &labels, &reduced, &Settings::default(), &mut Silent),
        Err(DynamicError::FixedReduction { .. })
    ));
}
