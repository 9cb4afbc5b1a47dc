//! Scores of tests in phases, compared with differences of the stacked ℓ.

use nalgebra::{DMatrix, DVector};

use super::design_classes::ScoredEnsemble;
use super::*;
use crate::score::by_differences::likelihood;
use crate::score::classes_of;
pub(super) use kalfit_fixtures::by_hand;
pub(super) use kalfit_fixtures::by_hand::{
    alpha, column, discrete, known, linear, meter, number, over, square, state, times,
};
use kalfit_fixtures::by_hand::{gauss_markov, parameter};
use kalfit_fixtures::slope;
use kalfit_model::Evidence;
use kalfit_model::{Carry, Expression, Initial, Linear, Model, Motion, Phase, State};
use kalfit_model::{Label, Labels, Source};

pub(super) const TAU: usize = 0;
pub(super) const DRIFT: usize = 1;
pub(super) const NOISE: usize = 2; // by sensor
pub(super) const KEEP: usize = 3;
pub(super) const STEP: usize = 4;
pub(super) const START: usize = 5;
pub(super) const OFFSET: usize = 6;
pub(super) const INPUT: usize = 7;
pub(super) const CARRY: usize = 8;
pub(super) const KICK: usize = 9; // by sensor, constant within the phases that are kicked
pub(super) const VALUES: [f64; 12] = [1.3, 0.6, 0.5, 0.9, 0.8, 0.4, 0.7, 0.3, 0.2, 1.1, 0.35, -0.6];

pub(super) const U: usize = 2;
pub(super) const W: usize = 3;

/// Columns t, z, u, w (constant within a test); text columns phase, sensor, room (constant within a phase).
pub(super) fn model(states: Vec<State>, equation: Linear) -> Model {
    let per = |k: usize| match k {
        NOISE => Some(1),
        KICK => Some(2),
        _ => None,
    };
    let parameters = (0..10).map(|k| parameter(&format!("a{k}"), None, per(k), false)).collect();
    let names: [&[&str]; 3] =
        [&["t", "z", "u", "w"], &["phase", "sensor", "room"], &["align", "coast", "land", "A", "B"]];
    by_hand::model(names, parameters, states, vec![meter("z", 1, equation, square(alpha(NOISE)))])
}

/// A Gauss-Markov state.
pub(super) fn drift(index: usize) -> Motion {
    gauss_markov(index, alpha(TAU), alpha(DRIFT))
}

fn phase(at: usize, model: Model, carry: Vec<Carry>) -> Phase {
    let name = model.literals[at].clone();
    Phase { name, label: Some(at), model, carry, filter: None }
}

/// Three phases, with states that start afresh, that inherit and that do both, a P0 per phase, and free values in all
/// of these.
pub(super) fn journey() -> PhasedModel {
    let walk = |terms: Vec<(usize, Expression)>| discrete(terms, times(alpha(INPUT), column(U)), square(alpha(STEP)));
    let align = model(
        vec![
            state("bias", Motion::Constant, Initial::Estimated),
            state("drift", drift(1), Initial::Stationary),
            state("walk", walk(vec![(0, number(0.2)), (2, alpha(KEEP))]), known(number(0.1), square(alpha(START)))),
            state("slope", Motion::Constant, Initial::Estimated),
        ],
        linear(
            vec![(0, number(1.0)), (1, number(0.8)), (2, number(1.0)), (3, column(U))],
            times(alpha(OFFSET), column(U)),
        ),
    );
    let coast = model(
        vec![
            state("tilt", walk(vec![(0, alpha(KEEP)), (1, number(0.3))]), known(alpha(OFFSET), square(alpha(START)))),
            state("velocity", Motion::Constant, Initial::Estimated),
            state("drift", drift(2), known(number(0.0), number(0.0))),
        ],
        linear(vec![(0, alpha(CARRY)), (1, column(U)), (2, number(1.0))], alpha(OFFSET)),
    );
    let land = model(
        vec![
            state("speed", Motion::Constant, Initial::Estimated),
            state("height", Motion::Constant, known(number(0.0), square(times(number(0.5), alpha(START))))),
            state("lag", walk(vec![(2, number(0.7))]), Initial::Estimated),
        ],
        linear(vec![(0, column(U)), (1, number(1.0)), (2, number(1.0))], number(0.0)),
    );
    let one = || number(1.0);
    let to_coast = vec![
        Carry { state: 0, from: linear(vec![(0, number(0.5)), (2, alpha(CARRY))], times(alpha(KICK), column(W))) },
        Carry { state: 2, from: linear(vec![(1, one())], number(0.0)) },
    ];
    let to_land = vec![
        Carry { state: 0, from: linear(vec![(1, over(one(), alpha(CARRY)))], number(0.0)) },
        Carry { state: 1, from: linear(vec![(0, alpha(KICK)), (2, times(alpha(CARRY), column(W)))], number(0.2)) },
    ];
    let phases = vec![phase(0, align, Vec::new()), phase(1, coast, to_coast), phase(2, land, to_land)];
    PhasedModel { phases, column: Some(0), levels: Vec::new() }
}

