//! Coverage of intervals where several tests are of one unit: Wald's and profile intervals, noise known and noise free.

use kalfit::infer::{Choices, DeletionChoice, IntervalKind, TestsChoice};
use kalfit::record::{FitRecord, Interval};
use kalfit::{Alpha, Ensemble, Options, PhasedModel, Population, estimate};
use kalfit_spec::Spec;
use nalgebra::DMatrix;
use rayon::prelude::*;

use super::drawn::design;
use super::tally::IntervalTally;
use crate::seed::SEED;

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
struct LevelsSetup {
    title: &'static str,
    states: &'static [&'static str],
    units: usize,
    /// Of each unit.
    tests: usize,
    /// Of each test; the last regressor runs over their numbers.
    rows: usize,
    mean: &'static [f64],
    /// Outermost first.
    levels: [LevelSpread; 2],
}

/// What varies at one level.
struct LevelSpread {
    name: &'static str,
    std_dev: &'static [f64],
    /// Of the two states, where there are two.
    correlation: f64,
}

const SETUPS: [LevelsSetup; 4] = [
    LevelsSetup {
        title: "Levels: 30 units of 5 tests of 4 rows, one state",
        states: &["level"],
        units: 30,
        tests: 5,
        rows: 4,
        mean: &[250.0],
        levels: [
            LevelSpread { name: "unit", std_dev: &[24.0], correlation: 0.0 },
            LevelSpread { name: "tests", std_dev: &[12.0], correlation: 0.0 },
        ],
    },
    LevelsSetup {
        title: "Levels: 10 units of 3 tests of 4 rows, one state",
        states: &["level"],
        units: 10,
        tests: 3,
        rows: 4,
        mean: &[250.0],
        levels: [
            LevelSpread { name: "unit", std_dev: &[24.0], correlation: 0.0 },
            LevelSpread { name: "tests", std_dev: &[12.0], correlation: 0.0 },
        ],
    },
    LevelsSetup {
        title: "Levels: 30 units of 5 tests of 8 rows, two states",
        states: &["level", "slope"],
        units: 30,
        tests: 5,
        rows: 8,
        mean: &[250.0, 10.0],
        levels: [
            LevelSpread { name: "unit", std_dev: &[24.0, 6.0], correlation: 0.3 },
            LevelSpread { name: "tests", std_dev: &[12.0, 4.0], correlation: -0.3 },
        ],
    },
    LevelsSetup {
        title: "Levels: 10 units of 3 tests of 8 rows, two states",
        states: &["level", "slope"],
        units: 10,
        tests: 3,
        rows: 8,
        mean: &[250.0, 10.0],
        levels: [
            LevelSpread { name: "unit", std_dev: &[24.0, 6.0], correlation: 0.3 },
            LevelSpread { name: "tests", std_dev: &[12.0, 4.0], correlation: -0.3 },
        ],
    },
];

/// What intervals are looked at.
#[derive(Debug, Clone, Copy)]
enum CoveredQuantity {
    Mean(usize),
    StdDev { level: usize, state: usize },
    Correlation { level: usize },
    Sigma,
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

impl LevelsSetup {
    fn quantities(&self) -> Vec<CoveredQuantity> {
        let states = 0..self.states.len();
        let mut all: Vec<CoveredQuantity> = states.clone().map(CoveredQuantity::Mean).collect();
        for level in 0..self.levels.len() {
            all.extend(states.clone().map(|state| CoveredQuantity::StdDev { level, state }));
            all.extend((self.states.len() == 2).then_some(CoveredQuantity::Correlation { level }));
        }
        all.push(CoveredQuantity::Sigma);
        all
    }

    fn name(&self, quantity: CoveredQuantity) -> String {
        let at = |level: usize| self.levels[level].name;
        match quantity {
            CoveredQuantity::Mean(state) => format!("mean of {}", self.states[state]),
            CoveredQuantity::StdDev { level, state } => format!("{}: std dev of {}", at(level), self.states[state]),
            CoveredQuantity::Correlation { level } => format!("{}: correlation", at(level)),
            CoveredQuantity::Sigma => "noise".to_owned(),
        }
    }

    fn truth(&self, quantity: CoveredQuantity) -> f64 {
        match quantity {
            CoveredQuantity::Mean(state) => self.mean[state],
            CoveredQuantity::StdDev { level, state } => self.levels[level].std_dev[state],
            CoveredQuantity::Correlation { level } => self.levels[level].correlation,
            CoveredQuantity::Sigma => SIGMA,
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
            let LevelSpread { std_dev, correlation, .. } = &self.levels[1 - i / p];
            let of_pair = if i == k { 1.0 } else { *correlation };
            if i / p == k / p { std_dev[i % p] * std_dev[k % p] * of_pair } else { 0.0 }
        });
        let mean = [self.mean, &vec![0.0; p]].concat();
        Population { mean, coefficients: Vec::new(), covariance }
    }

    /// By quantity, of each of [`FITS`].
    fn tally(&self, ensembles: u64) -> Vec<[IntervalTally; FITS.len()]> {
        let models = [self.model(false), self.model(true)];
        let x: Vec<f64> = (0..self.rows).map(|row| row as f64).collect();
        let design = design(&models[0], (self.units, self.tests), &x);
        let alpha = Alpha::fixed(&models[0].shared().parameters).expect("the noise is known");
        let each: Vec<Vec<[Interval; FITS.len()]>> = (0..ensembles)
            .into_par_iter()
            .map(|k| {
                let drawn = design.draw(&alpha, self.population(), design.tests().len() as u64, SEED + k);
                self.intervals(&models, &drawn.expect("a set-up is sound"))
            })
            .collect();
        let mut tallies = vec![[IntervalTally::default(); FITS.len()]; self.quantities().len()];
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
        let of = |quantity: CoveredQuantity| std::array::from_fn(|fit| interval(&records[fit], quantity));
        self.quantities().into_iter().map(of).collect()
    }
}

/// The interval of a quantity; `None` where the fit has none, or is not certified.
fn interval(record: &FitRecord, quantity: CoveredQuantity) -> Interval {
    if !record.converged {
        return None;
    }
    match quantity {
        CoveredQuantity::Mean(state) => record.phases[0].mean.interval95[state],
        CoveredQuantity::StdDev { level, state } => record.levels[level].std_dev.interval95[state],
        CoveredQuantity::Correlation { level } => record.levels[level].correlation.interval95[1][0],
        CoveredQuantity::Sigma => record.parameters[0].interval95.filter(|_| !record.parameters[0].fixed),
    }
}
