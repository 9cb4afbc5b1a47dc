//! The whole chain rule: the adjoints of a linear functional of all numbers of a prepared test are its weights, and its
//! derivatives to the free values of α must equal difference quotients through the preparation.

use super::*;
use crate::reduce::Workspace;
use crate::score::backward::{MeasurementAdjoint, TransitionAdjoint};
use kalfit_fixtures::by_hand;
use kalfit_fixtures::by_hand::{
    alpha, column, continuous, discrete, known, linear, minus, number, over, parameter, square, state, times,
};
use kalfit_fixtures::slope;
use kalfit_model::{Expression, Function, Initial, Measurement, Model, Motion, Operator, Parameter, State};
use kalfit_model::{Label, Labels, Source, Test};

/// Measurement of columns 1, 2, …, in order.
fn meter(index: usize, terms: Vec<(usize, Expression)>, constant: Expression, noise: Expression) -> Measurement {
    by_hand::meter(&format!("z{index}"), 1 + index, linear(terms, constant), noise)
}

fn parameters(count: usize, levelled: &[usize]) -> Vec<Parameter> {
    (0..count).map(|k| parameter(&format!("a{k}"), None, levelled.contains(&k).then_some(0), false)).collect()
}

/// Columns: t, z0, z1, z2, u, w; text column sensor.
fn model(states: Vec<State>, measurements: Vec<Measurement>, parameters: Vec<Parameter>) -> Model {
    let names: [&[&str]; 3] = [&["t", "z0", "z1", "z2", "u", "w"], &["sensor"], &["A", "B"]];
    by_hand::model(names, parameters, states, measurements)
}

const U: usize = 4;
const W: usize = 5;
const EMPTY: f64 = f64::NAN;

fn rows(rows: &[([f64; 6], usize)]) -> Test {
    let mut test = Test::new("t1", 6, 1);
    for (k, (numbers, label)) in rows.iter().enumerate() {
        test.push(numbers, &[Label::literal(*label)], Source { file: 0, row: k as u64 + 2 });
    }
    test
}

/// Steps of 0.5 three times, then others; a missing value, and two rows of one time.
fn test() -> Test {
    rows(&[
        ([0.0, 1.2, 0.5, -0.3, 0.4, 2.0], 0),
        ([0.5, 0.4, EMPTY, 0.2, -1.0, 2.0], 0),
        ([1.0, 0.1, 0.8, EMPTY, 0.9, 2.0], 1),
        ([1.5, -0.9, 0.1, 1.1, 0.7, 2.0], 1),
        ([1.5, EMPTY, 0.6, 0.9, 0.7, 2.0], 1),
        ([4.0, 0.3, -0.2, 0.5, 1.5, 2.0], 0),
        ([4.25, 0.6, 0.2, 0.4, 0.1, 2.0], 1),
    ])
}

/// A weight near 1, of either sign, that looks random.
fn weight(kind: usize, index: usize) -> f64 {
    (((kind * 7919 + index * 131 + 17) as f64 * 0.618_033_988_749_895).fract() - 0.5) * 3.0
}

fn weighted(kind: usize, from: usize, values: &[f64]) -> f64 {
    values.iter().enumerate().map(|(k, x)| weight(kind, from + k) * x).sum()
}

fn weights(kind: usize, from: usize, count: usize) -> Vec<f64> {
    (0..count).map(|k| weight(kind, from + k)).collect()
}

fn prepared(model: &Model, slots: &Slots, values: &[f64], test: &Test) -> Result<(Preparer, Workspace), Box<Fault>> {
    let free = (0..model.parameters.len()).map(|parameter| slots.is_free(parameter)).collect();
    let preparer = Preparer::with_free(model, &slots.alpha(model, values), free)?;
    let mut work = preparer.workspace();
    preparer.prepare(test, &mut work)?;
    Ok((preparer, work))
}

