//! Scores of long records, compared with differences of ℓ.

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;

use super::*;
use crate::score::InitialLaw;
use crate::score::by_differences::likelihood;
use crate::score::classes::ClassMember;
use crate::score::moments::moments;
use kalfit_fixtures::by_hand;
use kalfit_fixtures::by_hand::{
    alpha, continuous, gauss_markov, known, linear, meter, minus, number, over, square, state,
};
use kalfit_fixtures::{near, slope};
use kalfit_model::{Initial, Model, Motion, Parameter, Value};
use kalfit_model::{Labels, Source};

/// z = bias + scale·walk + drift + level + v; α = (q, τ, σ, r, scale, level), of which the first `free` are free.
fn model(free: usize) -> Model {
    let walk = continuous(Vec::new(), number(0.0), square(alpha(0)));
    let states = vec![
        state("bias", Motion::Constant, Initial::Estimated),
        state("walk", walk, known(number(0.0), number(0.0))),
        state("drift", gauss_markov(2, alpha(1), alpha(2)), Initial::Stationary),
    ];
    let parameter = |k: usize| Parameter {
        value: if k < free { Value::Free { start: None } } else { Value::Fixed(VALUES[k]) },
        ..by_hand::parameter(&format!("a{k}"), None, None, false)
    };
    let equation = linear(vec![(0, number(1.0)), (1, alpha(4)), (2, number(1.0))], alpha(5));
    let (parameters, meter) = ((0..VALUES.len()).map(parameter).collect(), meter("z", 1, equation, square(alpha(3))));
    by_hand::model([&["t", "z"], &[], &[]], parameters, states, vec![meter])
}

const VALUES: [f64; 6] = [0.05, 2.0, 0.4, 0.8, 1.3, 0.1];

/// A record of `rows` rows, simulated from the model.
fn record(rows: u32) -> Test {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut normal = || -> f64 { rng.sample(StandardNormal) };
    let [q, tau, sigma, r, scale, level] = VALUES;
    let (step, bias) = (0.01, 0.7);
    let keep = (-step / tau).exp();
    let (mut walk, mut drift) = (0.0, sigma * normal());
    let mut test = Test::new("long", 2, 0);
    for k in 0..rows {
        let z = bias + scale * walk + drift + level + r * normal();
        test.push(&[f64::from(k) * step, z], &[], Source { file: 0, row: u64::from(k) });
        walk += q * step.sqrt() * normal();
        drift = keep * drift + sigma * (1.0 - keep * keep).sqrt() * normal();
    }
    test
}

fn law() -> InitialLaw {
    InitialLaw::known(DVector::from_vec(vec![0.4]), DMatrix::from_vec(1, 1, vec![0.6]))
}

impl Scorer<'_> {
    /// dℓ_j/dα of each test, one by one, with the moments of ξ of the test.
    fn scores(&self, tests: &[Test], moments: &[Moments]) -> Result<Vec<Gradient>, ReduceError> {
        let room = || (self.reducer.workspace(), BackwardWork::default(), self.pullback.adjoints());
        let one = |room: &mut (Workspace, BackwardWork, Adjoints<'_>), (test, moments): (&Test, &Moments)| {
            let (work, backward, adjoints) = room;
            self.alone(test, (moments, None), (work, backward, adjoints))
        };
        tests.par_iter().zip(moments).map_init(room, |room, pair| one(room, pair)).collect()
    }
}

fn at(model: &Model, slots: &Slots, values: &[f64], test: &Test, unfrozen: bool) -> (f64, Gradient) {
    let reducer = Reducer::scoring(model, &slots.alpha(model, values), slots).expect("sound");
    let reducer = if unfrozen { reducer.unfrozen() } else { reducer };
    let tests = std::slice::from_ref(test);
    let reductions = reducer.reduce(tests).expect("sound");
    let moments = vec![moments(reductions.get(0), &law())];
    let scorer = Scorer::new(&reducer, slots).expect("differentiable");
    (likelihood(reductions.get(0), &law()), scorer.scores(tests, &moments).expect("sound").remove(0))
}

