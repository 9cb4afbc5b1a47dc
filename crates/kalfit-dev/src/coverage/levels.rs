//! Coverage of intervals where several tests are of one unit: Wald's and profile intervals, noise known and noise free.

use kalfit::infer::{Choices, DeletionChoice, IntervalKind, TestsChoice};
use kalfit::record::{FitRecord, Interval};
use kalfit::{Alpha, Ensemble, Labels, Options, PhasedModel, Population, Source, Test, estimate};
use kalfit_spec::Spec;
use nalgebra::DMatrix;
use rayon::prelude::*;

use super::SEED;

/// Of the simulation, and of the fits that know it.
const SIGMA: f64 = 20.0;
/// What is fitted to each ensemble: whether the noise is free, and which intervals are asked for.
const FITS: [(bool, IntervalKind); 4] = [
    (false, IntervalKind::Wald),
    (false, IntervalKind::Profile),
    (true, IntervalKind::Wald),
    (true, IntervalKind::Profile),
];

/// A design and a population.
struct Setup {
    title: &'static str,
    states: &'static [&'static str],
    units: usize,
    /// Of each unit.
    tests: usize,
    /// Of each test; the last regressor runs over their numbers.
    rows: usize,
    mean: &'static [f64],
    /// Outermost first.
    levels: [Spread; 2],
}

/// What varies at one level.
struct Spread {
    name: &'static str,
    std_dev: &'static [f64],
    /// Of the two states, where there are two.
    correlation: f64,
}

const SETUPS: [Setup; 4] = [
    Setup {
        title: "Levels: 30 units of 5 tests of 4 rows, one state",
        states: &["level"],
        units: 30,
        tests: 5,
        rows: 4,
        mean: &[250.0],
        levels: [
            Spread { name: "unit", std_dev: &[24.0], correlation: 0.0 },
            Spread { name: "tests", std_dev: &[12.0], correlation: 0.0 },
        ],
    },
    Setup {
        title: "Levels: 10 units of 3 tests of 4 rows, one state",
        states: &["level"],
        units: 10,
        tests: 3,
        rows: 4,
        mean: &[250.0],
        levels: [
            Spread { name: "unit", std_dev: &[24.0], correlation: 0.0 },
            Spread { name: "tests", std_dev: &[12.0], correlation: 0.0 },
        ],
    },
    Setup {
        title: "Levels: 30 units of 5 tests of 8 rows, two states",
        states: &["level", "slope"],
        units: 30,
        tests: 5,
        rows: 8,
        mean: &[250.0, 10.0],
        levels: [
            Spread { name: "unit", std_dev: &[24.0, 6.0], correlation: 0.3 },
            Spread { name: "tests", std_dev: &[12.0, 4.0], correlation: -0.3 },
        ],
    },
    Setup {
        title: "Levels: 10 units of 3 tests of 8 rows, two states",
        states: &["level", "slope"],
        units: 10,
        tests: 3,
        rows: 8,
        mean: &[250.0, 10.0],
        levels: [
            Spread { name: "unit", std_dev: &[24.0, 6.0], correlation: 0.3 },
            Spread { name: "tests", std_dev: &[12.0, 4.0], correlation: -0.3 },
        ],
    },
];

/// What intervals are looked at.
#[derive(Debug, Clone, Copy)]
enum Quantity {
    Mean(usize),
    StdDev { level: usize, state: usize },
    Correlation { level: usize },
    Sigma,
}

/// How often an interval held the truth.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    held: u64,
    /// Fits without this interval.
    without: u64,
}

/// Runs the set-ups whose title holds `only` and prints their tables. Nothing is required of them: units are few.
pub(super) fn run(ensembles: u64, only: &str) {
    for setup in SETUPS.iter().filter(|setup| setup.title.contains(only)) {
        println!("{}; {ensembles} ensembles\n", setup.title);
        println!(
            "| quantity | truth | noise known, Wald | noise known, profile | noise free, Wald | noise free, profile |"
        );
        println!("|---|---|---|---|---|---|");
        let tallies = setup.tally(ensembles);
        for (quantity, tallies) in setup.quantities().into_iter().zip(tallies) {
            let cells: Vec<String> = tallies.iter().map(|tally| tally.shown(ensembles)).collect();
            println!("| {} | {} | {} |", setup.name(quantity), setup.truth(quantity), cells.join(" | "));
        }
        println!();
    }
}

impl Tally {
    fn add(&mut self, interval: Interval, truth: f64) {
        match interval {
            Some([low, high]) => {
                let inside = low.is_none_or(|low| low <= truth) && high.is_none_or(|high| truth <= high);
                self.held += u64::from(inside);
            }
            None => self.without += 1,
        }
    }

    /// Share of the intervals that held the truth; in brackets how many fits have none.
    fn shown(&self, ensembles: u64) -> String {
        match (ensembles - self.without, self.without) {
            (0, _) => "-".to_owned(),
            (all, 0) => format!("{:.1} %", 100.0 * self.held as f64 / all as f64),
            (all, without) => format!("{:.1} % ({without})", 100.0 * self.held as f64 / all as f64),
        }
    }
}

impl Setup {
    fn quantities(&self) -> Vec<Quantity> {
        let states = 0..self.states.len();
        let mut all: Vec<Quantity> = states.clone().map(Quantity::Mean).collect();
        for level in 0..self.levels.len() {
            all.extend(states.clone().map(|state| Quantity::StdDev { level, state }));
            all.extend((self.states.len() == 2).then_some(Quantity::Correlation { level }));
        }
        all.push(Quantity::Sigma);
        all
    }

