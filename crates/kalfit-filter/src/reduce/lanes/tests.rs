use kalfit_lanes::Isa;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::reduce::batches::batch_workspace::BatchWorkspace;
use crate::reduce::data::Data;
use crate::reduce::design::Design;
use crate::reduce::prepare::Skeleton;
use crate::reduce::reduced_tests::ReducedTests;
use crate::reduce::reducer::Reducer;
use crate::reduce::{Reductions, Work};
use kalfit_model::Reduction;
use kalfit_model::{
    Alpha, Clock, Column, CovarianceStructure, Expression, Initial, Linear, MeanStructure, Measurement, Model, Motion,
    State,
};
use kalfit_model::{Source, Test};

/// Number of columns: z, w, an input of z, an input of the drift, the variance of z.
const COLUMNS: usize = 5;

/// Model of a bias, a scale factor and a driven drift, which both measurements contain.
fn model() -> Model {
    let (number, column) = (Expression::Number, Expression::Column);
    let linear = |terms: Vec<(usize, Expression)>, constant| Linear { terms, constant };
    let state = |name: &str, motion: Motion, initial: Initial| State {
        name: name.to_owned(),
        unit: None,
        motion,
        initial,
        offset: None,
        random: true,
    };
    let drift = Motion::Discrete {
        next: linear(vec![(2, number(0.9)), (0, number(0.05))], column(3)),
        noise_variance: number(0.2),
    };
    let meter = |name: &str, column: usize, equation: Linear, noise_variance| Measurement {
        name: name.to_owned(),
        column,
        filter: None,
        equation,
        noise_variance,
    };
    let z = linear(vec![(0, number(1.0)), (1, column(2)), (2, number(1.0))], number(0.3));
    let w = linear(vec![(1, number(0.5)), (2, number(2.0))], number(0.0));
    Model {
        title: String::new(),
        columns: (0..COLUMNS).map(|k| Column { name: format!("c{k}"), used_in: "the tests".to_owned() }).collect(),
        text_columns: Vec::new(),
        literals: Vec::new(),
        parameters: Vec::new(),
        states: vec![
            state("bias", Motion::Constant, Initial::Estimated),
            state("scale", Motion::Constant, Initial::Estimated),
            state("drift", drift, Initial::Known { mean: number(0.1), variance: number(1.0) }),
        ],
        process_noise_covariance: Vec::new(),
        measurements: vec![meter("z", 0, z, column(4)), meter("w", 1, w, number(0.5))],
        noise_covariance: Vec::new(),
        clock: Clock::default(),
        group: None,
        estimated: vec![0, 1],
        mean: MeanStructure::free(2),
        covariance: CovarianceStructure::full(),
    }
}

/// Tests of several lengths, with missing values; those with the same number in `designs` have the same inputs.
fn tests(designs: &[u64], size: f64) -> Vec<Test> {
    let mut values = ChaCha8Rng::seed_from_u64(1);
    let mut tests = Vec::new();
    for (number, &seed) in designs.iter().enumerate() {
        let mut inputs = ChaCha8Rng::seed_from_u64(100 + seed);
        let mut test = Test::new(format!("{number}"), COLUMNS, 0);
        for row in 0..6 + 3 * (seed % 4) {
            let z: f64 = values.sample(StandardNormal);
            let w: f64 = values.sample(StandardNormal);
            let lost = seed % 3 == 1 && row % 4 == 2;
            let cells = [
                if lost { f64::NAN } else { size * z },
                if row % 2 == 1 { f64::NAN } else { size * w },
                inputs.sample(StandardNormal),
                inputs.sample(StandardNormal),
                inputs.random_range(0.1..2.0),
            ];
            test.push(&cells, &[], Source::default());
        }
        tests.push(test);
    }
    tests
}

fn reducer() -> Reducer {
    Reducer::new(&model(), &Alpha::default()).expect("sound")
}

/// log p(z | ξ) by a filter with full matrices and known ξ.
fn likelihood(design: &Design, data: &Data, xi: &[f64]) -> f64 {
    let (frame, n) = (&*design.frame, design.frame.n);
    let mut x = DVector::from_column_slice(&data.start)
        + DMatrix::from_row_slice(n, frame.p, &frame.sensitivity) * DVector::from_column_slice(xi);
    let mut covariance = DMatrix::from_fn(n, n, |i, k| {
        let (i, k) = (i.max(k), i.min(k));
        if i < frame.r { design.variance[i * frame.r + k] } else { 0.0 }
    });
    let (mut sum, mut inputs) = (0.0, data.inputs.iter());
    for step in design.each_step() {
        if let Some(transition) = step.transition {
            let mut phi = DMatrix::identity(n, n);
            transition.pattern.moved.iter().for_each(|row| phi[(row.state as usize, row.state as usize)] = 0.0);
            transition.entries().for_each(|(i, k, entry)| phi[(i, k)] = entry);
            x = &phi * x;
            frame.driven.iter().zip(&mut inputs).for_each(|(&state, b)| x[state as usize] += b);
            covariance = &phi * covariance * phi.transpose();
            for (&(i, k), q) in transition.pattern.pairs.iter().zip(&transition.q) {
                covariance[(i as usize, k as usize)] += q;
                if i != k {
                    covariance[(k as usize, i as usize)] += q;
                }
            }
        }
        for (line, row) in step.lines.zip(step.rows) {
            let (states, terms) = design.terms(line);
            let mut h = DVector::zeros(n);
            states.iter().zip(terms).for_each(|(&state, term)| h[state as usize] = *term);
            let (innovation, carried) = (data.values[row] - h.dot(&x), &covariance * &h);
            let variance = h.dot(&carried) + design.noise[line];
            sum -= 0.5 * ((std::f64::consts::TAU * variance).ln() + innovation * innovation / variance);
            x += &carried * (innovation / variance);
            covariance -= &carried * carried.transpose() / variance;
        }
    }
    sum
}