/// Σ weight × number, over every number of a prepared test.
fn functional(work: &Workspace) -> f64 {
    let (design, data) = (&work.design, &work.data);
    let (n, r) = (design.frame.n, design.frame.r);
    let mut sum = weighted(0, 0, &data.start) + weighted(1, 0, &data.inputs) + weighted(2, 0, &data.values);
    for i in 0..r {
        sum += (0..=i).map(|j| weight(4, i * r + j) * design.variance[i * r + j]).sum::<f64>();
    }
    for (k, step) in design.each_step().enumerate() {
        if let Some(transition) = step.transition {
            sum += weighted(5, k * 100, &transition.phi) + weighted(6, k * 100, &transition.q);
        }
        for (line, row) in step.lines.zip(step.rows) {
            let (states, h) = design.terms(line);
            sum += weight(3, row) * design.noise[line];
            sum += states.iter().zip(h).map(|(&state, h)| weight(7, row * n + state as usize) * h).sum::<f64>();
        }
    }
    sum
}

fn gradient(preparer: &Preparer, slots: &Slots, work: &Workspace, test: &Test) -> Gradient {
    let pullback = Pullback::new(preparer, slots).expect("differentiable");
    let mut adjoints = pullback.adjoints();
    // The second pass shows that nothing remains of the first.
    pass(&pullback, &mut adjoints, work, test);
    pass(&pullback, &mut adjoints, work, test)
}

fn pass(pullback: &Pullback<'_>, adjoints: &mut Adjoints<'_>, work: &Workspace, test: &Test) -> Gradient {
    let design = &work.design;
    let (n, r, driven) = (design.frame.n, design.frame.r, design.frame.driven.len());
    let when = |needed: bool, bars: Vec<f64>| if needed { bars } else { Vec::new() };
    let moves = |k: usize| design.each_step().take(k).filter(|step| step.transition.is_some()).count();
    for k in (0..design.steps()).rev() {
        let step = design.step(k);
        let (first, m) = (step.rows.start, step.rows.len());
        let (noise, value) = (weights(3, first, m), weights(2, first, m));
        let h = when(pullback.needs_equation(), weights(7, first * n, m * n));
        adjoints.step_measured(test, k, work, &MeasurementAdjoint { noise, value, h }).expect("finite");
        if let Some(transition) = step.transition {
            let phi = when(pullback.needs_motion(), weights(5, k * 100, transition.phi.len()));
            let q = when(pullback.needs_noise(), weights(6, k * 100, transition.q.len()));
            let input = when(pullback.needs_motion(), weights(1, moves(k) * driven, driven));
            adjoints.step_moved(test, k, work, &TransitionAdjoint { phi, q, input }).expect("finite");
        }
    }
    let mut variance = vec![0.0; r * r];
    for i in 0..r {
        for j in 0..=i {
            let half = if i == j { 1.0 } else { 0.5 };
            variance[i * r + j] = half * weight(4, i * r + j);
            variance[j * r + i] = half * weight(4, i * r + j);
        }
    }
    if pullback.needs_start() {
        adjoints.started(test, work, &weights(0, 0, n), &variance).expect("finite");
    }
    adjoints.finish(test, work).expect("finite")
}

