//! Tests in lanes, compared with the same tests one by one.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::reduce::{FilteredPhases, PhasedBatches, PhasedReducer, Reductions, Replicates};
use crate::score::Gradient;
use crate::score::InitialLaw;
use crate::score::phased::PhasedScorer;
use crate::score::phased::tests::*;
use kalfit_fixtures::by_hand::{continuous, gauss_markov, minus};
use kalfit_fixtures::near;
use kalfit_model::Path;
use kalfit_model::PhasedTest;
use kalfit_model::Reduction;
use kalfit_model::{Clock, Expression, Initial, Motion, PhasedModel, Slots};
use kalfit_model::{Label, Labels, Source, Test};

/// A random model of one phase, with some of the features that batches support.
fn drawn_model(random: &mut impl FnMut() -> f64) -> PhasedModel {
    let mut flip = || random() > 0.0;
    let mut states = vec![state("bias", Motion::Constant, Initial::Estimated)];
    let mut terms = vec![(0, number(1.0))];
    if flip() {
        terms.push((states.len(), if flip() { column(U) } else { alpha(KICK) }));
        states.push(state("slope", Motion::Constant, Initial::Estimated));
    }
    if flip() {
        // the law of x_0 differs between tests, or is common to all
        let (own, part) = (states.len(), if flip() { column(W) } else { number(1.1) });
        let variance = square(times(alpha(START), part.clone()));
        let start = if flip() { Initial::Stationary } else { known(number(0.0), variance) };
        terms.push((own, number(0.8)));
        states.push(state("drift", gauss_markov(own, alpha(TAU), times(alpha(DRIFT), part)), start));
    }
    if flip() {
        let own = states.len();
        let next = linear(vec![(0, number(0.2)), (own, alpha(KEEP))], times(alpha(INPUT), column(U)));
        terms.push((own, alpha(CARRY)));
        let walk = Motion::Discrete { next, noise_variance: square(alpha(STEP)) };
        states.push(state("walk", walk, known(number(0.1), square(alpha(START)))));
    }
    if flip() {
        let own = states.len();
        let rate = if flip() { Expression::Negate(Box::new(square(alpha(KICK)))) } else { number(-0.4) };
        let input = if flip() { times(alpha(INPUT), column(U)) } else { number(0.0) };
        let derivative = linear(vec![(0, times(alpha(CARRY), column(W))), (own, rate)], input);
        let lag = Motion::Continuous { derivative, noise_variance: square(times(alpha(STEP), column(W))) };
        terms.push((own, number(1.3)));
        states.push(state("lag", lag, if flip() { Initial::Estimated } else { known(number(0.2), number(0.3)) }));
    }
    if flip() {
        // coupled states, whose transition needs a matrix exponential
        let own = states.len();
        let damping = if flip() { alpha(KEEP) } else { times(alpha(KEEP), column(W)) };
        let pull = vec![(own, minus(square(alpha(TAU)))), (own + 1, minus(damping))];
        let input = if flip() { times(alpha(INPUT), column(U)) } else { number(0.0) };
        let position = continuous(vec![(own + 1, number(1.0))], number(0.0), number(0.0));
        states.push(state(
            "position",
            position,
            if flip() { Initial::Estimated } else { known(number(0.2), number(0.1)) },
        ));
        states.push(state("velocity", continuous(pull, input, square(alpha(STEP))), known(number(0.0), number(0.3))));
        terms.push((own, number(0.6)));
    }
    let constant = if flip() { times(alpha(OFFSET), column(U)) } else { alpha(OFFSET) };
    let mut model = model(states, linear(terms, constant));
    if flip() {
        let equation = linear(vec![(0, alpha(KEEP))], number(0.1));
        let second = meter("w", 4, equation, number(0.7));
        model.columns.push(model.columns[1].clone());
        model.measurements.push(second);
        if flip() {
            model.noise_covariance.push((0, 1, times(number(0.4), alpha(NOISE))));
        }
    } else {
        model.columns.push(model.columns[1].clone());
    }
    let initial_time = flip().then(|| number(-0.3));
    model.clock = Clock { time: Some(0), initial_time, previous_inputs: flip(), ..Clock::default() };
    PhasedModel::from(model)
}

/// Tests with different times and lengths, some of whose values are missing.
fn drawn_tests(random: &mut impl FnMut() -> f64) -> Vec<PhasedTest> {
    (0..37).map(|number| drawn_test(random, number, 1 + (number * 7) % 12)).collect()
}

fn drawn_test(random: &mut impl FnMut() -> f64, number: usize, rows: usize) -> PhasedTest {
    let (mut test, mut time) = (Test::new(format!("t{number}"), 5, 3), 0.0);
    let w = 1.0 + 0.1 * (number % 4) as f64;
    for k in 0..rows {
        let values = [0, 1].map(|_| if random() > 0.3 { f64::NAN } else { 3.0 * random() });
        let sensor = Label::literal(3 + (k + number) % 2);
        let texts = [Label::literal(0), sensor, Label::literal(3 + number % 2)];
        test.push(&[time, values[0], 1.0 + random(), w, values[1]], &texts, Source::default());
        time += if number.is_multiple_of(3) { 0.5 } else { 0.6 + random() };
    }
    PhasedTest::from(test)
}

