//! Damaged input to the whole program: models, tables, exchange files and results, each damaged at random, run as a user runs them. No
//! run may end but with status 0, 1 or 2, say that it panicked, print what is no number, leave a file behind where nothing was written,
//! or take more processor time or memory than a file of its size is given.

mod corpus;
mod damage;
#[cfg(feature = "measure")]
mod fits;
#[cfg(feature = "measure")]
mod in_process;
mod run;
#[cfg(feature = "measure")]
mod targets;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::places;
use crate::places::MEASURE;
use corpus::FuzzCorpus;
use run::RunEnd;

/// Runs between two looks at the clock.
const ROUND: u64 = 200;
/// Wrong runs that are shown and kept.
const MOST_SHOWN: usize = 20;

/// What is asked of the task.
#[derive(Debug, clap::Args)]
pub(crate) struct FuzzOptions {
    /// Runs; without it and `--minutes` 20 000.
    #[arg(long)]
    runs: Option<u64>,
    /// As many runs as there is time for.
    #[arg(long, conflicts_with = "runs")]
    minutes: Option<f64>,
    /// Seed of the first run.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// What is asked of the task that works in this process.
#[cfg(feature = "measure")]
#[derive(Debug, clap::Args)]
pub(crate) struct InProcessOptions {
    /// Inputs; without it and `--minutes` 200 000.
    #[arg(long)]
    inputs: Option<u64>,
    /// As many inputs as there is time for.
    #[arg(long, conflicts_with = "inputs")]
    minutes: Option<f64>,
    /// Seed of the first input.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Runs of the steps of the test command.
const SHORT: u64 = 400;
/// Inputs of that step to the libraries.
const SHORT_IN_PROCESS: &str = "1000";

/// A short campaign for the test command.
pub(crate) fn short() -> Result<(), String> {
    campaign(&FuzzOptions { runs: Some(SHORT), minutes: None, seed: 1 })?;
    // in the program with the libraries, as the step of the tests has compiled them
    let build = ["build", "--quiet", "--workspace", "--locked", "--features", MEASURE, "--bin", "kalfit-dev"];
    let built = places::target()?.join("debug").join("kalfit-dev");
    passed(Command::new("cargo").args(build).env("CARGO_INCREMENTAL", "0").current_dir(places::root()))?;
    passed(Command::new(built).args(["fuzz-in-process", "--inputs", SHORT_IN_PROCESS]))
}

/// Runs a program, which must succeed.
fn passed(command: &mut Command) -> Result<(), String> {
    let status = command.status().map_err(|error| error.to_string())?;
    if status.success() { Ok(()) } else { Err(format!("{} ended with {status}", command.get_program().display())) }
}

/// Damages input to the libraries in this process, hundreds of times as fast as runs of the program.
#[cfg(feature = "measure")]
pub(crate) fn in_process(options: &InProcessOptions) -> ExitCode {
    let found = || {
        let (kalfit, kept) = places_of_a_campaign()?;
        let corpus = FuzzCorpus::new(&kalfit, &kept.join("corpus"))?;
        let (inputs, time) = asked(options.inputs, options.minutes, 200_000)?;
        in_process::campaign(&corpus, &kept, in_process::InProcessBounds { seed: options.seed, inputs, time })
    };
    ended(found())
}

/// Runs a campaign; what it found is printed, and kept where what cargo builds is.
pub(crate) fn run(options: &FuzzOptions) -> ExitCode {
    ended(campaign(options))
}

fn ended(found: Result<(), String>) -> ExitCode {
    match found {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

/// What came out of runs, added up.
#[derive(Default)]
struct RunTally {
    /// Runs by what was damaged and by exit status.
    by: BTreeMap<(&'static str, String), u64>,
    runs: u64,
    slowest: Duration,
    /// The most memory that a run used, in bytes.
    largest: u64,
    wrong: Vec<WrongRun>,
}

/// A run that ended as none may.
struct WrongRun {
    seed: u64,
    line: String,
    why: String,
    name: &'static str,
    bytes: Vec<u8>,
}

/// The program that is run, and where what was wrong is kept.
fn places_of_a_campaign() -> Result<(PathBuf, PathBuf), String> {
    let target = places::target()?;
    let profile = if cfg!(debug_assertions) { "debug" } else { "release" };
    let kalfit = places::kalfit(&target, profile);
    if !kalfit.exists() {
        let release = if cfg!(debug_assertions) { "" } else { " --release" };
        return Err(format!("{} is not built: cargo build{release}", kalfit.display()));
    }
    let kept = target.join("fuzz");
    std::fs::create_dir_all(&kept).map_err(|error| format!("{}: {error}", kept.display()))?;
    Ok((kalfit, kept))
}

/// How many, and for how long.
fn asked(count: Option<u64>, minutes: Option<f64>, usual: u64) -> Result<(u64, Duration), String> {
    Ok(match minutes {
        Some(minutes) => (u64::MAX, Duration::try_from_secs_f64(60.0 * minutes).map_err(|error| error.to_string())?),
        None => (count.unwrap_or(usual), Duration::MAX),
    })
}

fn campaign(options: &FuzzOptions) -> Result<(), String> {
    let (kalfit, kept) = places_of_a_campaign()?;
    let corpus = FuzzCorpus::new(&kalfit, &kept.join("corpus"))?;
    let begun = Instant::now();
    let (runs, limit) = asked(options.runs, options.minutes, 20_000)?;
    let mut all = RunTally::default();
    while all.runs < runs && begun.elapsed() < limit && all.wrong.len() < MOST_SHOWN {
        let first = options.seed.wrapping_add(all.runs);
        let round = ROUND.min(runs - all.runs);
        let found: Result<Vec<_>, String> =
            (0..round).into_par_iter().map(|k| one(&corpus, &kept, first.wrapping_add(k))).collect();
        found?.into_iter().for_each(|found| all.add(found));
    }
    all.report(begun.elapsed(), &kept)
}

/// One run.
struct FuzzRun {
    kind: &'static str,
    ended: RunEnd,
    seconds: Duration,
    memory: u64,
    wrong: Option<WrongRun>,
}

fn one(corpus: &FuzzCorpus, kept: &std::path::Path, seed: u64) -> Result<FuzzRun, String> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let subject = &corpus.subjects[random.random_range(0..corpus.subjects.len())];
    let bytes = damage::damaged(&mut random, &subject.bytes, subject.damage);
    let line = &subject.lines[random.random_range(0..subject.lines.len())];
    let folder = kept.join(format!("run-{seed}"));
    let done = run::run(corpus, subject, (line, &bytes), &folder)?;
    let why = done.wrong(&bytes);
    let (ended, seconds, memory) = (done.ended, done.seconds, done.memory);
    let wrong = why.map(|why| WrongRun { seed, line: line.join(" "), why, name: subject.name, bytes });
    Ok(FuzzRun { kind: subject.kind, ended, seconds, memory, wrong })
}

impl RunTally {
    fn add(&mut self, found: FuzzRun) {
        self.runs += 1;
        *self.by.entry((found.kind, found.ended.to_string())).or_default() += 1;
        self.slowest = self.slowest.max(found.seconds);
        self.largest = self.largest.max(found.memory);
        self.wrong.extend(found.wrong);
    }

    fn report(&self, time: Duration, kept: &std::path::Path) -> Result<(), String> {
        println!(
            "{} runs in {:.0} s, the slowest in {:.1} s, the largest with {} MB",
            self.runs,
            time.as_secs_f64(),
            self.slowest.as_secs_f64(),
            self.largest >> 20
        );
        for ((kind, ended), runs) in &self.by {
            println!("  {kind:<10} {ended:<10} {runs:>8}");
        }
        for wrong in &self.wrong {
            let place: PathBuf = kept.join(format!("{}-{}", wrong.seed, wrong.name));
            std::fs::write(&place, &wrong.bytes).map_err(|error| format!("{}: {error}", place.display()))?;
            println!(
                "\nseed {}: kalfit {}\n  {}\n  {}",
                wrong.seed,
                wrong.line,
                place.display(),
                wrong.why.replace('\n', "\n  ")
            );
        }
        if self.wrong.is_empty() { Ok(()) } else { Err(format!("{} runs ended as none may", self.wrong.len())) }
    }
}