/// The gradient of the functional from the response to each adjoint.
fn answered(preparer: &Preparer, slots: &Slots, work: &Workspace, test: &Test) -> Vec<f64> {
    let pullback = Pullback::new(preparer, slots).expect("differentiable");
    let response = pullback.adjoints().response((test, work), 0..work.design.steps()).expect("finite");
    let design = &work.design;
    let (n, r, driven) = (design.frame.n, design.frame.r, &design.frame.driven);
    let mut sums = vec![0.0; slots.len()];
    let mut add = |span, bar: f64| {
        response.factors(span).iter().for_each(|&(place, factor)| sums[response.slots[place as usize]] += factor * bar)
    };
    let mut moves = response.moves.iter().enumerate();
    for (k, step) in design.each_step().enumerate() {
        if let Some(transition) = step.transition {
            let (number, own) = moves.next().expect("one for each transition");
            let pattern = &transition.pattern;
            for entry in response.entries(&own.phi) {
                let row = pattern.moved[entry.i];
                let at = (row.start as usize..row.end as usize).find(|&at| pattern.columns[at] as usize == entry.j);
                add(entry.span, weight(5, k * 100 + at.expect("it is an entry of φ")));
            }
            for entry in response.entries(&own.q) {
                let at = pattern.pairs.iter().position(|&(i, j)| (i as usize, j as usize) == (entry.i, entry.j));
                add(entry.span, weight(6, k * 100 + at.expect("it is an entry of Q")));
            }
            for entry in response.entries(&own.input) {
                let at = driven.iter().position(|&state| state as usize == entry.i).expect("it is driven");
                add(entry.span, weight(1, number * driven.len() + at));
            }
        }
        for row in step.rows {
            let own = &response.rows[row];
            add(own.noise, weight(3, row));
            add(own.value, weight(2, row));
            response.entries(&own.h).iter().for_each(|entry| add(entry.span, weight(7, row * n + entry.i)));
        }
    }
    response.entries(&response.mean).iter().for_each(|entry| add(entry.span, weight(0, entry.i)));
    for entry in response.entries(&response.variance) {
        let half = if entry.i == entry.j { 1.0 } else { 0.5 };
        add(entry.span, half * weight(4, entry.i * r + entry.j));
    }
    sums
}

/// Compares every slot with the difference quotient, and, where values are not mixed, with the response to each
/// adjoint; `grows`: slots whose variance is zero, so that they can only grow.
#[track_caller]
fn check(model: &Model, values: &[f64], test: &Test, grows: &[usize]) {
    let labels = Labels::new(&model.literals);
    let slots = Slots::new(model, &labels, std::slice::from_ref(test));
    assert_eq!(slots.len(), values.len(), "free values");
    let (preparer, work) = prepared(model, &slots, values, test).unwrap_or_else(|fault| panic!("{fault:?}"));
    let found = gradient(&preparer, &slots, &work, test);
    assert!(found.windows(2).all(|two| two[0].0 < two[1].0), "{found:?}");
    assert!(found.iter().any(|(_, x)| *x != 0.0), "{found:?}");
    if preparer.meters.can_repeat() {
        for (slot, answer) in answered(&preparer, &slots, &work, test).into_iter().enumerate() {
            let found = found.iter().find(|(s, _)| *s == slot).map_or(0.0, |(_, x)| *x);
            let bound = 1e-12 * (1.0 + found.abs());
            assert!((found - answer).abs() <= bound, "slot {slot}: {found:.13e}, adjoint by adjoint {answer:.13e}");
        }
    }
    let ell = |slot: usize, x: f64| {
        let mut moved = values.to_vec();
        moved[slot] += x;
        functional(&prepared(model, &slots, &moved, test).unwrap_or_else(|fault| panic!("{fault:?}")).1)
    };
    for slot in 0..values.len() {
        let h = 1e-2 * values[slot].abs().max(0.2);
        let quotient = |h: f64| {
            if grows.contains(&slot) {
                (4.0 * ell(slot, h) - ell(slot, 2.0 * h) - 3.0 * ell(slot, 0.0)) / (2.0 * h)
            } else {
                (ell(slot, h) - ell(slot, -h)) / (2.0 * h)
            }
        };
        let d = [quotient(h), quotient(h / 2.0), quotient(h / 4.0), quotient(h / 8.0)];
        let first: Vec<f64> = d.windows(2).map(|d| (4.0 * d[1] - d[0]) / 3.0).collect();
        let second: Vec<f64> = first.windows(2).map(|d| (16.0 * d[1] - d[0]) / 15.0).collect();
        let expected = (64.0 * second[1] - second[0]) / 63.0;
        let found = found.iter().find(|(s, _)| *s == slot).map_or(0.0, |(_, x)| *x);
        let bound = 1e-9 * (1.0 + expected.abs());
        assert!((found - expected).abs() <= bound, "slot {slot}: {found:.13e} against {expected:.13e}");
    }
}