struct Case {
    model: PhasedModel,
    slots: Slots,
    law: InitialLaw,
}

impl Case {
    fn reduced(&self, tests: &[PhasedTest]) -> Reduction {
        reduced(&self.model, &self.slots, &VALUES, tests).1.get(0).into()
    }

    fn batches(&self, tests: &[PhasedTest]) -> PhasedBatches {
        let (reducer, _) = reduced(&self.model, &self.slots, &VALUES, tests);
        let batches = reducer.batches(tests, reducer.replicates(tests), (&Vec::from_iter(0..tests.len()), &[]));
        assert!(batches.has.contains(&true), "some tests are in batches");
        batches
    }

    /// For each test of one phase, whether it was processed in a lane of its batch.
    fn in_lanes(&self, values: &[f64], tests: &[PhasedTest], batches: &PhasedBatches) -> Vec<bool> {
        let (reducer, _) = reduced(&self.model, &self.slots, values, tests);
        let (_, filtered) = reducer.reduce_batches(tests, batches).expect("sound");
        let (numbers, batches) = filtered.phase(0);
        let mut went = vec![false; tests.len()];
        for batch in batches.collect::<Vec<_>>() {
            batch.tests().for_each(|(_, number)| went[numbers[number]] = true);
        }
        went
    }

    /// Reductions and scores, in batches where `batches` are given.
    fn at(&self, values: &[f64], tests: &[PhasedTest], batches: Option<&PhasedBatches>) -> (Reductions, Vec<Gradient>) {
        let (reducer, mut reductions): (PhasedReducer, _) = reduced(&self.model, &self.slots, values, tests);
        let mut filtered: Option<FilteredPhases> = None;
        if let Some(batches) = batches {
            let (own, after) = reducer.reduce_batches(tests, batches).expect("sound");
            (reductions, filtered) = (own, Some(after));
        }
        let scorer = PhasedScorer::new(&self.model, &reducer, &self.slots).expect("differentiable");
        let classes = Replicates::none(tests.len());
        let scores = scorer.scores(tests, &reductions, &self.law, (&classes, filtered.as_ref())).expect("sound");
        (reductions, scores)
    }
}

fn case(seed: u64) -> (Case, Vec<PhasedTest>) {
    let mut random = random(seed);
    (0..seed % 7).for_each(|_| _ = random());
    let (model, tests) = (drawn_model(&mut random), drawn_tests(&mut random));
    let slots = Slots::in_phases(&model, &Labels::new(&model.shared().literals), &tests);
    assert_eq!(slots.len(), VALUES.len(), "eight common values, and two parameters with two levels each");
    let p = model.dimension();
    let root = DMatrix::from_fn(p, p, |i, k| if i >= k { 0.7 + 0.1 * (i + 2 * k) as f64 } else { 0.0 });
    let law = InitialLaw::known(DVector::from_fn(p, |i, _| 0.4 - 0.3 * i as f64), root);
    (Case { model, slots, law }, tests)
}

fn dense(gradient: &Gradient) -> Vec<f64> {
    let mut all = vec![0.0; VALUES.len()];
    gradient.iter().for_each(|&(slot, x)| all[slot] += x);
    all
}

#[test]
fn tests_in_blocks_have_the_reductions_and_scores_that_they_have_by_themselves() {
    let moved = VALUES.map(|x| 1.1 * x + 0.01);
    let mut small_noise = VALUES; // noises so small that square-root arrays are needed
    small_noise[NOISE] = 1e-5;
    small_noise[NOISE + 1] = 2e-5;
    let mut square_root_tests = 0;
    for seed in 1..=60 {
        let (case, tests) = case(seed);
        let batches = case.batches(&tests);
        let silent = |&number: &usize| case.reduced(&tests[number..=number]).observations == 0;
        assert!(
            (0..tests.len()).all(|j| batches.has[j] || silent(&j)),
            "seed {seed}: {:?} are in batches",
            batches.has
        );
        for values in [&VALUES, &moved, &small_noise, &VALUES] {
            let (found, scores) = case.at(values, &tests, Some(&batches));
            let (expected, by_themselves) = case.at(values, &tests, None);
            let in_lanes = case.in_lanes(values, &tests, &batches);
            for j in 0..tests.len() {
                let (own, alone) = (found.get(j), expected.get(j));
                let what = format!("seed {seed}, {}", alone.test);
                // weak observability and small noises amplify the rounding of flows; where two measurements have
                // correlated noise and are whitened, the amplification is the square of the ratio of their noises
                let tolerance = if values == &small_noise { 1e-6 } else { 1e-10 };
                square_root_tests += usize::from(own.path == Path::SquareRoot);
                // a test that fails in its lane is computed in another way, which the numbers would not show
                let kept = values == &small_noise || in_lanes[j] || alone.path == Path::SquareRoot || !batches.has[j];
                assert!(kept, "{what} was left out of its lane");
                assert_eq!((own.test, own.steps, own.observations), (alone.test, alone.steps, alone.observations));
                assert_eq!(own.constant, alone.constant, "{what}, to the bit");
                assert_eq!((own.data, own.factor), (alone.data, alone.factor), "{what}, to the bit");
                near::slices(
                    format_args!("{what}, score"),
                    &dense(&scores[j]),
                    &dense(&by_themselves[j]),
                    10.0 * tolerance,
                );
            }
        }
    }
    assert!(square_root_tests > 100, "{square_root_tests} tests by square-root arrays");
}