#[test]
fn the_score_of_a_long_record_equals_differences() {
    let test = record(100_000);
    for free in [1, 4, 6] {
        let model = model(free);
        let slots = Slots::new(&model, &Labels::default(), std::slice::from_ref(&test));
        let values = &VALUES[..free];
        let (_, score) = at(&model, &slots, values, &test, false);
        let (_, full) = at(&model, &slots, values, &test, true);
        for slot in 0..free {
            let ell = |x: f64| {
                let mut moved = values.to_vec();
                moved[slot] += x;
                at(&model, &slots, &moved, &test, false).0
            };
            let expected = slope(ell, 2e-3 * values[slot]);
            let (found, full) = (score[slot].1, full[slot].1);
            // ℓ is about 1e5, and its differences are accurate to 1e-10 of that
            let bound = 1e-6 * expected.abs() + 1e-4 / values[slot];
            assert!((found - expected).abs() <= bound, "{free}, slot {slot}: {found} against {expected}");
            let size = full.abs().max(1.0 / values[slot]);
            assert!((found - full).abs() <= 1e-8 * size, "{free}, slot {slot}: {found}, unfrozen {full}");
        }
    }
}

/// z = bias + processes of `taus` + x + v with x' = walk of the speed, and α = the time constants, then σ of all
/// processes, then σ of v.
fn drifting(taus: &[f64], rate: f64) -> Model {
    let n = taus.len();
    let mut states = vec![state("bias", Motion::Constant, Initial::Estimated)];
    for k in 0..n {
        states.push(state(&format!("p{k}"), gauss_markov(1 + k, alpha(k), alpha(n)), Initial::Stationary));
    }
    let mut terms: Vec<_> = (0..=n).map(|k| (k, number(1.0))).collect();
    if rate > 0.0 {
        let speed = || known(number(0.0), number(rate * rate));
        states.push(state("x", continuous(vec![(n + 2, number(1.0))], number(0.0), number(0.0)), speed()));
        states.push(state("speed", continuous(Vec::new(), number(0.0), square(number(rate))), speed()));
        terms.push((n + 1, number(1.0)));
    }
    let parameters = (0..n + 2).map(|k| by_hand::parameter(&format!("a{k}"), None, None, false)).collect();
    let noise = square(alpha(n + 1));
    by_hand::model([&["t", "z"], &[], &[]], parameters, states, vec![meter("z", 1, linear(terms, number(0.0)), noise)])
}

/// Long records with gaps, far from zero, of fast and slow processes and of states that drift away.
#[test]
fn segments_of_any_record_give_what_its_steps_give() {
    let mut rng = ChaCha8Rng::seed_from_u64(60);
    let mut cut = 0;
    for case in 0..24 {
        let mut uniform = |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
        let taus: Vec<f64> = (0..case % 4).map(|_| 10f64.powf(uniform(-0.5, 4.5))).collect();
        let rate = if case % 3 == 0 { 10f64.powf(uniform(-4.0, -1.0)) } else { 0.0 };
        let (level, sigma, noise) = (uniform(-1e3, 1e3), uniform(0.1, 2.0), 10f64.powf(uniform(-2.0, 0.5)));
        let rows = uniform(4500.0, 12_000.0) as u32;
        let gaps: Vec<u32> = (0..case % 3).map(|_| uniform(0.0, f64::from(rows)) as u32).collect();
        let mut normal = || -> f64 { rng.sample(StandardNormal) };
        let (mut processes, mut x, mut speed) = (vec![0.0; taus.len()], 0.0, 0.0);
        let mut test = Test::new("drifting", 2, 0);
        for k in 0..rows {
            let z = level + processes.iter().sum::<f64>() + x + noise * normal();
            // rows that are there, but for what was measured
            let is_blind = case % 6 == 1 && (300..650).contains(&k);
            if !gaps.contains(&k) {
                let z = if is_blind { f64::NAN } else { z };
                test.push(&[f64::from(k), z], &[], Source { file: 0, row: u64::from(k) });
            }
            for (p, tau) in processes.iter_mut().zip(&taus) {
                let keep = (-1.0 / tau).exp();
                *p = keep * *p + sigma * (1.0 - keep * keep).sqrt() * normal();
            }
            x += speed;
            speed += rate * normal();
        }
        let model = drifting(&taus, rate);
        let values: Vec<f64> = taus.iter().copied().chain([sigma, noise]).collect();
        let slots = Slots::new(&model, &Labels::default(), std::slice::from_ref(&test));
        let (ell, score) = at(&model, &slots, &values, &test, false);
        let (expected, full) = at(&model, &slots, &values, &test, true);
        cut += usize::from(ell.to_bits() != expected.to_bits());
        // the mean of ξ is far from the level of the record, so that ℓ is as large as its largest term
        near::absolute(format!("ℓ of case {case}"), ell, expected, 1e-10 * expected.abs().max(f64::from(rows)));
        for ((found, full), value) in score.iter().zip(&full).zip(&values) {
            let size = full.1.abs().max(f64::from(rows).sqrt() / value);
            near::absolute(format!("slope of case {case} at {value}"), found.1, full.1, 1e-9 * size);
        }
    }
    assert!(cut >= 20, "{cut} of 24 records were cut");
}