/// A second-order pair, a driven drift that a constant feeds, a stationary Gauss-Markov state with a mean.
fn gyro() -> Model {
    let pair = [
        continuous(vec![(1, number(1.0))], number(0.0), number(0.0)),
        continuous(
            vec![(0, minus(square(alpha(0)))), (1, times(number(-2.0), alpha(0))), (2, alpha(1))],
            times(alpha(2), column(U)),
            square(alpha(3)),
        ),
    ];
    let settled = continuous(
        vec![(3, over(number(-1.0), alpha(4)))],
        alpha(5),
        over(times(number(2.0), square(alpha(6))), alpha(4)),
    );
    let [position, rate] = pair;
    let mut states = vec![
        state("x", position, known(alpha(7), square(alpha(3)))),
        state("v", rate, Initial::Estimated),
        state("b", Motion::Constant, Initial::Estimated),
        state("g", settled, Initial::Stationary),
    ];
    states[1].offset = Some(times(alpha(7), column(W)));
    let terms = vec![(0, number(1.0)), (2, times(alpha(8), column(U))), (3, alpha(9))];
    model(states, vec![meter(0, terms, times(alpha(10), column(U)), square(alpha(11)))], parameters(12, &[]))
}

const GYRO: [f64; 12] = [0.8, 0.3, 1.2, 0.5, 2.5, 0.4, 0.7, -0.6, 0.9, 1.1, 0.2, 0.35];

#[test]
fn continuous_motion_inputs_starts_and_measurements() {
    check(&gyro(), &GYRO, &test(), &[]);
}

#[test]
fn inputs_of_the_row_before_are_taken_from_there() {
    let mut model = gyro();
    model.clock.previous_inputs = true;
    check(&model, &GYRO, &test(), &[]);
}

#[test]
fn known_inputs_and_free_motion() {
    let mut model = gyro();
    for (state, input) in [(1, column(U)), (3, number(0.4))] {
        let Motion::Continuous { derivative, .. } = &mut model.states[state].motion else { continue };
        derivative.constant = input;
    }
    check(&model, &GYRO, &test(), &[]);
}

#[test]
fn coefficients_that_are_zero_at_this_point_still_count() {
    let mut values = GYRO;
    (values[1], values[2], values[8], values[9], values[10]) = (0.0, 0.0, 0.0, 0.0, 0.0);
    check(&gyro(), &values, &test(), &[]);
}

#[test]
fn noise_levels_of_zero_still_count() {
    let walk = continuous(Vec::new(), number(0.0), alpha(0));
    let states = vec![
        state("w", walk, Initial::Estimated),
        state("k", Motion::Constant, known(number(0.0), alpha(1))),
        state("s", discrete(vec![(2, number(0.5))], alpha(3), alpha(2)), Initial::Estimated),
    ];
    let terms = vec![(0, number(1.0)), (1, number(1.0)), (2, number(-1.0))];
    let model = model(states, vec![meter(0, terms, number(0.0), alpha(4))], parameters(5, &[]));
    check(&model, &[0.0; 5], &test(), &[0, 1, 2, 4]);
}

#[test]
fn discrete_motion_with_columns_levels_and_a_stationary_law() {
    let first = discrete(vec![(0, alpha(0)), (1, alpha(1))], alpha(2), square(alpha(3)));
    let second = discrete(vec![(0, number(-0.2)), (1, times(alpha(0), number(0.5)))], number(0.3), number(0.4));
    let slope = Expression::Call(Function::Exp, vec![minus(over(Expression::Step, alpha(5)))]);
    let driven =
        discrete(vec![(2, slope), (0, times(alpha(4), column(U)))], times(alpha(4), column(U)), square(alpha(4)));
    let states = vec![
        state("p", first, Initial::Stationary),
        state("q", second, Initial::Stationary),
        state("r", driven, Initial::Estimated),
    ];
    let terms = vec![(0, number(1.0)), (2, alpha(4))];
    let mut model = model(
        states,
        vec![meter(0, terms, number(0.0), square(alpha(4))), meter(1, vec![(1, alpha(3))], alpha(6), number(0.5))],
        parameters(7, &[4]),
    );
    model.process_noise_covariance = vec![(0, 1, times(alpha(3), number(0.2)))];
    check(&model, &[0.6, 0.25, 0.8, 0.7, 0.9, 1.3, 1.8, 0.4], &test(), &[]);
}