/// Tests so long that the backward pass takes them in blocks: several in lanes, and one alone.
#[test]
fn long_tests_in_blocks_have_the_reductions_and_scores_that_they_have_by_themselves() {
    for seed in [1, 2, 3, 8, 13] {
        let (case, _) = case(seed);
        let mut random = random(seed + 100);
        let tests: Vec<PhasedTest> =
            [1, 2, 4, 5].map(|number| drawn_test(&mut random, number, 4000 + 100 * number)).into();
        for tests in [&tests[..], &tests[..1]] {
            let batches = case.batches(tests);
            let ((found, scores), (expected, by_themselves)) =
                (case.at(&VALUES, tests, Some(&batches)), case.at(&VALUES, tests, None));
            assert_eq!(case.in_lanes(&VALUES, tests, &batches), vec![true; tests.len()], "seed {seed}");
            for j in 0..tests.len() {
                let (own, alone) = (found.get(j), expected.get(j));
                assert_eq!((own.constant, own.data), (alone.constant, alone.data), "seed {seed}, test {j}, to the bit");
                near::slices(
                    format_args!("seed {seed}, test {j}"),
                    &dense(&scores[j]),
                    &dense(&by_themselves[j]),
                    1e-9,
                );
            }
        }
    }
}

/// The reference is differences of the log-density of both measurements, in 60 digits.
#[test]
fn the_score_of_small_correlated_noise_is_that_of_exact_arithmetic() {
    let mut small_noise = VALUES;
    (small_noise[NOISE], small_noise[NOISE + 1]) = (1e-5, 2e-5);
    let (case, tests) = case(6);
    let (_, scores) = case.at(&small_noise, &tests[..1], Some(&case.batches(&tests[..1])));
    let exact = [
        -0.00179490939443764,
        -0.0273711752517198,
        -0.0141555897515584,
        0.0,
        0.446771715615324,
        0.0,
        -0.0544455849646084,
        -0.308986077631296,
    ];
    near::slices("score", &dense(&scores[0])[..8], &exact, 1e-6);
}

#[test]
fn blocks_do_not_depend_on_the_order_of_tests() {
    let (case, tests) = case(3);
    let (reductions, scores) = case.at(&VALUES, &tests, Some(&case.batches(&tests)));
    let mut other: Vec<PhasedTest> = tests.clone();
    other.reverse();
    let (turned, turned_scores) = case.at(&VALUES, &other, Some(&case.batches(&other)));
    for j in 0..tests.len() {
        let k = tests.len() - 1 - j;
        assert_eq!(reductions.get(j), turned.get(k));
        assert_eq!(scores[j], turned_scores[k], "score of {}", tests[j].id);
    }
}

#[test]
fn phases_in_blocks_have_the_reductions_and_scores_that_they_have_by_themselves() {
    let moved = VALUES.map(|x| 1.1 * x + 0.01);
    let mut small_noise = VALUES; // noises so small that square-root arrays are needed
    small_noise[NOISE] = 1e-5;
    small_noise[NOISE + 1] = 2e-5;
    // tests of one, two and three phases
    let tests: Vec<PhasedTest> = (1..=9).rev().flat_map(journeys).collect();
    let model = journey();
    let slots = Slots::in_phases(&model, &Labels::new(&model.shared().literals), &tests);
    let mut square_root_tests = 0;
    let case = Case { model, slots, law: law() };
    let batches = case.batches(&tests);
    assert!(batches.has.iter().all(|&has| has), "all tests are in batches: {:?}", batches.has);
    for values in [&VALUES, &moved, &small_noise, &VALUES] {
        let (found, scores) = case.at(values, &tests, Some(&batches));
        let (expected, by_themselves) = case.at(values, &tests, None);
        let tolerance = if values == &small_noise { 1e-8 } else { 1e-11 };
        for j in 0..tests.len() {
            let (own, alone) = (found.get(j), expected.get(j));
            let what = format!("test {} of {} phases", alone.test, tests[j].phases.len());
            square_root_tests += usize::from(own.path == Path::SquareRoot);
            near::slices(format_args!("{what}, ℓ"), &[own.constant], &[alone.constant], tolerance);
            near::slices(format_args!("{what}, score"), &dense(&scores[j]), &dense(&by_themselves[j]), tolerance);
        }
    }
    assert!(square_root_tests > 5, "{square_root_tests} tests by square-root arrays");
}