/// Reductions of tests that are filtered in lanes.
fn side_by_side(isa: Isa, reducer: &Reducer, tests: &[Test]) -> ReducedTests {
    let (mut work, mut found) = (reducer.workspace(), ReducedTests::default());
    let mut all: Vec<Skeleton> = tests.iter().map(|_| Skeleton::default()).collect();
    for (number, (test, own)) in tests.iter().zip(&mut all).enumerate() {
        assert!(reducer.preparer().skeleton(test, number, &mut work, own), "{} goes beside others", test.id);
    }
    let tests: Vec<&Test> = tests.iter().collect();
    BatchWorkspace::new(isa, reducer).reduce(reducer, (&tests, &mut all), &mut work.scratch, &mut found);
    assert!(found.exceptional.is_empty(), "all are well conditioned");
    found
}

#[test]
fn lanes_say_what_a_filter_that_knows_xi_says() {
    let reducer = reducer();
    for (isa, size) in Isa::all().iter().flat_map(|&isa| [(isa, 1.0), (isa, 1e3)]) {
        // tests of different lengths, some without every fourth value of z
        let all = tests(&(0..13).collect::<Vec<u64>>(), size);
        let found = side_by_side(isa, &reducer, &all);
        for (row, &number) in found.reductions.iter().zip(&found.numbers) {
            let mut work = reducer.workspace();
            reducer.preparer().prepare(&all[number], &mut work).expect("sound");
            for xi in [[0.0, 0.0], [1.5 * size, -0.5 * size], [-0.3, 2.0 * size]] {
                let left = row.data[0] - row.factor[0] * xi[0] - row.factor[1] * xi[1];
                let found = row.constant - 0.5 * (left * left + (row.data[1] - row.factor[2] * xi[1]).powi(2));
                let expected = likelihood(&work.design, &work.data, &xi);
                let off = (found - expected).abs() / expected.abs().max(1.0);
                assert!(off <= 1e-12, "{isa:?}, size {size}, test {number}, ξ = {xi:?}: {found} against {expected}");
            }
        }
    }
}

#[test]
fn a_test_in_a_lane_has_the_bits_it_has_by_itself() {
    let reducer = reducer();
    let all = tests(&(0..40).collect::<Vec<u64>>(), 30.0);
    let found = side_by_side(Isa::best(), &reducer, &all);
    assert_eq!(found.numbers.len(), all.len());
    for (row, &number) in found.reductions.iter().zip(&found.numbers) {
        let (alone, _) = reducer.reduce_one(&all[number], &mut reducer.workspace()).expect("sound");
        assert_eq!(Reduction::from(row), alone, "test {number}, its digest too");
    }
}

/// Tests with separate designs and with shared designs, in turn.
fn mixed() -> Vec<Test> {
    let designs: Vec<u64> = (0..120).map(|k| if k % 3 == 0 { 1000 + k } else { k * 7919 % 11 }).collect();
    tests(&designs, 5.0)
}

fn each_by_itself(tests: &[Test]) -> Reductions {
    let mut all = Reductions::new();
    for test in tests {
        all.append(reducer().reduce(std::slice::from_ref(test)).expect("sound"));
    }
    all
}

#[test]
fn company_order_threads_and_what_is_known_change_no_bit() {
    let all = mixed();
    let alone = each_by_itself(&all);
    let one = reducer();
    assert_eq!(one.reduce(&all).expect("sound"), alone);
    assert_eq!(one.reduce(&all).expect("sound"), alone, "all known by now");
    let backwards: Vec<Test> = all.iter().rev().cloned().collect();
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let found = pool.install(|| reducer().reduce(&backwards)).expect("sound");
        assert!(found.iter().rev().eq(&alone), "{threads} threads");
    }
}

#[test]
fn tests_that_look_alike_are_not_evaluated_again() {
    let all = tests(&[4; 100], 1.0);
    let reducer = reducer();
    let found = reducer.reduce(&all).expect("sound");
    assert_eq!(reducer.work(), Work { design_runs: 1, root_runs: 0, data_runs: 100, transitions: 0 });
    assert_eq!(found, each_by_itself(&all));
    let mut other = all[99].clone();
    other.set_number(3, 2, other.numbers(3)[2] + 1e-9);
    let mut missing = all[98].clone();
    missing.set_number(0, 0, f64::NAN);
    let mut there = all[97].clone();
    there.set_number(2, 0, 0.5); // was missing
    let exceptional = [other, missing, there];
    assert_eq!(reducer.reduce(&exceptional).expect("sound"), each_by_itself(&exceptional));
    assert_eq!(reducer.work().design_runs, 4, "each is a design of its own");
}

#[test]
fn a_test_in_error_says_so_in_company_as_by_itself() {
    let mut all = tests(&[4; 40], 1.0);
    all[30].set_number(4, 0, f64::INFINITY);
    all[35].set_number(0, 0, f64::INFINITY);
    let by_itself = reducer().reduce(&all[30..31]).expect_err("not finite");
    let together = reducer().reduce(&all).expect_err("not finite");
    assert_eq!(format!("{together:?}"), format!("{by_itself:?}"));
    all[30].set_number(4, 0, 1e300);
    let overflow = reducer().reduce(&all[30..31]).expect_err("too large");
    assert_eq!(format!("{:?}", reducer().reduce(&all).expect_err("too large")), format!("{overflow:?}"));
}
