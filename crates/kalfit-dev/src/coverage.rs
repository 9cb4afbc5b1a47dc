//! Coverage of 95 % intervals: simulated ensembles of some set-ups, drawn, reduced, fitted and inferred as a user's
//! data are.
//!
//! Intervals of means and regression coefficients are taken on their own scale, those of standard deviations on that of their
//! logarithm, those of correlations on that of atanh.

mod crossed;
mod drawn;
mod few_tests;
mod levels;
mod predictions;
mod tally;
mod verdicts;

use std::process::ExitCode;

use kalfit::estimate::{self, Settings, Silent, Stop, Structure};
use kalfit::infer::{Choices, DeletionChoice, Interval};
use kalfit::reduce::Reducer;
use kalfit::simulate::{Designs, Simulator};
use kalfit::{Alpha, Label, Model, Population, Source, Test, infer};
use kalfit_spec::Spec;
use nalgebra::DMatrix;
use rayon::prelude::*;

use self::tally::IntervalTally;
use crate::seed::SEED;

/// Coverage of an interval that is what it says, within sampling error and terms of order 1/N.
const SOUND: std::ops::RangeInclusive<f64> = 0.935..=0.965;

/// A model, a design and a population.
struct CoverageSetup {
    title: &'static str,
    model: &'static str,
    /// Cells of a row of a test, by column; `None` ends the test.
    cell: fn(test: usize, row: usize, column: &str) -> Option<f64>,
    tests: usize,
    mean: &'static [f64],
    coefficients: &'static [f64],
    /// Standard deviations.
    std_dev: &'static [f64],
    /// Correlation of each two states.
    correlation: f64,
    /// There are so many tests that the coverage must be sound; else it is only shown.
    large: bool,
}

const RANDOM_COEFFICIENTS: &str = r#"
[states]
level = {}
slope = {}
[measurements.y]
column = "y"
equation = "level + slope * x"
noise = 20
"#;

const SETUPS: [CoverageSetup; 4] = [
    CoverageSetup {
        title: "Random coefficients: 18 tests of 10 rows (too few for normal intervals of spreads; shown, not required)",
        model: RANDOM_COEFFICIENTS,
        cell: |_, row, column| match column {
            "x" => (row < 10).then_some(row as f64),
            _ => Some(0.0),
        },
        tests: 18,
        mean: &[250.0, 10.0],
        coefficients: &[],
        std_dev: &[24.0, 6.0],
        correlation: 0.3,
        large: false,
    },
    CoverageSetup {
        title: "Random coefficients: 100 tests of 6 to 10 rows",
        model: RANDOM_COEFFICIENTS,
        cell: |test, row, column| match column {
            "x" => (row < 6 + test % 5).then_some(row as f64),
            _ => Some(0.0),
        },
        tests: 100,
        mean: &[250.0, 10.0],
        coefficients: &[],
        std_dev: &[24.0, 6.0],
        correlation: 0.3,
        large: true,
    },
    CoverageSetup {
        title: "Gyros: 120 tests of unequal runs, a stationary drift, a lot effect, some that never turn",
        model: r#"
[data]
time = "t"
[states]
bias = {}
scale = {}
drift = { process = "gauss-markov", time_constant = 0.5, sigma = 0.15 }
[measurements.rate]
column = "z"
equation = "bias + scale * turn + drift"
noise = 0.08
[mean.regression]
bias = ["lot"]
"#,
        cell: |test, row, column| match column {
            "t" => (row < 8 + 3 * (test % 4)).then_some(0.05 * row as f64 * (1.0 + (test % 3) as f64)),
            "turn" => Some(if test % 5 == 0 { 0.0 } else { 0.02 * ((row % 3) as f64 - 0.7) }),
            "lot" => Some(if test % 2 == 0 { 0.5 } else { -0.5 }),
            _ => Some(0.0),
        },
        tests: 120,
        mean: &[0.5, 40.0],
        coefficients: &[0.3],
        std_dev: &[0.8, 25.0],
        correlation: -0.4,
        large: true,
    },
    CoverageSetup {
        title: "Meta-analysis: 150 studies of two outcomes with errors of their own, some of one outcome only",
        model: r#"
[states]
first = {}
second = {}
[measurements.a]
column = "a"
equation = "first"
variance = "va"
[measurements.b]
column = "b"
equation = "second"
variance = "vb"
[noise_covariance]
"a, b" = "0.5 * sqrt(va * vb)"
"#,
        cell: |test, row, column| match column {
            _ if row > 0 => None,
            "va" => Some(0.02 + 0.01 * (test % 7) as f64),
            "vb" => Some(0.03 + 0.005 * (test % 11) as f64),
            "b" if test % 4 == 1 => Some(f64::NAN),
            _ => Some(0.0),
        },
        tests: 150,
        mean: &[0.4, -0.3],
        coefficients: &[],
        std_dev: &[0.25, 0.35],
        correlation: 0.6,
        large: true,
    },
];

/// Set-ups with levels are fitted four times, with profiles, and those of predictions and verdicts with free parameters: they get a tenth of the ensembles of the others.
const SHARE_OF_LEVELS: u64 = 10;