/// z = bias + x + v with x' = speed + ½, speed' = drift, seldom measured: between measurements x becomes far more
/// uncertain than a measurement is. α = (τ, σ) of the drift.
fn coasting(noise: f64) -> Model {
    let states = vec![
        state("bias", Motion::Constant, Initial::Estimated),
        state("x", continuous(vec![(2, number(1.0))], number(0.5), number(0.0)), known(number(0.0), number(1.0))),
        state("speed", continuous(vec![(3, number(1.0))], number(0.0), number(0.0)), known(number(0.0), number(1.0))),
        state("drift", gauss_markov(3, alpha(0), alpha(1)), known(number(0.0), number(0.5))),
    ];
    let parameters = (0..2).map(|k| by_hand::parameter(&format!("a{k}"), None, None, false)).collect();
    let equation = linear(vec![(0, number(1.0)), (1, number(1.0))], number(0.0));
    by_hand::model([&["t", "z"], &[], &[]], parameters, states, vec![meter("z", 1, equation, number(noise))])
}

/// P and the gains must agree, or P drifts from its true value at every measurement.
#[test]
fn the_score_of_a_process_that_coasts_equals_differences() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut normal = || -> f64 { rng.sample(StandardNormal) };
    for (noise, values) in [(1.0, [100.0, 0.7]), (1e-12, [100.0, 7.0])] {
        let [tau, sigma]: [f64; 2] = values;
        let (mut test, mut x, mut speed, mut drift) = (Test::new("coasting", 2, 0), 0.0, 0.0, 0.5 * normal());
        for k in 0..400_u32 {
            test.push(&[10.0 * f64::from(k), 0.4 + x + normal()], &[], Source { file: 0, row: u64::from(k) });
            for _ in 0..10 {
                x += speed + 0.5 + 0.5 * drift;
                speed += drift;
                drift = drift * (-1.0 / tau).exp() + sigma * (2.0 / tau).sqrt() * normal();
            }
        }
        let model = coasting(noise);
        let slots = Slots::new(&model, &Labels::default(), std::slice::from_ref(&test));
        let (_, score) = at(&model, &slots, &values, &test, false);
        for slot in 0..2 {
            let ell = |x: f64| {
                let mut moved = values;
                moved[slot] += x;
                at(&model, &slots, &moved, &test, false).0
            };
            let expected = slope(ell, 2e-3 * values[slot]);
            let bound = 1e-5 * (expected.abs() + 1.0 / values[slot]);
            let found = score[slot].1;
            assert!((found - expected).abs() <= bound, "noise {noise}, slot {slot}: {found} against {expected}");
        }
    }
}

#[test]
fn a_long_record_is_scored_to_the_same_bits_on_any_thread() {
    let tests: Vec<Test> = (0..4).map(|k| record(3000 + 700 * k)).collect();
    let model = model(6);
    let slots = Slots::new(&model, &Labels::default(), &tests);
    let reducer = Reducer::scoring(&model, &slots.alpha(&model, &VALUES), &slots).expect("sound");
    let reductions = reducer.reduce(&tests).expect("sound");
    let moments: Vec<Moments> = reductions.iter().map(|reduction| moments(reduction, &law())).collect();
    let scorer = Scorer::new(&reducer, &slots).expect("differentiable");
    let together = scorer.scores(&tests, &moments).expect("sound");
    for k in 0..tests.len() {
        let alone = scorer.scores(&tests[k..=k], &moments[k..=k]).expect("sound");
        assert_eq!(alone[0], together[k]);
    }
}

/// A record in which rows are missing, and values too.
fn gappy(number: u32) -> Test {
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(number));
    let long = record(6000);
    let mut test = Test::new(format!("gappy {number}"), 2, 0);
    for row in (0..long.rows()).filter(|row| !(1700..1703).contains(row) && !(4000..4900).contains(row)) {
        let numbers = long.numbers(row);
        let noise: f64 = rng.sample(StandardNormal);
        let z = if row == 2500 || row == 2502 { f64::NAN } else { numbers[1] + 0.3 * noise };
        test.push(&[numbers[0], z], &[], long.source(row));
    }
    test
}

