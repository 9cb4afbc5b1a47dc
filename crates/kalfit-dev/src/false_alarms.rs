//! How often the checks of a fit accuse a model that is right: the tails of the whiteness test, of the size of innovations and of
//! distances by plain simulation, and whole ensembles drawn from a model and fitted with it.

mod constraints;
mod simulated;
mod tails;

use std::process::ExitCode;

use kalfit::infer::{Choices, DeletionChoice};
use kalfit::innovations::Whiteness;
use kalfit::record::FitRecord;
use kalfit::{Ensemble, Labels, estimate};
use rand::RngExt;
use rand_distr::StandardNormal;
use rayon::prelude::*;

use self::simulated::{SimulatedModel, TestShape};
use crate::p_values::{LEVELS, PValueCount, head};
use crate::seed::{SEED, random_of_block};

/// Numbers of series.
const LENGTHS: [usize; 8] = [7, 12, 20, 33, 57, 90, 250, 1500];
/// Numbers of one stream of random numbers.
const BLOCK: usize = 1_000_000;
/// Tests of an ensemble.
const TESTS: usize = 20_000;
/// They have 20 to 100 rows.
const SHAPE: TestShape = TestShape { rows: |k| 20 + (37 * k) % 81, time: |k, row| 0.05 * row * (1.0 + (k % 3) as f64) };
/// What an ensemble is accused of by searches at 5 %.
const SEARCHES: [&str; 2] = ["innovations", "distance"];
/// Of searches at 5 %, beyond sampling error and terms of order 1/N.
const MOST: f64 = 0.065;

/// What is asked of the task.
#[derive(Debug, clap::Args)]
pub(crate) struct FalseAlarmOptions {
    /// Random numbers for each length of series; none are simulated with 0.
    #[arg(long, default_value_t = 1_000_000_000)]
    numbers: u64,
    /// Tests at known parameters, for the tails of sizes and distances; none are simulated with 0.
    #[arg(long, default_value_t = 20_000_000)]
    tests: u64,
    /// Ensembles of 20 000 tests; none are simulated with 0.
    #[arg(long, default_value_t = 200)]
    ensembles: u64,
    /// Ensembles of 8, 24 and 100 tests, for the tests of constraints; none are simulated with 0.
    #[arg(long, default_value_t = 20_000)]
    constrained: u64,
}

/// Simulates what is asked for; fails when a search accuses too often.
pub(crate) fn run(options: &FalseAlarmOptions) -> ExitCode {
    if options.numbers > 0 {
        whiteness_table(options.numbers);
    }
    let tails = if options.tests > 0 { tails::run(options.tests) } else { Ok(()) };
    let few = || if options.constrained > 0 { constraints::run(options.constrained) } else { Ok(()) };
    match tails.and_then(|()| few()).and_then(|()| whole(options.ensembles)) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn whiteness_table(numbers: u64) {
    println!(
        "Whiteness: share of series with a p-value below the nominal one, as a multiple of it, {numbers} numbers of each length.\n"
    );
    head("length");
    for n in LENGTHS {
        let draws = numbers as usize / n;
        let below = LEVELS.map(|level| level * draws as f64);
        let found = whiteness(n, draws);
        let cell = |k: usize| if below[k] < 10.0 { "-".to_owned() } else { format!("{:.2}", found[k] / below[k]) };
        println!("| {n} | {} |", (0..LEVELS.len()).map(cell).collect::<Vec<_>>().join(" | "));
    }
}

/// Whole ensembles, fitted.
fn whole(ensembles: u64) -> Result<ExitCode, String> {
    if ensembles == 0 {
        return Ok(ExitCode::SUCCESS);
    }
    println!(
        "\n{ensembles} ensembles of {TESTS} tests of 20 to 100 measurements, each fitted with the model it comes from.\n"
    );
    Ok(tally(ensembles)?.show(ensembles))
}

/// How many of these series of n numbers have a p-value below each level.
fn whiteness(n: usize, draws: usize) -> [f64; LEVELS.len()] {
    let of_block = BLOCK / n;
    let block = |block: usize| {
        let mut rng = random_of_block(n, block);
        let mut z = vec![0.0; n];
        let mut below = [0.0; LEVELS.len()];
        for _ in 0..of_block.min(draws - block * of_block) {
            z.iter_mut().for_each(|x| *x = rng.sample(StandardNormal));
            let found = Whiteness::of(std::iter::once(&z[..])).map_or(1.0, |found| found.p_value);
            below.iter_mut().zip(LEVELS).filter(|(_, level)| found < *level).for_each(|(count, _)| *count += 1.0);
        }
        below
    };
    let sum = |a: [f64; LEVELS.len()], b: [f64; LEVELS.len()]| std::array::from_fn(|k| a[k] + b[k]);
    (0..draws.div_ceil(of_block)).into_par_iter().map(block).reduce(|| [0.0; LEVELS.len()], sum)
}

/// What was found in ensembles.
#[derive(Default)]
struct FalseAlarmTally {
    /// p-values of size, whiteness and distance.
    counts: [PValueCount; 3],
    /// Ensembles accused by each of the searches, for the mean square of all innovations, and for anything.
    accused: [u64; 4],
}

fn tally(ensembles: u64) -> Result<FalseAlarmTally, String> {
    let simulated = SimulatedModel::new()?;
    let designs = simulated.designs(TESTS, &SHAPE)?;
    let mut tally = FalseAlarmTally::default();
    let choices = Choices { deletion: DeletionChoice::None, ..Choices::default() };
    let options = kalfit::Options { choices, ..kalfit::Options::default() };
    for k in 0..ensembles {
        let tests = simulated.draw(&designs, SEED + k, 0..TESTS as u64)?;
        let ensemble = Ensemble::of_tests(&simulated.model, Labels::default(), tests);
        let fit = ensemble.fit_with(&options, &mut estimate::Silent).map_err(|error| error.to_string())?;
        tally.add(&fit.record);
    }
    Ok(tally)
}

impl FalseAlarmTally {
    fn add(&mut self, record: &FitRecord) {
        for test in record.tests.iter() {
            let figures = test.innovations.as_ref();
            let white = figures.and_then(|found| Some(found.whiteness.as_ref()?.p_value));
            let found = [figures.and_then(|found| found.nis_p_value), white, test.p_value];
            self.counts.iter_mut().zip(found).for_each(|(count, p)| count.take(p));
        }
        let findings = record.model_check.iter().flat_map(|check| &check.findings);
        let kinds: Vec<&str> = findings.map(|finding| finding.kind.as_str()).collect();
        let [innovations, distance] = SEARCHES.map(|kind| kinds.contains(&kind));
        let found = [innovations, distance, kinds.contains(&"mean_square"), !kinds.is_empty()];
        self.accused.iter_mut().zip(found).for_each(|(count, found)| *count += u64::from(found));
    }

    fn show(&self, ensembles: u64) -> ExitCode {
        head("p-values");
        for (name, count) in ["size", "whiteness", "distance"].iter().zip(self.counts) {
            count.row(name);
        }
        println!("\n| accused by | share of ensembles |\n|---|---|");
        let names = ["innovations (Holm)", "distances (Bonferroni)", "mean square of all", "anything"];
        for (name, count) in names.iter().zip(self.accused) {
            println!("| {name} | {:.1} % |", 100.0 * count as f64 / ensembles as f64);
        }
        // three sampling errors
        let most = MOST + 3.0 * (MOST / ensembles as f64).sqrt();
        let sound = self.accused[..2].iter().all(|count| *count as f64 <= most * ensembles as f64);
        if sound { ExitCode::SUCCESS } else { ExitCode::FAILURE }
    }
}
