//! EM against ℓ itself, difference quotients, and the hybrid method, on ensembles drawn at random.

use nalgebra::DMatrix;

use super::*;
use crate::profile_likelihood::ProfileLikelihood;
use crate::{Method, Settings};
use kalfit_estimate::Silent;
use kalfit_filter::simulate::{Designs, Simulator};
use kalfit_fixtures::by_hand;
use kalfit_fixtures::by_hand::{alpha, gauss_markov, linear, minus, number, plus, square, state, times};
use kalfit_fixtures::slope;
use kalfit_model::PhasedTest;
use kalfit_model::{
    Expression, Initial, Measurement, Model, Motion, Parameter, PhasedModel, Population, Slots, State, Value,
};
use kalfit_model::{Labels, Source, Test};

fn continuous(terms: Vec<(usize, Expression)>, noise_variance: Expression) -> Motion {
    by_hand::continuous(terms, number(0.0), noise_variance)
}

/// Measurement of one of the columns 1, 2, …
fn meter(index: usize, terms: Vec<(usize, Expression)>, constant: Expression, noise: Expression) -> Measurement {
    by_hand::meter(&format!("y{index}"), 1 + index, linear(terms, constant), noise)
}

/// Columns t, y1, y2. Parameters: (positive, value).
fn model(states: Vec<State>, measurements: Vec<Measurement>, parameters: &[(bool, f64)]) -> Model {
    let parameter = |(k, (positive, value)): (usize, &(bool, f64))| {
        by_hand::parameter(&format!("a{k}"), Some(*value), None, *positive)
    };
    let parameters = parameters.iter().enumerate().map(parameter).collect();
    by_hand::model([&["t", "y1", "y2"], &[], &[]], parameters, states, measurements)
}

/// A Gauss-Markov state together with a constant, measured by two sensors whose noises are correlated and grow with
/// time; a gain and an offset are unknown. Parameters: τ, σ, s1, r0, r1, gain, offset, covariance.
fn sensors() -> Model {
    let motion = gauss_markov(1, alpha(0), alpha(1));
    let states = vec![state("base", Motion::Constant, Initial::Estimated), state("gm", motion, Initial::Stationary)];
    let grows = plus(square(alpha(3)), square(times(alpha(4), Expression::Column(0))));
    let measurements = vec![
        meter(0, vec![(0, number(1.0)), (1, number(1.0))], number(0.0), square(alpha(2))),
        meter(1, vec![(0, number(0.4)), (1, alpha(5))], alpha(6), grows),
    ];
    let values =
        [(true, 1.2), (true, 0.8), (true, 0.3), (true, 0.3), (true, 0.05), (false, 1.5), (false, 0.3), (false, 0.02)];
    let mut model = model(states, measurements, &values);
    model.noise_covariance = vec![(0, 1, alpha(7))];
    model
}

/// Two states by recursion, with correlated noises. Parameters: f11, f12, f21, f22, q1, q2, q12, r1, r2.
fn recursion() -> Model {
    let next = |i: usize| Motion::Discrete {
        next: linear(vec![(0, alpha(2 * i)), (1, alpha(2 * i + 1))], number(0.1)),
        noise_variance: square(alpha(4 + i)),
    };
    let states = vec![state("x1", next(0), Initial::Estimated), state("x2", next(1), Initial::Estimated)];
    let measurements = vec![
        meter(0, vec![(0, number(1.0))], number(0.0), square(alpha(7))),
        meter(1, vec![(1, number(1.0))], number(0.0), square(alpha(8))),
    ];
    let (f, q) = ([0.9, 0.2, -0.1, 0.6], [(true, 0.5), (true, 0.4), (false, 0.05), (true, 0.3), (true, 0.4)]);
    let values: Vec<(bool, f64)> = f.iter().map(|f| (false, *f)).chain(q).collect();
    let mut model = model(states, measurements, &values);
    model.process_noise_covariance = vec![(0, 1, alpha(6))];
    model
}

/// A decay that no noise accompanies, and a random walk. Parameters: rate, q, s.
fn decay() -> Model {
    let walk = continuous(Vec::new(), square(alpha(1)));
    let known = Initial::Known { mean: number(0.0), variance: number(0.0) };
    let states = vec![
        state("amplitude", continuous(vec![(0, minus(alpha(0)))], number(0.0)), Initial::Estimated),
        state("walk", walk, known),
    ];
    let h = vec![(0, number(1.0)), (1, number(1.0))];
    let measurements = vec![meter(0, h, number(0.0), square(alpha(2)))];
    model(states, measurements, &[(true, 0.4), (true, 0.2), (true, 0.3)])
}