    fn name(&self, quantity: Quantity) -> String {
        let at = |level: usize| self.levels[level].name;
        match quantity {
            Quantity::Mean(state) => format!("mean of {}", self.states[state]),
            Quantity::StdDev { level, state } => format!("{}: std dev of {}", at(level), self.states[state]),
            Quantity::Correlation { level } => format!("{}: correlation", at(level)),
            Quantity::Sigma => "noise".to_owned(),
        }
    }

    fn truth(&self, quantity: Quantity) -> f64 {
        match quantity {
            Quantity::Mean(state) => self.mean[state],
            Quantity::StdDev { level, state } => self.levels[level].std_dev[state],
            Quantity::Correlation { level } => self.levels[level].correlation,
            Quantity::Sigma => SIGMA,
        }
    }

    fn model(&self, noise_is_free: bool) -> PhasedModel {
        let states: String = self.states.iter().map(|state| format!("{state} = {{}}\n")).collect();
        let equation = ["level", "level + slope * x"][self.states.len() - 1];
        let sigma = if noise_is_free { "{}".to_owned() } else { SIGMA.to_string() };
        let text = format!(
            "[data]\ntest = \"test\"\nlevels = [\"unit\"]\n[states]\n{states}[measurements.y]\ncolumn = \"y\"\n\
             equation = \"{equation}\"\nnoise = \"sigma\"\n[parameters]\nsigma = {sigma}\n"
        );
        Spec::parse("set-up", &text).expect("a set-up is sound").model
    }

    /// The tests' own Σ, then that of the units.
    fn population(&self) -> Population {
        let p = self.states.len();
        let covariance = DMatrix::from_fn(2 * p, 2 * p, |i, k| {
            let Spread { std_dev, correlation, .. } = &self.levels[1 - i / p];
            let of_pair = if i == k { 1.0 } else { *correlation };
            if i / p == k / p { std_dev[i % p] * std_dev[k % p] * of_pair } else { 0.0 }
        });
        let mean = [self.mean, &vec![0.0; p]].concat();
        Population { mean, coefficients: Vec::new(), covariance }
    }

    /// Tests with a zero for every value that is to be drawn.
    fn design(&self, model: &PhasedModel) -> Ensemble {
        let shared = model.shared();
        let mut labels = Labels::new(&shared.literals);
        let mut tests = Vec::new();
        for unit in 0..self.units {
            let name = labels.intern(&format!("u{unit}"));
            for test in 0..self.tests {
                let mut rows = Test::new(format!("u{unit}/{test}"), shared.columns.len(), shared.text_columns.len());
                for row in 0..self.rows {
                    let cell = |name: &str| if name == "x" { row as f64 } else { 0.0 };
                    let cells: Vec<f64> = shared.columns.iter().map(|column| cell(&column.name)).collect();
                    rows.push(&cells, &vec![name; shared.text_columns.len()], Source::default());
                }
                tests.push(rows.into());
            }
        }
        Ensemble::of_tests(model, labels, tests)
    }

    /// By quantity, of each of [`FITS`].
    fn tally(&self, ensembles: u64) -> Vec<[Tally; FITS.len()]> {
        let models = [self.model(false), self.model(true)];
        let design = self.design(&models[0]);
        let alpha = Alpha::fixed(&models[0].shared().parameters).expect("the noise is known");
        let each: Vec<Vec<[Interval; FITS.len()]>> = (0..ensembles)
            .into_par_iter()
            .map(|k| {
                let drawn = design.draw(&alpha, self.population(), design.tests().len() as u64, SEED + k);
                self.intervals(&models, &drawn.expect("a set-up is sound"))
            })
            .collect();
        let mut tallies = vec![[Tally::default(); FITS.len()]; self.quantities().len()];
        for ensemble in &each {
            for ((tallies, intervals), quantity) in tallies.iter_mut().zip(ensemble).zip(self.quantities()) {
                let truth = self.truth(quantity);
                tallies.iter_mut().zip(intervals).for_each(|(tally, interval)| tally.add(*interval, truth));
            }
        }
        tallies
    }

    /// By quantity, of each of [`FITS`].
    fn intervals(&self, models: &[PhasedModel; 2], drawn: &Ensemble) -> Vec<[Interval; FITS.len()]> {
        let records = FITS.map(|(noise_is_free, intervals)| {
            let choices =
                Choices { intervals, deletion: DeletionChoice::None, tests: TestsChoice::None, ..Choices::default() };
            let options = Options { choices, innovations: false, ..Options::default() };
            let (model, labels) = (&models[usize::from(noise_is_free)], drawn.labels().clone());
            let ensemble = Ensemble::of_tests(model, labels, drawn.tests().to_vec());
            ensemble.fit_with(&options, &mut estimate::Silent).expect("a legal problem").record
        });
        let of = |quantity: Quantity| std::array::from_fn(|fit| interval(&records[fit], quantity));
        self.quantities().into_iter().map(of).collect()
    }
}

/// The interval of a quantity; `None` where the fit has none, or is not certified.
fn interval(record: &FitRecord, quantity: Quantity) -> Interval {
    if !record.converged {
        return None;
    }
    match quantity {
        Quantity::Mean(state) => record.phases[0].mean.interval95[state],
        Quantity::StdDev { level, state } => record.levels[level].std_dev.interval95[state],
        Quantity::Correlation { level } => record.levels[level].correlation.interval95[1][0],
        Quantity::Sigma => record.parameters[0].interval95.filter(|_| !record.parameters[0].fixed),
    }
}
