//! Whole fits against other programs: the answers are compared first, then the times, all in one run.
//!
//! Times are processor times, kalfit by one thread and the peers by one, so that other work on the machine changes them little. A
//! peer's time is that of its fit alone, kalfit's that of the whole process from the data file to the file of results. Nothing is installed.

mod agreement;
mod answer;
mod clock;
mod ensemble;
mod peer;
mod space;
mod stages;
mod table;
mod whole;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use agreement::{Agreement, Ours};
use answer::Answer;
use ensemble::Study;
use peer::{Interpreters, Outcome, Peer};
use space::Space;
use table::{figure, head, row, seconds};
use whole::Kalfit;

const SEED: u64 = 1980;

/// Fits of one ensemble by several peers. What a peer cannot do in about a minute it is not asked.
const FITS: &[(Study, usize, &[Peer])] = &[
    (Study::Regression, 1_000, &[peer::LME4, peer::NLME, peer::STATSMODELS, peer::OPENMX]),
    (Study::Regression, 10_000, &[peer::LME4, peer::NLME, peer::STATSMODELS, peer::OPENMX]),
    (Study::Regression, 100_000, &[peer::LME4]),
    (Study::Meta, 200, &[peer::METAFOR_DENSE, peer::METAFOR_SPARSE]),
    (Study::Meta, 400, &[peer::METAFOR_DENSE]),
    (Study::Meta, 1_000, &[peer::METAFOR_SPARSE]),
];

/// Values of the likelihood of ensembles, with one design for all tests or not.
const VALUES: &[(Peer, usize, bool)] = &[
    (peer::DYNAMAX, 2_000, false),
    (peer::DYNAMAX, 2_000, true),
    (peer::PYKALMAN, 50, false),
    (peer::PYKALMAN, 50, true),
];

/// What the task is told.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Options {
    /// Run in this process; without it the task is first built as it is released.
    #[arg(long)]
    here: bool,
    /// kalfit's command; without it, it is built as it is released.
    #[arg(long, value_name = "KALFIT")]
    command: Option<PathBuf>,
    /// Python in whose environment the peers are.
    #[arg(long, value_name = "PYTHON", default_value = "python3")]
    python: String,
    /// R's program for scripts.
    #[arg(long, value_name = "RSCRIPT", default_value = "Rscript")]
    rscript: String,
    /// Only the parts whose name contains this: `fits`, `values`, `stages`.
    #[arg(long)]
    only: Option<String>,
}

/// Where the models and the peers' scripts are.
fn scripts() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("peers")
}

/// Runs the task, in a released build.
pub(crate) fn run(options: &Options) -> ExitCode {
    let done = if options.here { here(options) } else { build_and_run(options) };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => {
            eprintln!("{why}");
            ExitCode::FAILURE
        }
    }
}

fn cargo(arguments: &[&str]) -> Result<(), String> {
    match Command::new("cargo").args(arguments).status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("cargo {}: {status}", arguments.join(" "))),
        Err(error) => Err(format!("cargo: {error}")),
    }
}

fn build_and_run(options: &Options) -> Result<(), String> {
    let build = ["--quiet", "--release", "--locked", "--package"];
    let command = match &options.command {
        Some(command) => command.clone(),
        None => {
            cargo(&[&["build"], &build[..], &["kalfit-cli"]].concat())?;
            // this program lies in `target/debug`, wherever that is
            let program = std::env::current_exe().map_err(|error| error.to_string())?;
            let target = program.ancestors().nth(2).ok_or("the program has no folder")?;
            target.join("release").join(format!("kalfit{}", std::env::consts::EXE_SUFFIX))
        }
    };
    let command = whole::path(&command)?;
    let mut arguments = [&["run"], &build[..], &["kalfit-dev", "--", "peers", "--here"]].concat();
    arguments.extend(["--command", command, "--python", &options.python, "--rscript", &options.rscript]);
    if let Some(only) = &options.only {
        arguments.extend(["--only", only]);
    }
    cargo(&arguments)
}

fn here(options: &Options) -> Result<(), String> {
    // one core against one core
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().map_err(|error| error.to_string())?;
    let command = options.command.clone().ok_or("`--here` takes kalfit's command from `--command`")?;
    let command = command.canonicalize().map_err(|error| format!("{}: {error}", command.display()))?;
    let folder = std::env::temp_dir().join(format!("kalfit-peers-{}", std::process::id()));
    std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let kalfit = Kalfit { command, folder };
    let interpreters = Interpreters { rscript: options.rscript.clone(), python: options.python.clone() };
    let done = parts(&kalfit, &interpreters, options.only.as_deref().unwrap_or_default());
    let removed = std::fs::remove_dir_all(&kalfit.folder);
    done?;
    removed.map_err(|error| format!("{}: {error}", kalfit.folder.display()))
}