/// Tests drawn from the model at its start values; times are irregular, some values missing.
fn drawn(model: &Model, seed: u64) -> Vec<Test> {
    let noise = |k: usize| ((k as f64 + 0.37 * seed as f64) * 0.618_033_988_749_895).fract();
    let design = |j: usize| {
        let mut test = Test::new(format!("t{j}"), 3, 0);
        let mut t = 0.0;
        for k in 0..12 + j % 3 {
            let missing = if (j + 2 * k).is_multiple_of(7) { f64::NAN } else { 1.0 };
            test.push(&[t, 1.0, missing], &[], Source::default());
            t += if j.is_multiple_of(2) { 0.5 } else { 0.2 + noise(31 * j + k) };
        }
        test
    };
    let slots = Slots::new(model, &Labels::default(), &[]);
    let p = model.dimension();
    let covariance = DMatrix::from_fn(p, p, |i, j| if i == j { 1.0 } else { 0.3 });
    let population = Population { mean: vec![2.0; p], coefficients: Vec::new(), covariance };
    let simulator =
        Simulator::new(&model.clone().into(), &slots.alpha(model, &starts(model)), population, seed).expect("a law");
    let designs = Designs::new((0..14).map(|j| design(j).into()).collect()).expect("tests");
    simulator.draw(&designs, 0..14).expect("drawn").into_iter().flat_map(|drawn| drawn.test.rows()).collect()
}

fn starts(model: &Model) -> Vec<f64> {
    let start = |p: &Parameter| match p.value {
        Value::Free { start: Some(start) } => start,
        _ => f64::NAN,
    };
    model.parameters.iter().map(start).collect()
}

/// Values some way off the start values.
fn off(model: &Model) -> Vec<f64> {
    let moved = |(k, x): (usize, f64)| x * if k % 2 == 0 { 1.25 } else { 0.8 };
    starts(model).into_iter().enumerate().map(moved).collect()
}

fn phased(tests: Vec<Test>) -> Vec<PhasedTest> {
    tests.into_iter().map(PhasedTest::from).collect()
}

