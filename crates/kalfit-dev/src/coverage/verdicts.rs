//! How often `kalfit apply` accuses new tests that are of the population that was fitted.

use kalfit::apply::{Applied, Laws, Trust, Verdict};
use kalfit::{Ensemble, Labels};
use rayon::prelude::*;

use super::drawn::{DrawnSetup, LINE, NOISY, UNITS, WALK, values};
use crate::seed::SEED;

/// Share of the batches that may be accused.
const LEVEL: f64 = 0.05;
/// Tests of a batch, or its units.
const BATCH: usize = 20;
/// Tests that are fitted, or units.
const FITTED: [usize; 3] = [10, 20, 50];

/// What is drawn.
struct VerdictSetup {
    title: &'static str,
    drawn: DrawnSetup,
}

const CUBIC: &str = r#"
[data]
test = "test"
[states]
a = {}
b = {}
c = {}
d = {}
[measurements.y]
column = "y"
equation = "a + b * x + c * (2 * x^2 - 1) + d * (4 * x^3 - 3 * x)"
noise = "sigma"
[parameters]
sigma = 0.3
"#;

const SETUPS: [VerdictSetup; 5] = [
    VerdictSetup { title: "random lines of 10 rows", drawn: DrawnSetup { units: 0, tests: 1, ..LINE } },
    VerdictSetup {
        title: "cubics of 8 rows, four states",
        drawn: DrawnSetup {
            model: CUBIC,
            free: "sigma",
            units: 0,
            tests: 1,
            rows: &[-1.0, -0.9, -0.6, -0.2, 0.2, 0.6, 0.9, 1.0],
            mean: &[1.0, 0.0, 0.0, 0.0],
            std_dev: &[&[1.0, 1.0, 1.0, 1.0]],
            restricted: false,
        },
    },
    VerdictSetup {
        title: "levels determined with an error as large as their spread, 12 rows",
        drawn: DrawnSetup { units: 0, tests: 1, ..NOISY },
    },
    VerdictSetup {
        title: "random walks of 8 rows from a random level, density and noise free",
        drawn: DrawnSetup { units: 0, tests: 1, rows: &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0], ..WALK },
    },
    VerdictSetup { title: "units of 3 tests of 4 rows", drawn: DrawnSetup { units: 0, ..UNITS } },
];

/// How often a law accuses: distances, tests within units, residuals, some test by itself.
type AccusedCounts = [u64; 4];

#[derive(Debug, Default, Clone, Copy)]
struct VerdictTally {
    of: u64,
    /// By the law that allows for estimation, and by chi-squared.
    accused: [AccusedCounts; 2],
}

/// Runs the set-ups whose title holds `only` and prints their table.
pub(super) fn run(ensembles: u64, only: &str) {
    let chosen: Vec<&VerdictSetup> =
        SETUPS.iter().filter(|setup| "Verdicts".contains(only) || setup.title.contains(only)).collect();
    if chosen.is_empty() {
        return;
    }
    println!(
        "Verdicts: {ensembles} ensembles, and a batch of {BATCH} more tests, or units, of the same population; accused at 5 %\n"
    );
    println!(
        "| set-up | fitted | distances | by chi-squared | within units | by chi-squared | residuals | by chi-squared | some test | by chi-squared |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for setup in chosen {
        for fitted in FITTED {
            let VerdictTally { of, accused } = setup.tally(fitted, ensembles);
            let has_units = setup.drawn.tests > 1;
            let cell = |what: usize, law: usize| match (what, has_units) {
                (1, false) => "-".to_owned(),
                _ => format!("{:.1} %", 100.0 * accused[law][what] as f64 / of.max(1) as f64),
            };
            let cells: Vec<String> = (0..4).flat_map(|what| [cell(what, 0), cell(what, 1)]).collect();
            println!("| {} | {fitted} | {} |", setup.title, cells.join(" | "));
        }
    }
    println!();
}

impl VerdictSetup {
    fn tally(&self, fitted: usize, ensembles: u64) -> VerdictTally {
        let [old, new] = [fitted, BATCH].map(|units| DrawnSetup { units, ..self.drawn });
        let [known, free] = [false, true].map(|is_free| old.spec(is_free));
        let alpha = kalfit::Alpha::fixed(&known.model.shared().parameters).expect("the truth is known");
        let [design, batch] = [old.design(&known), new.design(&known)];
        let draw = |design: &Ensemble, seed: u64| {
            let number = design.tests().len() as u64;
            design.draw(&alpha, old.population(), number, seed).expect("a set-up is sound")
        };
        let one = |k: u64| {
            let record = old.fit(&free, &draw(&design, SEED + 2 * k));
            if !record.converged {
                return VerdictTally::default();
            }
            let population = record.population(&known.model).expect("it is of this model");
            let (values, knowledge) = (values(&known, &record), record.knowledge(&known.model).expect("few numbers"));
            let drawn = draw(&batch, SEED + 2 * k + 1);
            let tests = Ensemble::of_tests(&known.model, Labels::clone(drawn.labels()), drawn.tests().to_vec());
            let applied = Applied::new(&known.model, &values, &population, tests.tests()).expect("it applies");
            let said = applied.said().expect("it applies");
            let laws = applied.laws(&said, &Trust::Estimates(&knowledge)).expect("it applies");
            let accused = [laws, Laws::known(&said)].map(|laws| accused(&said, &laws));
            VerdictTally { of: 1, accused }
        };
        (0..ensembles).into_par_iter().map(one).reduce(VerdictTally::default, |a, b| VerdictTally {
            of: a.of + b.of,
            accused: std::array::from_fn(|law| std::array::from_fn(|what| a.accused[law][what] + b.accused[law][what])),
        })
    }
}

fn accused(said: &kalfit::apply::Said, laws: &Laws) -> AccusedCounts {
    let Verdict { distance, within, residual, .. } = said.verdict(laws);
    let below = |p: Option<f64>| u64::from(p.is_some_and(|p| p < LEVEL));
    let one = |(law, test): (&Option<kalfit::apply::Law>, kalfit::infer::Posterior<'_>)| {
        law.and_then(|law| law.tails(test.distance.squared)).map(|tails| tails[1])
    };
    let least = laws.tests.iter().zip(said.posteriors.iter()).filter_map(one).fold(1.0, f64::min);
    let some = u64::from(least < LEVEL / said.posteriors.len() as f64);
    [below(distance.p_value), below(within.and_then(|within| within.p_value)), below(residual.p_value), some]
}