/// Runs all set-ups whose title holds `only` and prints their tables; fails when some coverage is not sound.
pub(crate) fn run(ensembles: u64, only: &str) -> ExitCode {
    println!("Coverage of 95 % intervals, {ensembles} ensembles each unless said otherwise, seed {SEED}.\n");
    let sound = without_levels(ensembles, only);
    few_tests::run(ensembles.div_ceil(SHARE_OF_LEVELS), only);
    levels::run(ensembles.div_ceil(SHARE_OF_LEVELS), only);
    crossed::run(ensembles.div_ceil(SHARE_OF_LEVELS), only);
    predictions::run(ensembles.div_ceil(SHARE_OF_LEVELS), only);
    verdicts::run(ensembles.div_ceil(SHARE_OF_LEVELS), only);
    if sound { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Whether the coverage of Wald's intervals is sound.
fn without_levels(ensembles: u64, only: &str) -> bool {
    let mut sound = true;
    for setup in SETUPS.iter().filter(|setup| setup.title.contains(only)) {
        let model = match Spec::parse("set-up", setup.model) {
            Ok(spec) => spec.model,
            Err(error) => {
                eprintln!("{}: {error}", setup.title);
                return false;
            }
        };
        println!("{}\n\n| quantity | truth | coverage | no interval |\n|---|---|---|---|", setup.title);
        let (names, tallies) = (names(model.shared()), tally(setup, model.shared(), ensembles));
        for ((name, truth), tally) in names.iter().zip(truths(setup)).zip(&tallies) {
            let coverage = tally.held as f64 / (ensembles - tally.without).max(1) as f64;
            sound &= !setup.large || (SOUND.contains(&coverage) && tally.without == 0);
            println!("| {name} | {truth} | {:.2} % | {} |", 100.0 * coverage, tally.without);
        }
        println!();
    }
    sound
}

fn names(model: &Model) -> Vec<String> {
    let states = model.estimated_names();
    let mut names: Vec<String> = states.iter().map(|s| format!("mean of {s}")).collect();
    let regression =
        |r: &kalfit::model::Regression| format!("{} on {}", states[r.element], model.columns[r.column].name);
    names.extend(model.mean.regression.iter().map(regression));
    names.extend(states.iter().map(|s| format!("log std dev of {s}")));
    names.push(format!("atanh correlation of {}", states.join(", ")));
    names
}

/// In the order of [`names`].
fn truths(setup: &CoverageSetup) -> Vec<f64> {
    [setup.mean, setup.coefficients, setup.std_dev, &[setup.correlation]].concat()
}

fn population(setup: &CoverageSetup) -> Population {
    let p = setup.mean.len();
    let correlation = |i: usize, j: usize| if i == j { 1.0 } else { setup.correlation };
    Population {
        mean: setup.mean.to_vec(),
        coefficients: setup.coefficients.to_vec(),
        covariance: DMatrix::from_fn(p, p, |i, j| setup.std_dev[i] * setup.std_dev[j] * correlation(i, j)),
    }
}

fn design(setup: &CoverageSetup, model: &Model) -> Vec<Test> {
    let one = |k: usize| {
        let mut test = Test::new(format!("t{k:03}"), model.columns.len(), 0);
        for row in 0.. {
            let cells = model.columns.iter().map(|column| (setup.cell)(k, row, &column.name));
            let Some(cells) = cells.collect::<Option<Vec<f64>>>() else { break };
            test.push(&cells, &[] as &[Label], Source::default());
        }
        test
    };
    (0..setup.tests).map(one).collect()
}

fn tally(setup: &CoverageSetup, model: &Model, ensembles: u64) -> Vec<IntervalTally> {
    let alpha = Alpha::fixed(&model.parameters).expect("a set-up has no free parameters");
    let designs = Designs::new(design(setup, model).into_iter().map(Into::into).collect())
        .expect("tests of a set-up have ids of their own");
    let truths = truths(setup);
    let each: Vec<Vec<Interval>> = (0..ensembles)
        .into_par_iter()
        .map_init(
            || Reducer::new(model, &alpha).expect("a set-up is sound"),
            |reducer, k| {
                let simulator = Simulator::new(&model.clone().into(), &alpha, population(setup), SEED + k)
                    .expect("a set-up is sound");
                let drawn = simulator.draw(&designs, 0..setup.tests as u64).expect("a set-up is sound");
                let tests: Vec<Test> = drawn.into_iter().flat_map(|drawn| drawn.test.rows()).collect();
                intervals(reducer, model, &alpha, &tests, truths.len())
            },
        )
        .collect();
    let mut tallies = vec![IntervalTally::default(); truths.len()];
    for ensemble in each {
        tallies.iter_mut().zip(ensemble).zip(&truths).for_each(|((tally, own), truth)| tally.add(own, *truth));
    }
    tallies
}

/// The interval of each of so many quantities; `None` where the fit has none.
fn intervals(reducer: &mut Reducer, model: &Model, alpha: &Alpha, tests: &[Test], count: usize) -> Vec<Interval> {
    let reductions = reducer.reduce(tests).expect("a set-up is sound");
    let structure = Structure::single(&model.mean, &model.covariance, alpha);
    let fit = estimate::fit(&reductions, &structure, &Settings::default(), &mut Silent).expect("a legal problem");
    if fit.stop != Stop::Certified {
        return vec![None; count];
    }
    let choices = Choices { deletion: DeletionChoice::None, ..Choices::default() };
    let intervals = infer::infer(&fit, &reductions, choices).intervals;
    let (p, r) = (fit.mean.len(), fit.coefficients.len());
    let of = |q: usize| match q {
        q if q < p => intervals.ends.mean[q],
        q if q < p + r => intervals.ends.coefficients[q - p],
        q if q < p + r + p => intervals.ends.std_dev[q - p - r],
        _ => intervals.ends.correlation[1][0],
    };
    (0..count).map(of).collect()
}