fn with_bench<T>(model: &Model, seed: u64, go: impl FnOnce(&ProfileLikelihood<'_>) -> T) -> T {
    let (tests, model) = (phased(drawn(model, seed)), PhasedModel::from(model.clone()));
    let slots = Slots::in_phases(&model, &Labels::default(), &tests);
    go(&ProfileLikelihood::new(&model, &tests, &slots, &Settings::default()))
}

fn end(objective: &ProfileLikelihood<'_>, values: &[f64], method: Method) -> SearchEnd {
    let settings = Settings { method, ..objective.settings.clone() };
    let own = ProfileLikelihood::new(objective.model, objective.tests, objective.slots, &settings);
    crate::search::search(&own, values.to_vec().into(), None, &mut Silent).expect("it ends")
}

#[test]
fn the_expected_likelihood_has_the_slope_of_the_likelihood_where_its_moments_are() {
    for model in [sensors(), recursion(), decay()] {
        with_bench(&model, 1, |objective| {
            let iterate = objective.solve(&off(&model), None).expect("solved");
            let complete = objective.complete(&iterate).expect("moments");
            let (_, gradient) = objective.expected(&complete, &iterate.values).expect("defined at home");
            let ways = ways(objective, &iterate).expect("ways");
            let own = |(s, _): &(usize, (&f64, &f64))| ways[*s] != Way::Likelihood;
            for (s, (own, wanted)) in gradient.iter().zip(&iterate.gradient).enumerate().filter(own) {
                let apart = (own - wanted).abs() / (1.0 + wanted.abs());
                assert!(apart < 1e-7, "value {s}: {own} of Q, {wanted} of the likelihood");
            }
        });
    }
}

#[test]
fn the_gradient_of_the_expected_likelihood_equals_difference_quotients() {
    for model in [sensors(), recursion()] {
        with_bench(&model, 2, |objective| {
            let iterate = objective.solve(&off(&model), None).expect("solved");
            let complete = objective.complete(&iterate).expect("moments");
            let away: Vec<f64> = iterate.values.iter().map(|x| x * 1.07).collect();
            let (_, gradient) = objective.expected(&complete, &away).expect("defined");
            for (s, own) in gradient.iter().enumerate() {
                let at = |h: f64| {
                    let mut values = away.clone();
                    values[s] = objective.coordinates[s].moved(values[s], h);
                    objective.expected(&complete, &values).expect("defined").0
                };
                let quotient = slope(at, 1e-4);
                let apart = (own - quotient).abs() / (1.0 + quotient.abs());
                assert!(apart < 1e-7, "value {s}: {own}, quotient {quotient}");
            }
        });
    }
}

#[test]
fn a_noise_level_in_closed_form_maximises_the_expected_likelihood() {
    let model = decay();
    with_bench(&model, 3, |objective| {
        let iterate = objective.solve(&off(&model), None).expect("solved");
        let ways = ways(objective, &iterate).expect("ways");
        assert_eq!(ways[0], Way::Likelihood, "no noise accompanies the rate");
        let free: Vec<bool> = ways.iter().map(|way| matches!(way, Way::Level { .. })).collect();
        assert_eq!(free, [false, true, true], "noise levels: {ways:?}");
        let complete = objective.complete(&iterate).expect("moments");
        let expected = |values: &[f64]| objective.expected(&complete, values);
        let found = Ascent::default().maximise(&expected, iterate.values.clone(), &free, objective);
        for s in 1..3 {
            let Way::Level { degree, count } = ways[s] else { unreachable!("just asserted") };
            let closed = iterate.values[s] * level_step(&objective.coordinates[s], &iterate, s, (degree, count)).exp();
            assert!((closed / found[s] - 1.0).abs() < 1e-7, "level {s}: closed form {closed}, maximum {}", found[s]);
        }
    });
}

#[test]
fn the_likelihood_rises_at_least_as_much_as_the_expected_one() {
    for (model, seed) in [(sensors(), 4), (recursion(), 5), (sensors(), 6), (recursion(), 7)] {
        with_bench(&model, seed, |objective| {
            let iterate = objective.solve(&off(&model), None).expect("solved");
            let complete = objective.complete(&iterate).expect("moments");
            let expected = |values: &[f64]| objective.expected(&complete, values);
            let before = expected(&iterate.values).expect("defined").0;
            let found = Ascent::default().maximise(
                &expected,
                iterate.values.clone(),
                &vec![true; iterate.values.len()],
                objective,
            );
            let promised = expected(&found).expect("defined").0 - before;
            let risen = objective.value(&found).expect("defined") - iterate.value();
            assert!(promised > 1e-3 && risen >= promised - 1e-9, "Q rises by {promised}, the likelihood by {risen}");
        });
    }
}

#[test]
fn em_never_lets_the_likelihood_fall_and_ends_where_the_hybrid_ends() {
    for (model, seed) in [(sensors(), 11), (recursion(), 12), (decay(), 13), (decay(), 14), (recursion(), 15)] {
        with_bench(&model, seed, |objective| {
            let from = off(&model);
            let (em, hybrid) = (end(objective, &from, Method::Em), end(objective, &from, Method::Hybrid));
            let slack = 1e-11 * em.iterate.value().abs();
            for pair in em.trace.windows(2) {
                assert!(pair[1] >= pair[0] - slack, "seed {seed}: from {} to {}", pair[0], pair[1]);
            }
            assert_eq!((em.stop, hybrid.stop), (Stop::Certified, Stop::Certified), "seed {seed}");
            let (own, other) = (em.iterate.value(), hybrid.iterate.value());
            assert!((own - other).abs() < 1e-7, "seed {seed}: ℓ {own} by EM, {other} by the hybrid");
            let worth = em.joint.covariances();
            for (s, (a, b)) in em.iterate.values.iter().zip(&hybrid.iterate.values).enumerate() {
                let Some(variance) = worth.alpha[s] else { continue };
                let error = variance.sqrt() * objective.coordinates[s].slope(*a).abs();
                assert!(
                    (a.abs() - b.abs()).abs() < 1e-5 * error,
                    "seed {seed}, value {s}: {a} by EM, {b} by the hybrid"
                );
            }
        });
    }
}

#[test]
fn a_level_that_should_be_zero_gets_there() {
    let mut model = decay();
    model.parameters[1].value = Value::Free { start: Some(0.05) };
    with_bench(&model, 21, |objective| {
        let mut noiseless = model.clone();
        noiseless.parameters[1].value = Value::Free { start: Some(1e-9) };
        let (tests, model) = (phased(drawn(&noiseless, 22)), PhasedModel::from(model.clone()));
        let own = ProfileLikelihood::new(&model, &tests, objective.slots, objective.settings);
        let (em, hybrid) = (end(&own, &[0.4, 0.05, 0.3], Method::Em), end(&own, &[0.4, 0.05, 0.3], Method::Hybrid));
        assert_eq!(em.stop, Stop::Certified);
        let (a, b) = (em.iterate.value(), hybrid.iterate.value());
        assert!(
            (a - b).abs() < 1e-7,
            "ℓ {a} by EM, {b} by the hybrid; levels {}, {}",
            em.iterate.values[1],
            hybrid.iterate.values[1]
        );
    });
}