#[test]
fn correlated_motion_noise_and_coupled_stationary_states() {
    let first = continuous(vec![(0, minus(alpha(0))), (1, alpha(1))], alpha(2), square(alpha(3)));
    let second = continuous(vec![(1, minus(alpha(4)))], number(0.2), number(0.6));
    let states = vec![
        state("p", first, Initial::Stationary),
        state("q", second, Initial::Stationary),
        state("e", continuous(vec![(2, times(alpha(1), column(U)))], number(0.0), alpha(3)), Initial::Estimated),
    ];
    let terms = vec![(0, number(1.0)), (1, number(1.0)), (2, number(1.0))];
    let mut model = model(states, vec![meter(0, terms, number(0.0), number(0.1))], parameters(6, &[]));
    model.process_noise_covariance = vec![(1, 0, alpha(5))];
    check(&model, &[0.7, 0.3, 0.5, 0.9, 1.4, 0.2], &test(), &[]);
    check(&model, &[0.7, 0.0, 0.5, 0.9, 1.4, 0.0], &test(), &[]);
}

/// Three correlated measurements, one with columns and levels; two rows of one time are one step.
fn correlated() -> Model {
    let states = vec![
        state("a", Motion::Constant, Initial::Estimated),
        state("b", Motion::Constant, Initial::Estimated),
        state("c", continuous(vec![(2, minus(alpha(0)))], number(0.0), number(1.0)), known(number(0.0), number(1.0))),
    ];
    let meters = vec![
        meter(0, vec![(0, number(1.0)), (2, alpha(1))], number(0.0), square(alpha(2))),
        meter(1, vec![(1, times(alpha(3), column(U)))], alpha(1), number(0.8)),
        meter(2, vec![(0, number(0.5)), (1, number(1.0))], number(0.2), square(alpha(5))),
    ];
    let mut model = model(states, meters, parameters(6, &[2]));
    model.noise_covariance = vec![(0, 1, times(alpha(4), alpha(2))), (2, 1, alpha(4)), (0, 2, number(0.05))];
    model
}

#[test]
fn correlated_measurement_noise() {
    check(&correlated(), &[0.4, 1.2, 0.9, 1.3, 0.7, 0.2, 1.1], &test(), &[]);
    check(&correlated(), &[0.4, 1.2, 0.9, 1.3, 0.7, 0.0, 1.1], &test(), &[]);
}

#[test]
fn fixed_correlated_noise_mixes_equations_that_are_free() {
    let mut model = correlated();
    model.noise_covariance = vec![(0, 1, number(0.3))];
    model.measurements[0].equation.terms.truncate(1);
    model.measurements[1].equation.terms[0].1 = number(1.5);
    check(&model, &[0.4, 1.2, 0.9, 1.3, 0.7, 0.2, 1.1], &test(), &[]); // values of α without effect have no derivative
}

#[test]
fn known_covariance_of_the_start() {
    let states = vec![
        state("a", Motion::Constant, Initial::Estimated),
        state("b", continuous(vec![(1, minus(alpha(0)))], number(0.0), number(0.0)), Initial::Estimated),
    ];
    let terms = vec![(0, number(1.0)), (1, number(1.0))];
    let mut model = model(states, vec![meter(0, terms, number(0.0), number(1.0))], parameters(3, &[]));
    let off = times(alpha(2), column(W));
    model.covariance.known = Some(vec![vec![square(alpha(1)), off.clone()], vec![off, number(2.0)]]);
    check(&model, &[0.5, 0.9, 0.1], &test(), &[]);
}

#[test]
fn levels_that_are_fixed_have_no_derivative() {
    let mut model = correlated();
    model.parameters[2].fixed_levels.insert(1, 1.3);
    check(&model, &[0.4, 1.2, 0.9, 0.7, 0.2, 1.1], &test(), &[]);
}

