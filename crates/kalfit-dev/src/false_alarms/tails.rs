//! The tails of two figures of each test, the squares of its innovations and its distance from the population: at known parameters,
//! where both are χ² exactly, and at estimates from few tests.
//!
//! ```text
//! d_j²/N ~ Beta(p/2, (N-p-1)/2)        of tests that tell their states exactly, with μ and Σ estimated from N of them
//! ```

use kalfit::apply::Applied;
use kalfit::estimate::Silent;
use kalfit::infer::{Choices, DeletionChoice};
use kalfit::{Ensemble, Labels, Options};
use rayon::prelude::*;
use statrs::distribution::{Beta, ChiSquared, ContinuousCDF};

use super::simulated::{SimulatedModel, TestShape};
use crate::p_values::{LEVELS, PValueCount, head};
use crate::seed::SEED;

/// Tests of one draw.
const DRAW: u64 = 20_000;
/// Numbers of tests that estimates come from.
const FEW: [u64; 6] = [5, 10, 20, 50, 200, 1000];
/// So many tests in all for each of these numbers: a part of those at known parameters.
const PART: u64 = 10;
const STATES: usize = 2;
/// Tests have four to nine rows.
const SHAPE: TestShape = TestShape { rows: |k| 4 + k % 6, time: |_, row| 0.4 * row };

/// Both figures.
type TailCounts = [PValueCount; 2];

/// Simulates so many tests at known parameters and a tenth as many at estimates from few, and prints their tables.
pub(super) fn run(tests: u64) -> Result<(), String> {
    let simulated = SimulatedModel::new()?;
    println!(
        "\nShare of tests with a p-value below the nominal one, as a multiple of it, {tests} tests at known parameters and {} at \
         estimates from N tests each.\n",
        tests / PART
    );
    head("figure");
    let [size, distance] = known(&simulated, tests)?;
    size.row("size, parameters known");
    distance.row("distance, parameters known");
    for n in FEW {
        let [size, distance] = estimated(&simulated, n, (tests / PART).div_ceil(n))?;
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

/// By the population that the tests come from.
fn known(simulated: &SimulatedModel, tests: u64) -> Result<TailCounts, String> {
    let designs = simulated.designs(DRAW as usize, &SHAPE)?;
    let one = |k: u64| -> Result<TailCounts, String> {
        let tests = simulated.draw(&designs, SEED, k * DRAW..(k + 1) * DRAW)?;
        let applied = Applied::new(&simulated.model, &simulated.alpha, &simulated.population, &tests);
        let said = applied.and_then(|applied| applied.said()).map_err(|error| error.to_string())?;
        let mut counts = TailCounts::default();
        said.innovations.iter().for_each(|found| {
            counts[0].take(found.as_ref().and_then(|found| found.summary.p_value(0)));
        });
        said.posteriors.iter().for_each(|posterior| counts[1].take(posterior.distance.p_value));
        Ok(counts)
    };
    sum((0..tests.div_ceil(DRAW)).map(one))
}

/// By estimates from the n tests themselves, of so many ensembles.
fn estimated(simulated: &SimulatedModel, n: u64, ensembles: u64) -> Result<TailCounts, String> {
    let designs = simulated.designs(n as usize, &SHAPE)?;
    let choices = Choices { deletion: DeletionChoice::None, ..Choices::default() };
    let options = Options { choices, ..Options::default() };
    let one = |k: u64| -> Result<TailCounts, String> {
        let tests = simulated.draw(&designs, SEED, k * n..(k + 1) * n)?;
        let ensemble = Ensemble::of_tests(&simulated.model, Labels::default(), tests);
        let fit = ensemble.fit_with(&options, &mut Silent).map_err(|error| error.to_string())?;
        let mut counts = TailCounts::default();
        for test in fit.record.tests.iter() {
            counts[0].take(test.innovations.as_ref().and_then(|found| found.nis_p_value));
            counts[1].take(test.p_value);
        }
        Ok(counts)
    };
    let all: Vec<Result<TailCounts, String>> = (0..ensembles).into_par_iter().map(one).collect();
    sum(all.into_iter())
}

fn sum(mut all: impl Iterator<Item = Result<TailCounts, String>>) -> Result<TailCounts, String> {
    all.try_fold(TailCounts::default(), |sum, one| one.map(|one| [sum[0].with(one[0]), sum[1].with(one[1])]))
}
