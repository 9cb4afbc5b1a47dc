//! Coverage with few tests: means by maximum likelihood and by Kenward and Roger, all means together by F, standard
//! deviations and noise levels by profiles of the restricted likelihood, one new test and tolerance limits by predictions.

use kalfit::estimate::{self, Criterion};
use kalfit::infer::{Choices, DeletionChoice, Knowledge, TestsChoice};
use kalfit::predict::{Bounds, Initial, Limits, Predicted, Predictor, Sides, What};
use kalfit::record::Interval;
use kalfit::{Alpha, Ensemble, Fit, Labels, Options, PhasedTest};
use kalfit_spec::{DesignSpec, Spec};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, Normal};

use super::drawn::{DrawnSetup, LINE, NOISY, UNITS, rows, values};
use super::tally::IntervalTally;
use crate::seed::SEED;

/// Numbers of tests, or of units.
const TESTS: [usize; 5] = [5, 8, 12, 20, 40];
/// Rows of successive tests of unequal designs.
const UNEQUAL: [usize; 5] = [2, 28, 4, 12, 7];
/// Rows of every test of equal designs.
const EQUAL: [usize; 1] = [10];
/// Rows of every test with a process.
const LONG: [usize; 1] = [20];
/// Tests of every unit.
const RUNS: usize = 3;
/// Columns of the table.
const COLUMNS: [&str; 7] = [
    "mean, ML",
    "mean, REML",
    "all means, F",
    "std dev, profile of REML",
    "noise, profile of REML",
    "new test",
    "tolerance, one side",
];
/// The last rows of missions, a little beyond those of tests.
const MISSION: [f64; 2] = [0.0, 12.0];
const LIMITS: Limits = Limits { confidence: 0.9, content: 0.95, sides: Sides::One };

/// A model, the lengths of its tests, and the least number of tests.
struct FewTestsSetup {
    name: &'static str,
    drawn: DrawnSetup,
    /// Equation of the output that is predicted.
    output: &'static str,
    lengths: &'static [usize],
    least: usize,
}

/// Runs the set-ups whose title holds `only` and prints their table. Nothing is required of them.
pub(super) fn run(ensembles: u64, only: &str) {
    let level = DrawnSetup { model: LEVEL, ..NOISY };
    let four = DrawnSetup { model: FOUR, mean: &[1.0, 0.5, 0.0, -0.5], std_dev: &[&[1.0; 4]], ..NOISY };
    let process = DrawnSetup { model: PROCESS, free: "sigma tau", ..NOISY };
    let setup = |name, drawn, output, lengths, least| FewTestsSetup { name, drawn, output, lengths, least };
    let setups = [
        setup("1, equal", level, "level", &EQUAL[..], 5),
        setup("1, unequal", level, "level", &UNEQUAL, 5),
        setup("2, equal", LINE, LINE_OUTPUT, &EQUAL, 5),
        setup("2, unequal", LINE, LINE_OUTPUT, &UNEQUAL, 5),
        setup("4, unequal", four, "a", &UNEQUAL, 8),
        setup("1, units of three unequal tests", UNITS, "level", &UNEQUAL, 5),
        setup("1, and a process whose time constant is free", process, "level", &LONG, 5),
    ];
    let is_chosen =
        |setup: &&FewTestsSetup| "Few tests".contains(only) || format!("Few tests: {}", setup.name).contains(only);
    let chosen: Vec<&FewTestsSetup> = setups.iter().filter(is_chosen).collect();
    if chosen.is_empty() {
        return;
    }
    println!("Few tests; {ensembles} ensembles of each; tolerance limits that should hold in 90 %\n");
    println!("| states, tests | number | {} |", COLUMNS.join(" | "));
    println!("|---|--:|--:|--:|--:|--:|--:|--:|--:|");
    for setup in chosen {
        for tests in TESTS.into_iter().filter(|&tests| tests >= setup.least) {
            let cells = setup.tally(tests, ensembles).map(|tally| tally.shown(ensembles));
            println!("| {} | {tests} | {} |", setup.name, cells.join(" | "));
        }
    }
    println!();
}