/// Rows of one phase.
fn rows(id: &str, at: usize, count: usize, random: &mut impl FnMut() -> f64) -> Test {
    let mut test = Test::new(id, 4, 3);
    let w = 1.0 + id.len() as f64 * 0.2;
    for k in 0..count {
        let z = if k % 5 == 3 { f64::NAN } else { 3.0 * random() };
        let sensor = Label::literal(3 + usize::from(random() > 0.0));
        let texts = [Label::literal(at), sensor, Label::literal(3 + (at + id.len()) % 2)];
        test.push(&[k as f64 * 0.5 + 0.2 * random(), z, 1.0 + random(), w], &texts, Source::default());
    }
    test
}

pub(super) fn random(mut seed: u64) -> impl FnMut() -> f64 {
    move || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 40) as f64 / f64::from(1 << 24) - 0.5
    }
}

pub(super) fn journeys(seed: u64) -> Vec<PhasedTest> {
    let mut random = random(seed);
    let test = |(id, phases): (&str, usize)| {
        let mut rows = |at: usize| {
            let mut rows = rows(id, at, 6 - at, &mut random);
            rows.id = format!("{id}{seed}").into();
            Evidence::Rows(rows)
        };
        PhasedTest { id: format!("{id}{seed}").into(), phases: (0..phases).map(&mut rows).collect() }
    };
    [("a", 3), ("bb", 2), ("ccc", 1), ("dddd", 3)].into_iter().map(test).collect()
}

/// A law whose Σ over all phases has a singular block in the second phase, and a zero in the third.
pub(super) fn law() -> InitialLaw {
    let mut root = DMatrix::zeros(5, 4);
    root.view_mut((0, 0), (2, 2)).copy_from(&DMatrix::from_row_slice(2, 2, &[0.8, 0.1, -0.3, 0.9]));
    root[(2, 2)] = 0.6;
    root[(4, 3)] = 0.7;
    InitialLaw::known(DVector::from_vec(vec![0.4, -0.3, 0.5, 0.9, -0.2]), root)
}

pub(super) fn reduced(
    model: &PhasedModel,
    slots: &Slots,
    values: &[f64],
    tests: &[PhasedTest],
) -> (PhasedReducer, Reductions) {
    let alpha = slots.alpha(model.shared(), values);
    let reducer = PhasedReducer::scoring(model, &alpha, slots).expect("sound");
    let reductions = reducer.reduce(tests).expect("sound");
    (reducer, reductions)
}