/// z = bias + x + v with x' = -x/τ, which no noise drives; τ is free.
fn decaying() -> Model {
    let decay = continuous(vec![(1, minus(over(number(1.0), alpha(0))))], number(0.0), number(0.0));
    let states =
        vec![state("bias", Motion::Constant, Initial::Estimated), state("x", decay, known(number(1.0), number(0.0)))];
    let equation = linear(vec![(0, number(1.0)), (1, number(1.0))], number(0.0));
    let parameters = vec![by_hand::parameter("tau", None, None, true)];
    by_hand::model([&["t", "z"], &[], &[]], parameters, states, vec![meter("z", 1, equation, number(1.0))])
}

#[test]
fn long_records_that_are_alike_are_scored_as_one_by_one() {
    let tests: Vec<Test> = (0..3).map(gappy).collect();
    let models = [1, 4, 6].into_iter().map(|free| (free, model(free), VALUES)).chain([(1, decaying(), [20.0; 6])]);
    for (free, model, values) in models {
        let slots = Slots::new(&model, &Labels::default(), &tests);
        let reducer = Reducer::scoring(&model, &slots.alpha(&model, &values[..free]), &slots).expect("sound");
        let reductions = reducer.reduce(&tests).expect("sound");
        let moments: Vec<Moments> = reductions.iter().map(|reduction| moments(reduction, &law())).collect();
        let scorer = Scorer::new(&reducer, &slots).expect("differentiable");
        let told =
            |(test, moments): (_, &Moments)| ClassMember { test, mean: moments.mean.clone(), ending: Vec::new() };
        let told: Vec<ClassMember<'_>> = tests.iter().zip(&moments).map(told).collect();
        let (mut work, mut backward, mut adjoints) =
            (reducer.workspace(), BackwardWork::default(), scorer.pullback.adjoints());
        let room = (&mut work, &mut backward, &mut adjoints);
        let together = scorer.score_class(&told, (&moments[0], None), room).expect("sound").expect("they are alike");
        let alone = scorer.scores(&tests, &moments).expect("sound");
        for (number, (found, expected)) in together.iter().zip(&alone).enumerate() {
            assert_eq!(found.len(), free, "each value counts");
            for ((slot, found), (at, expected)) in found.iter().zip(expected) {
                assert_eq!(slot, at);
                let off = (found - expected).abs() / (1.0 + expected.abs());
                assert!(off < 1e-10, "{free} free, test {number}, value {slot}: {found}, alone {expected}");
            }
        }
    }
}

/// A long record that begins with states of which much less is known than its rows tell, one of them or two as a sum.
#[test]
fn segments_after_wide_laws_keep_their_digits() {
    let mut rng = ChaCha8Rng::seed_from_u64(61);
    for deviation in [1.0, 10.0, 100.0, 1e4, 1e6] {
        let kinds = [(true, 1, true), (false, 1, true), (true, 2, true), (false, 2, true), (true, 1, false)];
        for (estimated, known_states, starts_wide) in kinds {
            let wide = || known(number(0.0), number(deviation * deviation));
            let mut states = vec![state("walk", continuous(Vec::new(), number(0.0), number(1e-4)), wide())];
            (1..known_states).for_each(|_| states.push(state("constant", Motion::Constant, wide())));
            if estimated {
                states.push(state("bias", Motion::Constant, Initial::Estimated));
            }
            let equation = linear((0..states.len()).map(|k| (k, number(1.0))).collect(), number(0.0));
            let meter = meter("z", 1, equation, number(1.0));
            let model = by_hand::model([&["t", "z"], &[], &[]], Vec::new(), states, vec![meter]);
            let mut test = Test::new("wide", 2, 0);
            for k in 0..5000_u32 {
                let z = 0.7 * deviation + rng.sample::<f64, _>(StandardNormal);
                test.push(
                    &[f64::from(k), if k == 0 && starts_wide { f64::NAN } else { z }],
                    &[],
                    Source { file: 0, row: u64::from(k) },
                );
            }
            let reducer = || Reducer::new(&model, &kalfit_model::Alpha::default()).expect("sound");
            let tests = std::slice::from_ref(&test);
            let (found, each) =
                (reducer().reduce(tests).expect("sound"), reducer().unfrozen().reduce(tests).expect("sound"));
            let (found, each) = (found.get(0), each.get(0));
            let what = format!("{known_states} of deviation {deviation}, estimated {estimated}, {starts_wide}");
            near::relative(format!("c, {what}"), found.constant, each.constant, 1e-9);
            near::slices(format!("R, {what}"), found.factor, each.factor, 1e-8 * near::largest(each.factor));
            near::slices(format!("d, {what}"), found.data, each.data, 1e-7 * near::largest(each.data));
        }
    }
}
