//! Long uniform records: one reduction of a gyro at rest, with gains frozen where they have converged and without.

use std::hint::black_box;

use kalfit::model::{
    Alpha, Clock, Column, CovarianceStructure, Expression, Initial, Linear, MeanStructure, Measurement, Motion, State,
};
use kalfit::reduce::Reducer;
use kalfit::{Model, Source, Test};
use rand::RngExt;
use rand_distr::StandardNormal;

use super::time::best;
use crate::seed::random;

const ROWS: u32 = 1_000_000;
const STEP: f64 = 0.01;

/// Prints a line for each record.
pub(super) fn run() {
    println!("\nlong uniform records              n   rows   Mrows/s   ns/row   frozen off, ns/row   ratio");
    for (name, model) in [("bias, random walk, drift", model(true)), ("bias, random walk", model(false))] {
        let test = record();
        let (frozen, off) = (time(&model, &test, false, 5), time(&model, &test, true, 2));
        let states = model.states.len();
        println!("{name:30} {states:4} {ROWS:6} {:9.1} {frozen:8.1} {off:20.1} {:7.1}", 1e3 / frozen, off / frozen);
    }
}

/// Nanoseconds a row of one reduction.
fn time(model: &Model, test: &Test, off: bool, runs: usize) -> f64 {
    let tests = std::slice::from_ref(test);
    let seconds = best(runs, || {
        let reducer = Reducer::new(model, &Alpha::default()).expect("the benchmark's model is sound");
        let reducer = if off { reducer.unfrozen() } else { reducer };
        black_box(reducer.reduce(tests).expect("the benchmark's data are sound"));
    });
    seconds * 1e9 / f64::from(ROWS)
}

/// White noise at times as a file has them; the filter's work does not depend on the values.
fn record() -> Test {
    let mut rng = random();
    let mut test = Test::new("long", 2, 0);
    for k in 0..ROWS {
        let time: f64 = format!("{:.2}", f64::from(k) * STEP).parse().expect("a number");
        test.push(&[time, rng.sample(StandardNormal)], &[], Source { file: 0, row: u64::from(k) });
    }
    test
}

/// Turn-on bias, random walk and, perhaps, a Gauss-Markov drift of 100 time units.
fn model(drifts: bool) -> Model {
    let number = Expression::Number;
    let linear = |terms: &[(usize, f64)]| Linear {
        terms: terms.iter().map(|&(state, x)| (state, number(x))).collect(),
        constant: number(0.0),
    };
    let state = |name: &str, motion: Motion, initial: Initial| State {
        name: name.to_owned(),
        unit: None,
        motion,
        initial,
        offset: None,
        random: true,
    };
    let continuous = |terms: &[(usize, f64)], noise: f64| Motion::Continuous {
        derivative: linear(terms),
        noise_variance: number(noise),
    };
    let known = Initial::Known { mean: number(0.0), variance: number(0.0) };
    let mut states =
        vec![state("bias", Motion::Constant, Initial::Estimated), state("walk", continuous(&[], 1e-4), known)];
    if drifts {
        states.push(state("drift", continuous(&[(2, -0.01)], 2e-2), Initial::Stationary));
    }
    let column = |name: &str| Column { name: name.to_owned(), used_in: "the benchmark".to_owned() };
    let terms: Vec<(usize, f64)> = (0..states.len()).map(|i| (i, 1.0)).collect();
    Model {
        title: String::new(),
        columns: vec![column("t"), column("z")],
        text_columns: Vec::new(),
        literals: Vec::new(),
        parameters: Vec::new(),
        states,
        process_noise_covariance: Vec::new(),
        measurements: vec![Measurement {
            name: "z".to_owned(),
            column: 1,
            filter: None,
            equation: linear(&terms),
            noise_variance: number(1.0),
        }],
        noise_covariance: Vec::new(),
        clock: Clock { time: Some(0), ..Clock::default() },
        group: None,
        estimated: vec![0],
        mean: MeanStructure::free(1),
        covariance: CovarianceStructure::full(),
    }
}