#[test]
fn many_distinct_steps_are_settled_in_portions() {
    let steps: Vec<([f64; 6], usize)> = (0..2500)
        .map(|k| {
            let t = f64::from(k) * 0.1 + 0.02 * f64::from(k).sin();
            ([t, t.cos(), EMPTY, EMPTY, (0.3 * t).sin(), 2.0], usize::from(k % 7 == 0))
        })
        .collect();
    let test = rows(&steps);
    let labels = Labels::default();
    let slots = Slots::new(&gyro(), &labels, std::slice::from_ref(&test));
    let (preparer, work) = prepared(&gyro(), &slots, &GYRO, &test).expect("sound");
    let found = gradient(&preparer, &slots, &work, &test);
    for slot in [0, 1, 4] {
        let at = |x: f64| {
            let mut values = GYRO;
            values[slot] += x;
            functional(&prepared(&gyro(), &slots, &values, &test).expect("sound").1)
        };
        let expected = slope(at, 5e-4);
        assert!((found[slot].1 - expected).abs() <= 1e-7 * (1.0 + expected.abs()), "{} {expected}", found[slot].1);
    }
}

#[test]
fn what_decides_rows_or_times_cannot_be_free() {
    let refusal = |model: &Model| {
        let labels = Labels::new(&model.literals);
        let slots = Slots::new(model, &labels, &[test()]);
        let free = vec![true; model.parameters.len()];
        let preparer = Preparer::with_free(model, &slots.alpha(model, &GYRO), free).expect("sound");
        let fault = Pullback::new(&preparer, &slots).expect_err("refused");
        fault.name(model, None).to_string()
    };
    let mut filtered = gyro();
    filtered.measurements[0].filter = Some(Expression::Binary(Operator::Less, Box::new(column(U)), Box::new(alpha(3))));
    insta::assert_snapshot!(refusal(&filtered), @"`where` of measurement `z0`: it depends on the free parameter `a3`, expected parameters that are fixed");
    let mut timed = gyro();
    timed.clock.initial_time = Some(minus(alpha(3)));
    insta::assert_snapshot!(refusal(&timed), @"initial time: it depends on the free parameter `a3`, expected parameters that are fixed");
}

#[test]
fn an_infinite_slope_is_refused() {
    let mut model = gyro();
    model.measurements[0].noise_variance = Expression::Call(Function::Sqrt, vec![alpha(11)]);
    let labels = Labels::new(&model.literals);
    let slots = Slots::new(&model, &labels, &[test()]);
    let mut values = GYRO;
    values[11] = 0.0;
    let (preparer, work) = prepared(&model, &slots, &values, &test()).expect("sound");
    let pullback = Pullback::new(&preparer, &slots).expect("differentiable elsewhere");
    let mut adjoints = pullback.adjoints();
    let ones = || vec![1.0; 4];
    let bar = MeasurementAdjoint { noise: ones(), value: ones(), h: ones() };
    adjoints.step_measured(&test(), 0, &work, &bar).expect("waits");
    let fault = adjoints.finish(&test(), &work).expect_err("infinite");
    assert_eq!((fault.subject, fault.kind), (Subject::Noise(0), ReduceErrorKind::NotFinite));
    assert_eq!(adjoints.finish(&test(), &work), Ok(Vec::new()));
}

#[test]
fn nothing_changes_without_free_parameters() {
    let model = gyro();
    let labels = Labels::new(&model.literals);
    let slots = Slots::new(&model, &labels, &[test()]);
    let alpha = slots.alpha(&model, &GYRO);
    let plain = Preparer::new(&model, &alpha).expect("sound");
    let mut work = plain.workspace();
    plain.prepare(&test(), &mut work).expect("sound");
    let (_, free) = prepared(&model, &slots, &GYRO, &test()).expect("sound");
    assert!(work.design.same(&free.design), "no coefficient is zero here, so both are the same bits");
}