fn parts(kalfit: &Kalfit, interpreters: &Interpreters, only: &str) -> Result<(), String> {
    let mut missing = Vec::new();
    if "fits".contains(only) {
        head(
            2,
            &[
                "peer",
                "model",
                "tests",
                "rows",
                "its fit alone",
                "kalfit, CSV to fit.json",
                "ratio",
                "kalfit, from Parquet",
                "ratio",
                "Δ log-likelihood",
                "Δ estimates, s.e.",
            ],
        );
        for (study, tests, peers) in FITS {
            missing.extend(fits(kalfit, interpreters, *study, *tests, peers)?);
        }
        println!();
    }
    if "values".contains(only) {
        head(2, &["peer", "designs", "tests", "rows", "its value", "kalfit", "ratio", "Δ log-likelihood"]);
        for (peer, tests, shared) in VALUES {
            missing.extend(value(kalfit, interpreters, peer, *tests, *shared)?);
        }
        println!();
    }
    if "stages".contains(only) {
        stages::print(kalfit)?;
    }
    missing.dedup();
    for peer in missing {
        println!("{} is missing: {}", peer.name, peer.install);
    }
    Ok(())
}

/// Prints a row for each peer; the peers that are missing.
fn fits(
    kalfit: &Kalfit,
    interpreters: &Interpreters,
    study: Study,
    tests: usize,
    peers: &[Peer],
) -> Result<Vec<Peer>, String> {
    let [csv, parquet] = study.draw(tests, kalfit)?;
    let model = study.model();
    let model = whole::path(&model)?;
    let from_parquet = kalfit.fit(model, &parquet)?;
    let from_csv = kalfit.fit(model, &csv)?;
    let ours = Ours::of(&kalfit.record()?)?;
    let mut missing = Vec::new();
    for peer in peers {
        let Some((answer, agreement)) = compared(peer, interpreters, &csv, &ours)? else {
            missing.push(*peer);
            continue;
        };
        let words = [peer_name(peer, &answer), study.name().to_owned(), tests.to_string()];
        let theirs = answer.taken.processor;
        let times =
            [from_csv, from_parquet].map(|taken| [seconds(taken.processor), figure(theirs / taken.processor)]).concat();
        let rows = (tests * study.rows()).to_string();
        let apart = [figure(agreement.log_likelihood), figure(agreement.estimates)];
        row(&[&words[..], &[rows, seconds(theirs)], &times, &apart].concat());
    }
    Ok(missing)
}

/// Prints a row; the peer, if it is missing.
fn value(
    kalfit: &Kalfit,
    interpreters: &Interpreters,
    peer: &Peer,
    tests: usize,
    shared: bool,
) -> Result<Option<Peer>, String> {
    let space = Space::draw(tests, shared);
    let file = space.write(&kalfit.folder)?;
    let (ours, taken) = space.ours()?;
    let Some((answer, agreement)) = compared(peer, interpreters, &file, &ours)? else { return Ok(Some(*peer)) };
    row(&[
        peer_name(peer, &answer),
        if shared { "one for all" } else { "own" }.to_owned(),
        tests.to_string(),
        (tests * space::ROWS).to_string(),
        seconds(answer.taken.processor),
        seconds(taken.processor),
        figure(answer.taken.processor / taken.processor),
        figure(agreement.log_likelihood),
    ]);
    Ok(None)
}

/// What a peer found, once it is known to agree; nothing when the peer is missing.
fn compared(
    peer: &Peer,
    interpreters: &Interpreters,
    data: &Path,
    ours: &Ours,
) -> Result<Option<(Answer, Agreement)>, String> {
    let Outcome::Answered(answer) = peer.answer(interpreters, data)? else { return Ok(None) };
    let agreement = ours.against(&answer).map_err(|why| format!("{}: the answers differ: {why}", peer.name))?;
    Ok(Some((answer, agreement)))
}

/// The peer and the version of what answered.
fn peer_name(peer: &Peer, answer: &Answer) -> String {
    format!("{} ({})", peer.name, answer.program)
}
