//! How often the score tests and likelihood ratios of true constraints reject them, at few tests.

use kalfit::build::{Columns, ModelBuilder, constant, free, measurement, name};
use kalfit::infer::{Choices, DeletionChoice};
use kalfit::model::Model;
use kalfit::record::ConstraintRecord;
use kalfit::{Ensemble, Options, estimate};
use rand::RngExt;
use rand_distr::StandardNormal;
use rayon::prelude::*;

use crate::seed::random_of_block;

/// Nominal probabilities.
const LEVELS: [f64; 3] = [0.05, 0.01, 0.001];
/// Numbers of tests in an ensemble.
const TESTS: [usize; 3] = [8, 24, 100];
/// Rows of a test on a line.
const ROWS: usize = 5;

/// A right model with constraints.
struct ConstrainedCase {
    name: &'static str,
    model: fn() -> ModelBuilder,
    /// Columns of a test, from its two states, which are standard normal, and a source of normal numbers.
    columns: fn(Columns, [f64; 2], &mut dyn FnMut() -> f64) -> Columns,
}

const CASES: [ConstrainedCase; 2] = [
    ConstrainedCase { name: "two states, measured once each", model: measured_once, columns: once },
    ConstrainedCase { name: "lines with unknown noise", model: lines, columns: along_line },
];

fn measured_once() -> ModelBuilder {
    let states = Model::builder("once").state(constant("a")).state(constant("b"));
    states.measurement(measurement("ya", name("a"), 0.01)).measurement(measurement("yb", name("b"), 0.01)).diagonal()
}

fn once(columns: Columns, [a, b]: [f64; 2], normal: &mut dyn FnMut() -> f64) -> Columns {
    columns.numbers("ya", [a + 0.01 * normal()]).numbers("yb", [b + 0.01 * normal()])
}

fn lines() -> ModelBuilder {
    let states = Model::builder("lines").state(constant("a")).state(constant("b"));
    let line = measurement("y", name("a") + name("b") * name("x"), "s");
    states.measurement(line).parameter(free("s")).diagonal().fix_mean("a", 0.0)
}

fn along_line(columns: Columns, [a, b]: [f64; 2], normal: &mut dyn FnMut() -> f64) -> Columns {
    let x: Vec<f64> = (0..ROWS).map(|k| k as f64 / (ROWS - 1) as f64).collect();
    let y: Vec<f64> = x.iter().map(|x| a + b * x + 0.5 * normal()).collect();
    columns.numbers("x", x).numbers("y", y)
}

/// Fits, constraints that were tested, and rejections at each level by the score test, and by the likelihood ratio
/// after a score test that rejects.
#[derive(Default, Clone, Copy)]
struct RejectionCount {
    tested: u64,
    score: [u64; LEVELS.len()],
    contradicted: u64,
}

impl RejectionCount {
    fn of(constraints: &[ConstraintRecord]) -> RejectionCount {
        let p_values: Vec<f64> = constraints.iter().filter_map(|own| own.p_value).collect();
        let count = p_values.len() as f64;
        let contradicts = |own: &ConstraintRecord| own.likelihood_ratio_p_value.is_some_and(|p| p * count < 0.05);
        RejectionCount {
            tested: p_values.len() as u64,
            score: LEVELS.map(|level| p_values.iter().filter(|p| **p < level).count() as u64),
            contradicted: u64::from(constraints.iter().any(contradicts)),
        }
    }

    fn with(self, other: RejectionCount) -> RejectionCount {
        RejectionCount {
            tested: self.tested + other.tested,
            score: std::array::from_fn(|k| self.score[k] + other.score[k]),
            contradicted: self.contradicted + other.contradicted,
        }
    }
}

/// Prints the table of score tests of true constraints, from `ensembles` ensembles of each size.
pub(super) fn run(ensembles: u64) -> Result<(), String> {
    println!(
        "\nConstraints of a right model: share of p-values below the nominal one, and of fits whose summary says that the data \
         contradict a constraint; {ensembles} ensembles of each size.\n"
    );
    println!("| model | tests | below 0.05 | below 0.01 | below 0.001 | contradicted |\n|---|--:|--:|--:|--:|--:|");
    for case in &CASES {
        for tests in TESTS {
            let all: Result<Vec<RejectionCount>, String> =
                (0..ensembles).into_par_iter().map(|k| one(case, tests, k as usize)).collect();
            let sum = all?.into_iter().fold(RejectionCount::default(), RejectionCount::with);
            let share = |count: u64, of: u64| format!("{:.2} %", 100.0 * count as f64 / of.max(1) as f64);
            let [a, b, c] = sum.score.map(|count| share(count, sum.tested));
            println!("| {} | {tests} | {a} | {b} | {c} | {} |", case.name, share(sum.contradicted, ensembles));
        }
    }
    Ok(())
}

fn one(case: &ConstrainedCase, tests: usize, k: usize) -> Result<RejectionCount, String> {
    let mut random = random_of_block(tests, k);
    let mut normal = || random.sample::<f64, _>(StandardNormal);
    let columns: Vec<Columns> = (0..tests)
        .map(|j| {
            let states = [normal(), normal()];
            (case.columns)(Columns::new(format!("t{j:03}")), states, &mut normal)
        })
        .collect();
    let model = (case.model)().build().map_err(|error| error.to_string())?;
    let ensemble = Ensemble::new(&model, &columns).map_err(|error| error.to_string())?;
    let choices = Choices { deletion: DeletionChoice::None, ..Choices::default() };
    let options = Options { choices, innovations: false, ..Options::default() };
    let fit = ensemble.fit_with(&options, &mut estimate::Silent).map_err(|error| error.to_string())?;
    Ok(if fit.converged() { RejectionCount::of(&fit.record.constraints) } else { RejectionCount::default() })
}