/// Both states of a line together.
const LINE_OUTPUT: &str = "level + slope * x";

/// Levels of spread one, read with noise of 1.5.
const LEVEL: &str = r#"
[data]
test = "test"
[states]
level = {}
[measurements.y]
column = "y"
equation = "level + 0 * x"
noise = "sigma"
[parameters]
sigma = 1.5
"#;

/// Four states of spread one.
const FOUR: &str = r#"
[data]
test = "test"
[states]
a = {}
b = {}
c = {}
d = {}
[measurements.y]
column = "y"
equation = "a + b * cos(x) + c * sin(x) + d * cos(2 * x)"
noise = "sigma"
[parameters]
sigma = 1
"#;

/// A level, and a Gauss-Markov process of known size.
const PROCESS: &str = r#"
[data]
test = "test"
time = "x"
[states]
level = {}
drift = { process = "gauss-markov", time_constant = "tau", sigma = 0.7 }
[measurements.y]
column = "y"
equation = "level + drift"
noise = "sigma"
[parameters]
sigma = 0.5
tau = 2
"#;

/// The truth that ensembles are drawn from, and what is predicted there.
struct Truth {
    model: Spec,
    alpha: Alpha,
    sigma: f64,
    /// Mean and standard deviation of the first state over tests.
    first: [f64; 2],
    /// What is predicted, and its law.
    design: DesignSpec,
    mission: PhasedTest,
    predicted: Predicted,
}

impl FewTestsSetup {
    fn truth(&self) -> Truth {
        let model = self.drawn.spec(false);
        let alpha = Alpha::fixed(&model.model.shared().parameters).expect("all are known");
        let output = format!("[outputs.o]\nequation = \"{}\"\n", self.output);
        let design = model.design(Some(&output), false).expect("a set-up is sound");
        let mission = rows(&design.spec.model, "mission", &MISSION, &[]);
        let initial = Initial::new(&model.model, &self.drawn.population());
        let predicted = predicted(&design, &mission, (&alpha, &initial), Knowledge::exact());
        Truth {
            sigma: alpha.value(0, &[]).expect("the noise is known"),
            first: [self.drawn.mean[0], self.drawn.std_dev[0][0]],
            model,
            alpha,
            design,
            mission,
            predicted,
        }
    }

    /// One tally of each column.
    fn tally(&self, tests: usize, ensembles: u64) -> [IntervalTally; COLUMNS.len()] {
        let truth = self.truth();
        let model = &truth.model.model;
        let runs = if model.levels.is_empty() { 1 } else { RUNS };
        let x = |row: usize, of: usize| 9.0 * row as f64 / (of - 1) as f64;
        let mut labels = Labels::new(&model.shared().literals);
        let texts = model.shared().text_columns.len();
        let test = |t: usize| {
            let length = self.lengths[t % self.lengths.len()];
            let x: Vec<f64> = (0..length).map(|row| x(row, length)).collect();
            let unit = labels.intern(&format!("u{}", t / runs));
            rows(model, &format!("t{t:03}"), &x, &vec![unit; texts])
        };
        let all: Vec<PhasedTest> = (0..tests * runs).map(test).collect();
        let design = Ensemble::of_tests(model, labels, all);
        let count = (tests * runs) as u64;
        let one = |k: u64| {
            let drawn = design.draw(&truth.alpha, self.drawn.population(), count, SEED + k).expect("a set-up is sound");
            self.intervals(&truth, &drawn)
        };
        let each: Vec<[Interval; COLUMNS.len()]> = (0..ensembles).into_par_iter().map(one).collect();
        let mut tallies = [IntervalTally::default(); COLUMNS.len()];
        let normal = Normal::standard();
        let [mean, s] = [truth.predicted.mean, truth.predicted.variance().sqrt()];
        for (k, intervals) in each.into_iter().enumerate() {
            // a new test for each ensemble, evenly over its law
            let new_test = mean + s * normal.inverse_cdf((k as f64 + 0.5) / ensembles as f64);
            let limit = mean + s * normal.inverse_cdf(LIMITS.content);
            let [first, spread] = truth.first;
            let truths = [first, first, 0.0, spread, truth.sigma, new_test, limit];
            for (c, interval) in intervals.into_iter().enumerate() {
                tallies[c].add(interval, truths[c]);
            }
        }
        tallies
    }

