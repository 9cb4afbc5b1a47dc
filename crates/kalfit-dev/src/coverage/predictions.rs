//! Limits of predictions: how often a limit of the mean holds the mean, and tolerance limits as many of the tests as they say.

use kalfit::infer::Knowledge;
use kalfit::predict::{Bounds, Initial, Limits, Predicted, Predictor, Sides, What};
use kalfit::{Alpha, Population};
use kalfit_spec::DesignSpec;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, Normal};

use super::drawn::{CONSTANT, DrawnSetup, LINE, NOISY, UNITS, WALK, rows, values};
use crate::seed::SEED;

const LIMITS: Limits = Limits { confidence: 0.9, content: 0.95, sides: Sides::Two };

/// What is predicted from which ensembles.
struct PredictionSetup {
    title: &'static str,
    output: &'static str,
    /// `x` of the mission, whose last row counts.
    mission: &'static [f64],
    drawn: DrawnSetup,
}

const SETUPS: [PredictionSetup; 8] = [
    PredictionSetup {
        title: "5 tests that determine their level exactly",
        output: "level",
        mission: &[0.0],
        drawn: CONSTANT,
    },
    PredictionSetup {
        title: "5 tests that determine their level exactly, by restricted likelihood",
        output: "level",
        mission: &[0.0],
        drawn: DrawnSetup { restricted: true, ..CONSTANT },
    },
    PredictionSetup {
        title: "30 tests that determine their level with an error as large as its spread",
        output: "level",
        mission: &[0.0],
        drawn: NOISY,
    },
    PredictionSetup {
        title: "30 tests that determine their level with an error of 1.7 times its spread",
        output: "level",
        mission: &[0.0],
        drawn: DrawnSetup { rows: &[0.0, 1.0, 2.0, 3.0], ..NOISY },
    },
    PredictionSetup {
        title: "18 random lines of 10 rows, a little beyond them",
        output: "level + slope * x",
        mission: &[12.0],
        drawn: LINE,
    },
    PredictionSetup {
        title: "12 random walks of 20 rows from a random level, density and noise free",
        output: "level + walk",
        mission: &[10.0, 30.0],
        drawn: WALK,
    },
    PredictionSetup {
        title: "10 units of 3 tests of 4 rows, a new unit",
        output: "level",
        mission: &[0.0],
        drawn: UNITS,
    },
    PredictionSetup {
        title: "30 units of 5 tests of 4 rows, a new unit",
        output: "level",
        mission: &[0.0],
        drawn: DrawnSetup { units: 30, tests: 5, ..UNITS },
    },
];

/// How often limits held.
#[derive(Debug, Default, Clone, Copy)]
struct LimitTally {
    of: u64,
    mean: u64,
    quantiles: u64,
    two: u64,
    one: u64,
    unknown: u64,
}

/// Runs the set-ups whose title holds `only` and prints their table.
pub(super) fn run(ensembles: u64, only: &str) {
    let chosen: Vec<&PredictionSetup> =
        SETUPS.iter().filter(|setup| "Predictions".contains(only) || setup.title.contains(only)).collect();
    if chosen.is_empty() {
        return;
    }
    println!(
        "Predictions: limits that should hold in 90 % of {ensembles} ensembles, tolerance limits of 95 % of all tests\n"
    );
    println!("| set-up | limits of the mean | m ± 1.96 s | tolerance, two sides | tolerance, one side | no limits |");
    println!("|---|---|---|---|---|---|");
    for setup in chosen {
        let LimitTally { of, mean, quantiles, two, one, unknown } = setup.tally(ensembles);
        let part = |held: u64| format!("{:.1} %", 100.0 * held as f64 / (of - unknown).max(1) as f64);
        let [mean, quantiles, two, one] = [mean, quantiles, two, one].map(part);
        println!("| {} | {mean} | {quantiles} | {two} | {one} | {unknown} |", setup.title);
    }
    println!();
}

impl PredictionSetup {
    fn tally(&self, ensembles: u64) -> LimitTally {
        let [known, free] = [false, true].map(|is_free| self.drawn.spec(is_free));
        let outputs = format!("[outputs.y]\nequation = \"{}\"\n", self.output);
        let DesignSpec { spec: design, outputs } = known.design(Some(&outputs), false).expect("a set-up is sound");
        let mission = rows(&design.model, "mission", self.mission, &[]);
        let predicted = |alpha: &Alpha, population: &Population, knowledge: Knowledge| -> Predicted {
            let predictor =
                Predictor::new(&design.model, &outputs, (alpha, &[]), Some(knowledge)).expect("it predicts");
            let initial = Initial::new(&known.model, population);
            let found = predictor.predict(std::slice::from_ref(&mission), &[&initial]).expect("it predicts");
            let last = found[0][0].steps.last().expect("there are rows");
            last.values.iter().find(|value| matches!(value.what, What::Output(_))).expect("an output").clone()
        };
        let alpha = Alpha::fixed(&known.model.shared().parameters).expect("the truth is known");
        let truth = predicted(&alpha, &self.drawn.population(), Knowledge::exact());
        let ensemble = self.drawn.design(&known);
        let bounds = [Sides::Two, Sides::One].map(|sides| Bounds::new(Limits { sides, ..LIMITS }));
        let tally = (0..ensembles).into_par_iter().map(|k| {
            let tests = ensemble.tests().len() as u64;
            let drawn = ensemble.draw(&alpha, self.drawn.population(), tests, SEED + k).expect("a set-up is sound");
            let record = self.drawn.fit(&free, &drawn);
            let found = record.converged.then(|| {
                let population = record.population(&known.model).expect("it is of this model");
                let values = values(&known, &record);
                predicted(&values, &population, record.knowledge(&known.model).expect("there are few numbers"))
            });
            one(found.as_ref(), &truth, &bounds)
        });
        tally.reduce(LimitTally::default, |a, b| LimitTally {
            of: a.of + b.of,
            mean: a.mean + b.mean,
            quantiles: a.quantiles + b.quantiles,
            two: a.two + b.two,
            one: a.one + b.one,
            unknown: a.unknown + b.unknown,
        })
    }
}

fn one(found: Option<&Predicted>, truth: &Predicted, [two, one]: &[Bounds; 2]) -> LimitTally {
    let (law, s) = (Normal::standard(), truth.variance().sqrt());
    let below = |limit: f64| law.cdf((limit - truth.mean) / s);
    let limits = found.and_then(|found| Some((found, two.of_mean(found)?, two.of_tests(found)?, one.of_tests(found)?)));
    let Some((found, mean, [lower, upper], [_, one_upper])) = limits else {
        return LimitTally { of: 1, unknown: 1, ..LimitTally::default() };
    };
    let half = law.inverse_cdf(0.5 * (1.0 + LIMITS.content)) * found.variance().sqrt();
    let holds = |lower: f64, upper: f64| u64::from(below(upper) - below(lower) >= LIMITS.content);
    LimitTally {
        of: 1,
        mean: u64::from(mean[0] <= truth.mean && truth.mean <= mean[1]),
        quantiles: holds(found.mean - half, found.mean + half),
        two: holds(lower, upper),
        one: u64::from(below(one_upper) >= LIMITS.content),
        unknown: 0,
    }
}
