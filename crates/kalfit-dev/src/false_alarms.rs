//! How often the checks of a fit accuse a model that is right: the tails of the whiteness test, of the size of innovations and of
//! distances by plain simulation, and whole ensembles drawn from a model and fitted with it.

mod tails;

use std::process::ExitCode;

use kalfit::infer::{Choices, DeletionChoice};
use kalfit::innovations::Whiteness;
use kalfit::record::FitRecord;
use kalfit::simulate::{Designs, Simulator};
use kalfit::{Alpha, Ensemble, Label, Labels, Model, PhasedModel, Population, Source, Test, estimate};
use kalfit_spec::Spec;
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;

const SEED: u64 = 1980;
/// Numbers of series.
const LENGTHS: [usize; 8] = [7, 12, 20, 33, 57, 90, 250, 1500];
/// Nominal probabilities.
const LEVELS: [f64; 6] = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6];
/// Numbers of one stream of random numbers.
const BLOCK: usize = 1_000_000;
/// Tests of an ensemble.
const TESTS: usize = 20_000;
/// What an ensemble is accused of by searches at 5 %.
const SEARCHES: [&str; 2] = ["innovations", "distance"];
/// Of searches at 5 %, beyond sampling error and terms of order 1/N.
const MOST: f64 = 0.065;

const MODEL: &str = r#"
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
"#;

/// What is asked of the task.
#[derive(Debug, clap::Args)]
pub(crate) struct Options {
    /// Random numbers for each length of series; none are simulated with 0.
    #[arg(long, default_value_t = 1_000_000_000)]
    numbers: u64,
    /// Tests at known parameters, for the tails of sizes and distances; none are simulated with 0.
    #[arg(long, default_value_t = 20_000_000)]
    tests: u64,
    /// Ensembles of 20 000 tests; none are simulated with 0.
    #[arg(long, default_value_t = 200)]
    ensembles: u64,
}

/// Simulates what is asked for; fails when a search accuses too often.
pub(crate) fn run(options: &Options) -> ExitCode {
    if options.numbers > 0 {
        whiteness_table(options.numbers);
    }
    let tails = if options.tests > 0 { tails::run(options.tests) } else { Ok(()) };
    match tails.and_then(|()| whole(options.ensembles)) {
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
    println!("| length | {} |", LEVELS.map(|p| format!("{p:e}")).join(" | "));
    println!("|---{}|", "|---".repeat(LEVELS.len()));
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

/// Counts below each level as multiples of what they should be; none where that is too few to tell.
fn multiples(all: u64, below: &[u64; LEVELS.len()]) -> String {
    let cell = |k: usize| match LEVELS[k] * all as f64 {
        few if few < 3.0 => "-".to_owned(),
        expected => format!("{:.2}", below[k] as f64 / expected),
    };
    (0..LEVELS.len()).map(cell).collect::<Vec<_>>().join(" | ")
}

fn parsed() -> Result<PhasedModel, String> {
    Ok(Spec::parse("model", MODEL).map_err(|error| error.to_string())?.model)
}

/// How many of these series of n numbers have a p-value below each level.
fn whiteness(n: usize, draws: usize) -> [f64; LEVELS.len()] {
    let of_block = BLOCK / n;
    let block = |block: usize| {
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        rng.set_stream((n as u64) << 32 | block as u64);
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
struct Tally {
    /// p-values of size, whiteness and distance below each level.
    below: [[u64; LEVELS.len()]; 3],
    /// Number of p-values.
    all: [u64; 3],
    /// Ensembles accused by each of the searches, for the mean square of all innovations, and for anything.
    accused: [u64; 4],
}

fn tally(ensembles: u64) -> Result<Tally, String> {
    let model = parsed()?;
    let mut tally = Tally::default();
    let shared = model.shared();
    let alpha = Alpha::fixed(&shared.parameters).map_err(|error| error.to_string())?;
    let designs =
        Designs::new((0..TESTS).map(|k| design(shared, k).into()).collect()).map_err(|error| error.to_string())?;
    let population = Population {
        mean: vec![0.5, 40.0],
        coefficients: vec![],
        covariance: DMatrix::from_row_slice(2, 2, &[0.64, -8.0, -8.0, 625.0]),
    };
    let choices = Choices { deletion: DeletionChoice::None, ..Choices::default() };
    let options = kalfit::Options { choices, ..kalfit::Options::default() };
    for k in 0..ensembles {
        let simulator =
            Simulator::new(&model, &alpha, population.clone(), SEED + k).map_err(|error| error.to_string())?;
        let drawn = simulator.draw(&designs, 0..TESTS as u64).map_err(|error| error.to_string())?;
        let tests = drawn.into_iter().map(|drawn| drawn.test).collect();
        let ensemble = Ensemble::of_tests(&model, Labels::default(), tests);
        let fit = ensemble.fit_with(&options, &mut estimate::Silent).map_err(|error| error.to_string())?;
        tally.add(&fit.record);
    }
    Ok(tally)
}

/// Test number k: 20 to 100 rows, some of which turn.
fn design(model: &Model, k: usize) -> Test {
    let mut test = Test::new(format!("t{k:05}"), model.columns.len(), 0);
    for row in 0..20 + (37 * k) % 81 {
        let cell = |name: &str| match name {
            "t" => 0.05 * row as f64 * (1.0 + (k % 3) as f64),
            "turn" => 0.02 * ((row % 3) as f64 - 0.7),
            _ => 0.0,
        };
        let cells: Vec<f64> = model.columns.iter().map(|column| cell(&column.name)).collect();
        test.push(&cells, &[] as &[Label], Source::default());
    }
    test
}

impl Tally {
    fn add(&mut self, record: &FitRecord) {
        for test in &record.tests {
            let figures = test.innovations.as_ref();
            let white = figures.and_then(|found| Some(found.whiteness.as_ref()?.p_value));
            for (which, p) in [figures.and_then(|found| found.nis_p_value), white, test.p_value].into_iter().enumerate()
            {
                let Some(p) = p else { continue };
                self.all[which] += 1;
                self.below[which].iter_mut().zip(LEVELS).filter(|(_, level)| p < *level).for_each(|(n, _)| *n += 1);
            }
        }
        let findings = record.model_check.iter().flat_map(|check| &check.findings);
        let kinds: Vec<&str> = findings.map(|finding| finding.kind.as_str()).collect();
        let [innovations, distance] = SEARCHES.map(|kind| kinds.contains(&kind));
        let found = [innovations, distance, kinds.contains(&"mean_square"), !kinds.is_empty()];
        self.accused.iter_mut().zip(found).for_each(|(count, found)| *count += u64::from(found));
    }

    fn show(&self, ensembles: u64) -> ExitCode {
        println!("| p-values | {} |", LEVELS.map(|p| format!("{p:e}")).join(" | "));
        println!("|---{}|", "|---".repeat(LEVELS.len()));
        for (which, name) in ["size", "whiteness", "distance"].iter().enumerate() {
            println!("| {name} | {} |", multiples(self.all[which], &self.below[which]));
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
