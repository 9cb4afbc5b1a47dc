//! The tails of two figures of each test, the squares of its innovations and its distance from the population: at known parameters,
//! where both are χ² exactly, and at estimates from few tests.
//!
//! ```text
//! d_j²/N ~ Beta(p/2, (N-p-1)/2)        of tests that tell their states exactly, with μ and Σ estimated from N of them
//! ```

use kalfit::apply::Applied;
use kalfit::estimate::Silent;
use kalfit::infer::{Choices, DeletionChoice};
use kalfit::simulate::{Designs, Simulator};
use kalfit::{Alpha, Ensemble, Label, Labels, Options, PhasedModel, PhasedTest, Population, Source, Test};
use nalgebra::DMatrix;
use rayon::prelude::*;
use statrs::distribution::{Beta, ChiSquared, ContinuousCDF};

use super::{LEVELS, SEED, multiples, parsed};

/// Tests of one draw.
const DRAW: u64 = 20_000;
/// Numbers of tests that estimates come from.
const FEW: [u64; 6] = [5, 10, 20, 50, 200, 1000];
/// So many tests in all for each of these numbers: a part of those at known parameters.
const PART: u64 = 10;
const STATES: usize = 2;

/// How many p-values there are, and below each level.
#[derive(Default, Clone, Copy)]
struct Count {
    all: u64,
    below: [u64; LEVELS.len()],
}

impl Count {
    fn take(&mut self, p: Option<f64>) {
        let Some(p) = p else { return };
        self.all += 1;
        self.below.iter_mut().zip(LEVELS).filter(|(_, level)| p < *level).for_each(|(n, _)| *n += 1);
    }

    fn with(self, other: Count) -> Count {
        Count { all: self.all + other.all, below: std::array::from_fn(|k| self.below[k] + other.below[k]) }
    }

    fn row(&self, name: &str) {
        println!("| {name} | {} |", multiples(self.all, &self.below));
    }
}

/// Both figures.
type Counts = [Count; 2];

/// A population and tests of two to seven rows drawn from it.
struct Drawing {
    model: PhasedModel,
    alpha: Alpha,
    population: Population,
}

/// Simulates so many tests at known parameters and a tenth as many at estimates from few, and prints their tables.
pub(super) fn run(tests: u64) -> Result<(), String> {
    let drawing = Drawing::new()?;
    println!(
        "\nShare of tests with a p-value below the nominal one, as a multiple of it, {tests} tests at known parameters and {} at \
         estimates from N tests each.\n",
        tests / PART
    );
    println!("| figure | {} |", LEVELS.map(|p| format!("{p:e}")).join(" | "));
    println!("|---{}|", "|---".repeat(LEVELS.len()));
    let [size, distance] = drawing.known(tests)?;
    size.row("size, parameters known");
    distance.row("distance, parameters known");
    for n in FEW {
        let [size, distance] = drawing.estimated(n, (tests / PART).div_ceil(n))?;
        size.row(&format!("size, N = {n}"));
        distance.row(&format!("distance, N = {n}"));
        let exact = LEVELS.map(|level| format!("{:.2}", exactly(n, level) / level));
        println!("| exact, states determined exactly | {} |", exact.join(" | "));
    }
    Ok(())
}

/// The probability that a distance at estimates from n tests that tell their states exactly has a p-value below this.
fn exactly(n: u64, level: f64) -> f64 {
    let (p, n) = (STATES as f64, n as f64);
    let quantile = ChiSquared::new(p).map_or(f64::NAN, |chi| chi.inverse_cdf(1.0 - level));
    let law = Beta::new(p / 2.0, (n - p - 1.0) / 2.0);
    law.map_or(f64::NAN, |law| if quantile < n { law.sf(quantile / n) } else { 0.0 })
}

impl Drawing {
    fn new() -> Result<Drawing, String> {
        let model = parsed()?;
        let alpha = Alpha::fixed(&model.shared().parameters).map_err(|error| error.to_string())?;
        let population = Population {
            mean: vec![0.5, 40.0],
            coefficients: vec![],
            covariance: DMatrix::from_row_slice(2, 2, &[0.64, -8.0, -8.0, 625.0]),
        };
        Ok(Drawing { model, alpha, population })
    }

    fn designs(&self, count: u64) -> Result<Designs, String> {
        let tests = (0..count as usize).map(|k| design(&self.model, k)).collect();
        Designs::new(tests).map_err(|error| error.to_string())
    }

    /// Draw number k of so many designs.
    fn draw(&self, (designs, count): (&Designs, u64), k: u64) -> Result<Vec<PhasedTest>, String> {
        let simulator = Simulator::new(&self.model, &self.alpha, self.population.clone(), SEED)
            .map_err(|error| error.to_string())?;
        let drawn = simulator.draw(designs, k * count..(k + 1) * count).map_err(|error| error.to_string())?;
        Ok(drawn.into_iter().map(|drawn| drawn.test).collect())
    }

    /// By the population that the tests come from.
    fn known(&self, tests: u64) -> Result<Counts, String> {
        let designs = self.designs(DRAW)?;
        let one = |k: u64| -> Result<Counts, String> {
            let tests = self.draw((&designs, DRAW), k)?;
            let applied = Applied::new(&self.model, &self.alpha, &self.population, &tests);
            let said = applied.and_then(|applied| applied.said()).map_err(|error| error.to_string())?;
            let mut counts = Counts::default();
            said.innovations.iter().for_each(|found| {
                counts[0].take(found.as_ref().and_then(|found| found.summary.p_value(0)));
            });
            said.posteriors.iter().for_each(|posterior| counts[1].take(posterior.distance.p_value));
            Ok(counts)
        };
        sum((0..tests.div_ceil(DRAW)).map(one))
    }

    /// By estimates from the n tests themselves, of so many ensembles.
    fn estimated(&self, n: u64, ensembles: u64) -> Result<Counts, String> {
        let designs = self.designs(n)?;
        let choices = Choices { deletion: DeletionChoice::None, ..Choices::default() };
        let options = Options { choices, ..Options::default() };
        let one = |k: u64| -> Result<Counts, String> {
            let ensemble = Ensemble::of_tests(&self.model, Labels::default(), self.draw((&designs, n), k)?);
            let fit = ensemble.fit_with(&options, &mut Silent).map_err(|error| error.to_string())?;
            let mut counts = Counts::default();
            for test in &fit.record.tests {
                counts[0].take(test.innovations.as_ref().and_then(|found| found.nis_p_value));
                counts[1].take(test.p_value);
            }
            Ok(counts)
        };
        let all: Vec<Result<Counts, String>> = (0..ensembles).into_par_iter().map(one).collect();
        sum(all.into_iter())
    }
}

fn sum(mut all: impl Iterator<Item = Result<Counts, String>>) -> Result<Counts, String> {
    all.try_fold(Counts::default(), |sum, one| one.map(|one| [sum[0].with(one[0]), sum[1].with(one[1])]))
}

/// Test number k: four to nine rows, turned so that both states are told.
fn design(model: &PhasedModel, k: usize) -> PhasedTest {
    let columns = &model.shared().columns;
    let mut test = Test::new(format!("t{k:05}"), columns.len(), 0);
    for row in 0..4 + k % 6 {
        let cell = |name: &str| match name {
            "t" => 0.4 * row as f64,
            "turn" => 0.02 * ((row % 3) as f64 - 0.7),
            _ => 0.0,
        };
        let cells: Vec<f64> = columns.iter().map(|column| cell(&column.name)).collect();
        test.push(&cells, &[] as &[Label], Source::default());
    }
    test.into()
}
