//! What a fit of many states takes of memory.
//!
//! A test binary of its own, since it looks at the most that its process ever had.
#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

use kalfit::estimate::{self, Settings, Silent, Stop, Structure};
use kalfit::infer::{self, Choices};
use kalfit::model::{Alpha, CovarianceStructure, MeanStructure};
use kalfit::reduce::{Path, Reduction, Reductions};

/// So many that the system gets a matrix over the elements of Σ back as soon as it goes: 35 MB are too many to be kept for later.
const STATES: usize = 64;

/// What else a fit may take.
const BESIDE: u64 = 16 << 20;

/// The most memory that the process has had, in bytes.
fn most() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    line.trim().strip_suffix(" kB").unwrap().parse::<u64>().unwrap() << 10
}

/// Numbers of variance one, as good as independent.
fn number(k: usize) -> f64 {
    let turns = (k as f64 * 12.9898).sin() * 43758.5453;
    (turns - turns.floor() - 0.5) * 12.0_f64.sqrt()
}

/// Tests with a few designs, each of which informs every state.
fn tests(count: usize) -> Reductions {
    let test = |j: usize| {
        let xi: Vec<f64> = (0..STATES).map(|i| number(STATES * j + i) + 0.5 * number(STATES * j + i + 1)).collect();
        let design = j % 3;
        let r = |i: usize, k: usize| if i == k { 2.0 } else { 0.2 * ((design + 3 * i + 5 * k) as f64).sin() };
        let data = |i: usize| (i..STATES).map(|k| r(i, k) * xi[k]).sum::<f64>() + number(1_000_000 + STATES * j + i);
        Reduction {
            test: format!("t{j:04}"),
            constant: 0.0,
            residual: None,
            data: (0..STATES).map(data).collect(),
            factor: (0..STATES).flat_map(|k| (0..=k).map(move |i| r(i, k))).collect(),
            covariates: Vec::new(),
            steps: STATES,
            observations: STATES,
            path: Path::Information,
            design: design as u128,
            chain: None,
            exact: None,
        }
    };
    (0..count).map(test).collect()
}

#[test]
fn a_fit_of_many_states_takes_no_more_memory_than_is_said_before_it_begins() {
    let data = tests(12 * STATES);
    let (mean, covariance, alpha) = (MeanStructure::free(STATES), CovarianceStructure::full(), Alpha::default());
    let before = most();
    let structure = Structure::single(&mean, &covariance, &alpha);
    let estimate = estimate::fit(&data, &structure, &Settings::default(), &mut Silent).unwrap();
    let fitted = most() - before;
    let inference = infer::infer(&estimate, &data, Choices::default());
    let (taken, said) = (most() - before, estimate::memory(&[STATES]));
    let passes = estimate.passes;
    println!(
        "{} MB for the fit ({passes} passes), {} MB with inference; said {} MB",
        fitted >> 20,
        taken >> 20,
        said >> 20
    );
    assert_eq!(estimate.stop, Stop::Certified);
    assert!(inference.uncertainty.errors.std_dev[0].is_some());
    assert!(taken < said + BESIDE, "{} MB, where {} MB are said", taken >> 20, said >> 20);
    assert!(taken > said / 10 * 8, "{} MB: less can be said than {} MB", taken >> 20, said >> 20);
}
