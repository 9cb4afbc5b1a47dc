//! Benchmarks of the core: the reduction, the EM pass and the Newton pass, in tests a second and as a part of the peak.
//!
//! Times inform; nothing is gated on them.

mod long;
mod time;

use std::hint::black_box;
use std::process::{Command, ExitCode};

use kalfit::estimate::{Derivatives, Likelihood, pass_flops};
use kalfit::model::{
    Alpha, Clock, Column, CovarianceStructure, Expression, Initial, Linear, MeanStructure, Measurement, Motion, State,
};
use kalfit::reduce::{Path, Reducer, Reduction, Reductions, reduction_flops};
use kalfit::{Model, Source, Test};
use nalgebra::DMatrix;
use rand::RngExt;
use rand_distr::StandardNormal;

use self::time::best;
use crate::seed::random;
use crate::{peak, places};

/// Builds this program for the machine's own instructions, in a folder of its own, and runs it.
pub(crate) fn build_and_run() -> ExitCode {
    let target = match places::target() {
        Ok(target) => target.join("native"),
        Err(why) => {
            eprintln!("{why}");
            return ExitCode::FAILURE;
        }
    };
    let status = Command::new("cargo")
        .args(["run", "--quiet", "--release", "--package", "kalfit-dev", "--features", "measure"])
        .args(["--", "bench", "--here"])
        .env("CARGO_TARGET_DIR", target)
        .env("RUSTFLAGS", "-C target-cpu=native")
        .status();
    match status {
        Ok(status) if status.success() => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    }
}

/// Runs and prints everything.
pub(crate) fn run() -> ExitCode {
    // one core against the peak of one core
    if let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(1).build_global() {
        eprintln!("cannot limit the threads: {error}");
        return ExitCode::FAILURE;
    }
    let peak = peak::flops_per_second();
    println!("peak of one core, multiply-adds in registers ({}): {:.1} Gflop/s\n", peak::registers(), peak / 1e9);
    println!("solver passes                     p   tests/s   flops/test   Gflop/s   of peak");
    for p in [1, 2, 3, 6, 10, 20] {
        pass(p, Derivatives::First, "EM pass, own designs", peak);
        pass(p, Derivatives::Second, "Newton pass, own designs", peak);
    }
    println!("\nreduction                         n   rows   tests/s   ns/row   flops/row   of peak   design runs");
    for states in [2, 5, 8, 15] {
        reduction(states, false, peak);
        reduction(states, true, peak);
    }
    long::run();
    ExitCode::SUCCESS
}

fn pass(p: usize, derivatives: Derivatives, name: &str, peak: f64) {
    // so many that what a pass does beside them does not count, however short it is
    let tests = (4_000_000 / (p * p * p)).clamp(500, 500_000);
    let likelihood = Likelihood::new(&random_reductions(p, tests), p);
    let sigma = DMatrix::identity(p, p);
    let mean = vec![0.0; p];
    let seconds = best(9, || {
        black_box(likelihood.at(&mean, &sigma, derivatives));
    });
    let flops = pass_flops(p, derivatives);
    let rate = tests as f64 * flops as f64 / seconds;
    println!(
        "{name:30} {p:4} {:9.0} {flops:12} {:9.2} {:8.1}%",
        tests as f64 / seconds,
        rate / 1e9,
        100.0 * rate / peak
    );
}

fn random_reductions(p: usize, tests: usize) -> Reductions {
    let mut rng = random();
    let mut normal = move || -> f64 { rng.sample(StandardNormal) };
    let reduction = |j: usize| Reduction {
        test: format!("{j:08}"),
        constant: 0.0,
        residual: None,
        data: (0..p).map(|_| normal()).collect(),
        factor: (0..p)
            .flat_map(|k| (0..=k).map(move |i| (i, k)))
            .map(|(i, k)| if i == k { 1.0 + normal().abs() } else { normal() })
            .collect(),
        covariates: Vec::new(),
        steps: 1,
        observations: p,
        path: Path::Information,
        design: j as u128,
        chain: None,
        exact: None,
    };
    (0..tests).map(reduction).collect()
}

/// A drift of one Gauss-Markov state and n - 1 random constants seen through known inputs.
pub(crate) fn bench_model(states: usize) -> Model {
    let number = Expression::Number;
    let zero = || Linear { terms: Vec::new(), constant: number(0.0) };
    let constant = |i: usize| State {
        name: format!("x{i}"),
        unit: None,
        motion: Motion::Constant,
        initial: Initial::Estimated,
        offset: None,
        random: true,
    };
    let drift = State {
        name: "drift".to_owned(),
        motion: Motion::Discrete {
            next: Linear { terms: vec![(states - 1, number(0.9))], ..zero() },
            noise_variance: number(0.19),
        },
        initial: Initial::Stationary,
        ..constant(states - 1)
    };
    let column = |name: String| Column { name, used_in: "the benchmark".to_owned() };
    let inputs = (0..states - 1).map(|i| (i, Expression::Column(i + 1)));
    let terms = inputs.chain([(states - 1, number(1.0))]).collect();
    let p = states - 1;
    Model {
        title: String::new(),
        columns: (0..states).map(|i| column(format!("c{i}"))).collect(),
        text_columns: Vec::new(),
        literals: Vec::new(),
        parameters: Vec::new(),
        states: (0..p).map(constant).chain([drift]).collect(),
        process_noise_covariance: Vec::new(),
        measurements: vec![Measurement {
            name: "z".to_owned(),
            column: 0,
            filter: None,
            equation: Linear { terms, constant: number(0.0) },
            noise_variance: number(0.01),
        }],
        noise_covariance: Vec::new(),
        clock: Clock::default(),
        group: None,
        estimated: (0..p).collect(),
        mean: MeanStructure::free(p),
        covariance: CovarianceStructure::full(),
    }
}

fn reduction(states: usize, shared: bool, peak: f64) {
    let rows = 3 * states;
    let tests: Vec<Test> = random_tests(states, rows, 4000, shared);
    let model = bench_model(states);
    let mut design_runs = 0;
    let seconds = best(5, || {
        let reducer = Reducer::new(&model, &Alpha::default()).expect("the benchmark's model is sound");
        black_box(reducer.reduce(&tests).expect("the benchmark's data are sound"));
        design_runs = reducer.work().design_runs;
    });
    let name = if shared { "one design for all" } else { "own designs" };
    let (design, data) = reduction_flops(states, 1, states - 1, rows);
    let flops = (data + if shared { 0 } else { design }) as f64 / rows as f64;
    let per_row = seconds / (tests.len() * rows) as f64;
    println!(
        "{name:30} {states:4} {rows:6} {:9.0} {:8.1} {flops:11.0} {:8.1}% {design_runs:13}",
        tests.len() as f64 / seconds,
        per_row * 1e9,
        100.0 * flops / per_row / peak
    );
}

fn random_tests(states: usize, rows: usize, count: usize, shared: bool) -> Vec<Test> {
    let mut rng = random();
    let design: Vec<f64> = (0..rows * states).map(|_| rng.sample(StandardNormal)).collect();
    (0..count)
        .map(|j| {
            let mut test = Test::new(format!("{j:08}"), states, 0);
            for k in 0..rows {
                let mut cells: Vec<f64> = design[k * states..][..states].to_vec();
                if !shared {
                    cells.iter_mut().for_each(|cell| *cell = rng.sample(StandardNormal));
                }
                cells[0] = rng.sample(StandardNormal);
                test.push(&cells, &[], Source::default());
            }
            test
        })
        .collect()
}