/// The model and the tests, cut down to the phases before `end`.
fn cut(mut model: PhasedModel, end: usize, tests: &[PhasedTest]) -> (PhasedModel, Vec<PhasedTest>) {
    model.phases.truncate(end);
    let tests = tests
        .iter()
        .map(|test| PhasedTest { id: test.id.clone(), phases: test.phases.iter().take(end).cloned().collect() });
    (model, tests.collect())
}

#[test]
fn scores_equal_differences_of_the_stacked_likelihood() {
    for (phases, seed) in [(2, 1), (3, 2), (3, 3)] {
        let (model, tests) = cut(journey(), phases, &journeys(seed));
        let slots = Slots::in_phases(&model, &Labels::new(&model.shared().literals), &tests);
        assert_eq!(slots.len(), VALUES.len(), "eight common values, and two parameters with two levels each");
        let all = law();
        let p = model.dimension();
        let law = InitialLaw::known(all.mean_of(&[]).rows(0, p).into_owned(), all.root.rows(0, p).into_owned());
        let (reducer, reductions) = reduced(&model, &slots, &VALUES, &tests);
        let scorer = PhasedScorer::new(&model, &reducer, &slots).expect("differentiable");
        let scores = scorer.scores(&tests, &reductions, &law, (&Replicates::none(tests.len()), None)).expect("sound");
        for (j, score) in scores.iter().enumerate() {
            let pieces = reducer.pieces_of(&tests[j], &mut reducer.workspace()).expect("sound");
            let laws = PhaseLaws::new(&law, &model.ranges(), &[]);
            let (chain, whole) =
                (SmootherPlan::new(&pieces, &laws).likelihood(&pieces, &laws), likelihood(reductions.get(j), &law));
            assert!((chain - whole).abs() < 1e-11, "ℓ of test {j}: chain {chain}, stacked {whole}");
            for slot in 0..VALUES.len() {
                let at = |x: f64| {
                    let mut moved = VALUES.to_vec();
                    moved[slot] += x;
                    likelihood(reduced(&model, &slots, &moved, &tests[j..=j]).1.get(0), &law)
                };
                let expected = slope(at, 1e-3);
                let found = score.iter().find(|(s, _)| *s == slot).map_or(0.0, |(_, bar)| *bar);
                assert!(
                    (found - expected).abs() < 1e-7 * (1.0 + expected.abs()),
                    "{phases} phases, test {j}, value {slot}: {found} against {expected}"
                );
            }
        }
    }
}

#[test]
fn the_expected_likelihood_of_phases_has_the_slope_of_the_likelihood() {
    let (model, tests) = (journey(), journeys(4));
    let slots = Slots::in_phases(&model, &Labels::new(&model.shared().literals), &tests);
    let law = law();
    let (reducer, reductions) = reduced(&model, &slots, &VALUES, &tests);
    let scorer = PhasedScorer::new(&model, &reducer, &slots).expect("differentiable");
    let scores = scorer.scores(&tests, &reductions, &law, (&Replicates::none(tests.len()), None)).expect("sound");
    let complete = scorer.all_complete(&tests, &reductions, &law).expect("sound");
    let expected = scorer.all_expected(&tests, &complete).expect("sound").expect("it came about");
    let carried: Vec<usize> = model.phases.iter().flat_map(|phase| crate::score::carried(phase, &slots)).collect();
    for (j, (score, (_, gradient))) in scores.iter().zip(&expected).enumerate() {
        for (slot, bar) in gradient.iter().filter(|(s, _)| !carried.contains(&slots.slots()[*s].parameter)) {
            let wanted = score.iter().find(|(s, _)| s == slot).map_or(0.0, |(_, bar)| *bar);
            assert!(
                (bar - wanted).abs() < 1e-8 * (1.0 + wanted.abs()),
                "test {j}, value {slot}: {bar} of Q, {wanted} of ℓ"
            );
        }
    }
}