    /// The interval of each column; that of F is about zero where the test of the true means does not reject.
    fn intervals(&self, truth: &Truth, drawn: &Ensemble) -> [Interval; COLUMNS.len()] {
        let fit = |criterion: Criterion| {
            let choices = Choices { deletion: DeletionChoice::None, tests: TestsChoice::None, ..Choices::default() };
            let mut options = Options { choices, innovations: false, ..Options::default() };
            options.settings.criterion = criterion;
            let free = self.drawn.spec(true);
            let ensemble = Ensemble::of_tests(&free.model, drawn.labels().clone(), drawn.tests().to_vec());
            ensemble.fit_with(&options, &mut estimate::Silent).expect("a legal problem")
        };
        let [ml, reml] = [Criterion::Ml, Criterion::Reml].map(fit);
        let mean = |fit: &Fit| fit.record.phases[0].mean.interval95[0].filter(|_| fit.record.converged);
        let phase = &reml.record.phases[0];
        let if_converged = |interval: Interval| interval.filter(|_| reml.record.converged);
        let [new_test, tolerance] = self.predicted(truth, &reml);
        [
            mean(&ml),
            mean(&reml),
            all_means(&reml, self.drawn.mean),
            if_converged(phase.std_dev.interval95[0]),
            if_converged(reml.record.parameters[0].interval95),
            if_converged(new_test),
            if_converged(tolerance),
        ]
    }

    /// Limits of a new test, and the upper tolerance limit, from a fit.
    fn predicted(&self, truth: &Truth, fit: &Fit) -> [Interval; 2] {
        let model = &truth.model.model;
        let (Some(population), Some(knowledge)) = (fit.record.population(model).ok(), fit.record.knowledge(model))
        else {
            return [None; 2];
        };
        let (alpha, initial) = (values(&truth.model, &fit.record), Initial::new(model, &population));
        let value = predicted(&truth.design, &truth.mission, (&alpha, &initial), knowledge);
        let bounds = Bounds::new(LIMITS);
        let new_test = bounds.of_new_test(&value).map(|([lower, upper], _)| [Some(lower), Some(upper)]);
        [new_test, bounds.of_tests(&value).map(|[_, upper]| [None, Some(upper)])]
    }
}

/// The output at the end of the mission.
fn predicted(
    DesignSpec { spec, outputs }: &DesignSpec,
    mission: &PhasedTest,
    (alpha, initial): (&Alpha, &Initial),
    knowledge: Knowledge,
) -> Predicted {
    let predictor = Predictor::new(&spec.model, outputs, (alpha, &[]), Some(knowledge)).expect("it predicts");
    let found = predictor.predict(std::slice::from_ref(mission), &[initial]).expect("it predicts");
    let last = found[0][0].steps.last().expect("there are rows");
    last.values.iter().find(|value| matches!(value.what, What::Output(_))).expect("an output").clone()
}

/// An interval about zero where F does not reject the true means at 5 %, else beside zero; `None` without an F test.
fn all_means(fit: &Fit, truth: &[f64]) -> Interval {
    let found = fit.inference.few_tests.as_ref()?.as_ref().ok()?;
    let every = DMatrix::identity(truth.len(), found.mean.len() + found.coefficients.len());
    let found = found.law.joint(&every, &DVector::from_column_slice(truth)).ok()?;
    Some(if found.p_value > 0.05 { [Some(-1.0), Some(1.0)] } else { [Some(1.0), Some(1.0)] })
}