#[test]
fn scores_have_the_same_bits_alone_and_together() {
    let (model, tests) = (journey(), journeys(5));
    let slots = Slots::in_phases(&model, &Labels::new(&model.shared().literals), &tests);
    let (reducer, reductions) = reduced(&model, &slots, &VALUES, &tests);
    let scorer = PhasedScorer::new(&model, &reducer, &slots).expect("differentiable");
    let together = scorer.scores(&tests, &reductions, &law(), (&Replicates::none(tests.len()), None)).expect("sound");
    for j in 0..tests.len() {
        let alone = scorer
            .scores(&tests[j..=j], &reductions.select(&[j]), &law(), (&Replicates::none(1), None))
            .expect("sound");
        assert_eq!(alone[0], together[j], "test {j}");
    }
}

/// `each` replicates of every test: all cells are equal except the measured values.
fn alike(tests: &[PhasedTest], each: usize, seed: u64) -> Vec<PhasedTest> {
    let mut random = random(seed);
    let mut all = Vec::new();
    for number in 0..each {
        for test in tests {
            let again = |evidence: &Evidence| {
                let Evidence::Rows(rows) = evidence else { return evidence.clone() };
                let mut own = Test::new(rows.id.clone(), 4, 3);
                for row in 0..rows.rows() {
                    let mut numbers = rows.numbers(row).to_vec();
                    numbers[1] += random();
                    own.push(&numbers, rows.texts(row), rows.source(row));
                }
                Evidence::Rows(own)
            };
            let id = format!("{}{number}", test.id);
            all.push(PhasedTest { id: id.into(), phases: test.phases.iter().map(again).collect() });
        }
    }
    all
}

#[test]
fn alike_tests_are_scored_as_one_by_one() {
    for phases in 1..=3 {
        let (model, few) = cut(journey(), phases, &journeys(7));
        let slots = Slots::in_phases(&model, &Labels::new(&model.shared().literals), &few);
        let values: Vec<f64> = VALUES.iter().take(slots.len()).copied().collect();
        let all = law();
        let p = model.dimension();
        let law = InitialLaw::known(all.mean_of(&[]).rows(0, p).into_owned(), all.root.rows(0, p).into_owned());
        let mut many = alike(&few, 37, 8);
        many.extend(journeys(9).into_iter().map(|mut test| {
            test.phases.truncate(phases);
            test
        }));
        let (reducer, reductions) = reduced(&model, &slots, &values, &many);
        let scorer = PhasedScorer::new(&model, &reducer, &slots).expect("differentiable");
        let classes = classes_of(&reducer, &many, &reducer.replicates(&many));
        let sizes: Vec<usize> = classes.sets.iter().map(Vec::len).collect();
        assert_eq!((sizes, classes.alone.len()), (vec![37; 4], 4));
        let plans = SharedStore::new(PLAN_BYTES);
        let ensemble =
            ScoredEnsemble { tests: &many, reductions: &reductions, law: &law, plans: &plans, filtered: None };
        for class in &classes.sets {
            let found = scorer.together(ensemble, class, &mut scorer.room()).expect("sound");
            assert!(found.is_some(), "they go together");
        }
        let together = scorer.scores(&many, &reductions, &law, (&classes, None)).expect("sound");
        let alone = scorer.scores(&many, &reductions, &law, (&Replicates::none(many.len()), None)).expect("sound");
        assert!(alone.iter().any(|score| score.len() > 7), "most values count");
        for (number, (found, expected)) in together.iter().zip(&alone).enumerate() {
            let of = |score: &Gradient, slot: usize| score.iter().find(|(s, _)| *s == slot).map(|(_, x)| *x);
            for slot in 0..slots.len() {
                let (found, expected) = (of(found, slot).unwrap_or(0.0), of(expected, slot).unwrap_or(0.0));
                let off = (found - expected).abs() / (1.0 + expected.abs());
                assert!(off < 1e-11, "{phases} phases, test {number}, value {slot}: {found}, alone {expected}");
            }
        }
    }
}
