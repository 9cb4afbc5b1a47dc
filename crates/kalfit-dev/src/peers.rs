//! Whole fits against other programs: the answers are compared first, then the times, all in one run.
//!
//! Times are processor times, kalfit by one thread and the peers by one, so that other work on the machine changes them little. A
//! peer's time is that of its fit alone, kalfit's that of the whole process from the data file to the file of results. Nothing is installed.

mod agreement;
mod answer;
mod clock;
mod ensemble;
mod peer;
mod record;
mod space;
mod stages;
mod table;
mod whole;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use agreement::{KalfitAnswer, PeerAgreement};
use answer::PeerAnswer;
use clap::ValueEnum;
use ensemble::PeerStudy;
use peer::{Interpreters, Peer, PeerOutcome};
use record::DrawnRecord;
use space::SpaceEnsemble;
use table::{figure, head, row, seconds};
use whole::KalfitCommand;

use crate::places;

/// Fits of one ensemble by several peers. What a peer cannot do in about a minute it is not asked, but for the last row,
/// which takes lme4 seven minutes.
const FITS: &[(PeerStudy, usize, &[Peer])] = &[
    (PeerStudy::Regression, 1_000, &[peer::LME4, peer::NLME, peer::STATSMODELS, peer::MIXEDLM_RS, peer::OPENMX]),
    (PeerStudy::Regression, 10_000, &[peer::LME4, peer::NLME, peer::STATSMODELS, peer::MIXEDLM_RS, peer::OPENMX]),
    (PeerStudy::Regression, 100_000, &[peer::LME4, peer::MIXEDLM_RS]),
    (PeerStudy::Meta, 200, &[peer::METAFOR_DENSE, peer::METAFOR_SPARSE]),
    (PeerStudy::Meta, 400, &[peer::METAFOR_DENSE]),
    (PeerStudy::Meta, 1_000, &[peer::METAFOR_SPARSE]),
    (PeerStudy::Crossed, 1_000, &[peer::LME4_CROSSED]),
    (PeerStudy::Crossed, 10_000, &[peer::LME4_CROSSED]),
    (PeerStudy::Crossed, 100_000, &[peer::LME4_CROSSED]),
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
pub(crate) struct PeerOptions {
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
    /// Only this part.
    #[arg(long, value_name = "PART")]
    only: Option<PeerPart>,
}

/// A part of the task, with tables of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum PeerPart {
    /// Whole fits, from a file of data to a file of results.
    Fits,
    /// Values of a likelihood at known parameters.
    Values,
    /// Reading of a table and each test's sums, beside a whole fit.
    Sums,
    /// Where kalfit's time goes, a second thread, and the start of the program.
    Stages,
}

/// What could not be compared.
#[derive(Debug, Default)]
struct ComparisonGaps {
    missing: Vec<Peer>,
    problems: Vec<String>,
}

/// Runs the task, in a released build.
pub(crate) fn run(options: &PeerOptions) -> ExitCode {
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

fn build_and_run(options: &PeerOptions) -> Result<(), String> {
    let build = ["--quiet", "--release", "--locked", "--package"];
    let command = match &options.command {
        Some(command) => command.clone(),
        None => {
            cargo(&[&["build"], &build[..], &["kalfit-cli"]].concat())?;
            places::kalfit(&places::target()?, "release")
        }
    };
    let (python, rscript) = (program(&options.python)?, program(&options.rscript)?);
    let command = whole::path(&command)?;
    let mut arguments =
        [&["run"], &build[..], &["kalfit-dev", "--features", "measure", "--", "peers", "--here"]].concat();
    arguments.extend(["--command", command, "--python", &python, "--rscript", &rscript]);
    let only = options.only.and_then(|part| Some(part.to_possible_value()?.get_name().to_owned()));
    if let Some(only) = &only {
        arguments.extend(["--only", only]);
    }
    cargo(&arguments)
}

/// A program that is looked for in the path, or the absolute form of one named by its own: scripts run in another folder. Links
/// stay as they are, for an environment's Python is one.
fn program(name: &str) -> Result<String, String> {
    if Path::new(name).components().count() < 2 {
        return Ok(name.to_owned());
    }
    let absolute = std::path::absolute(name).map_err(|error| format!("{name}: {error}"))?;
    whole::path(&absolute).map(str::to_owned)
}

fn here(options: &PeerOptions) -> Result<(), String> {
    // one core against one core
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().map_err(|error| error.to_string())?;
    let command = options.command.clone().ok_or("`--here` takes kalfit's command from `--command`")?;
    let command = command.canonicalize().map_err(|error| format!("{}: {error}", command.display()))?;
    let folder = std::env::temp_dir().join(format!("kalfit-peers-{}", std::process::id()));
    std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let kalfit = KalfitCommand { command, folder };
    let interpreters = Interpreters { rscript: program(&options.rscript)?, python: program(&options.python)? };
    let done = parts(&kalfit, &interpreters, options.only);
    let removed = std::fs::remove_dir_all(&kalfit.folder);
    done?;
    removed.map_err(|error| format!("{}: {error}", kalfit.folder.display()))
}

fn parts(kalfit: &KalfitCommand, interpreters: &Interpreters, only: Option<PeerPart>) -> Result<(), String> {
    let wanted = |part: PeerPart| only.is_none_or(|only| only == part);
    let mut open = ComparisonGaps::default();
    if wanted(PeerPart::Fits) {
        head(2, FITS_HEAD);
        for (study, tests, peers) in FITS {
            fits(kalfit, interpreters, (*study, *tests, peers), &mut open)?;
        }
        println!();
    }
    if wanted(PeerPart::Values) {
        head(2, VALUES_HEAD);
        for (peer, tests, shared) in VALUES {
            value(kalfit, interpreters, (peer, *tests, *shared), &mut open)?;
        }
        record(kalfit, interpreters, &mut open)?;
        println!();
    }
    if wanted(PeerPart::Sums) {
        head(1, SUMS_HEAD);
        for tests in [10_000, 100_000, 1_000_000] {
            sums(kalfit, interpreters, tests, &mut open)?;
        }
        println!();
    }
    if wanted(PeerPart::Stages) {
        stages::print(kalfit)?;
    }
    open.tell()
}

impl ComparisonGaps {
    /// Prints which peers are missing; an error where answers differ or a peer failed.
    fn tell(&self) -> Result<(), String> {
        for peer in &self.missing {
            println!("{} is missing: {}", peer.name, peer.install);
        }
        if self.problems.is_empty() { Ok(()) } else { Err(self.problems.join("\n")) }
    }

    /// What a peer found, once it is known to agree; nothing when the peer is missing, failed or differs.
    fn compared(
        &mut self,
        peer: &Peer,
        interpreters: &Interpreters,
        data: &Path,
        ours: &KalfitAnswer,
    ) -> Option<(PeerAnswer, PeerAgreement)> {
        match peer.answer(interpreters, data) {
            Ok(PeerOutcome::Answered(answer)) => match ours.against(&answer) {
                Ok(agreement) => return Some((answer, agreement)),
                Err(why) => self.problems.push(format!("{}: the answers differ: {why}", peer.name)),
            },
            Ok(PeerOutcome::Missing) if self.missing.iter().any(|missing| missing.name == peer.name) => {}
            Ok(PeerOutcome::Missing) => self.missing.push(*peer),
            Err(why) => self.problems.push(why),
        }
        None
    }
}

const FITS_HEAD: &[&str] = &[
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
];

const VALUES_HEAD: &[&str] = &["peer", "designs", "tests", "rows", "its value", "kalfit", "ratio", "Δ log-likelihood"];

/// Prints a row for each peer that agrees.
fn fits(
    kalfit: &KalfitCommand,
    interpreters: &Interpreters,
    (study, tests, peers): (PeerStudy, usize, &[Peer]),
    open: &mut ComparisonGaps,
) -> Result<(), String> {
    let [csv, parquet] = study.draw(tests, kalfit)?;
    let model = study.model();
    let model = whole::path(&model)?;
    let from_parquet = kalfit.fit(model, &parquet)?;
    let from_csv = kalfit.fit(model, &csv)?;
    let ours = KalfitAnswer::of(&kalfit.record()?)?;
    for peer in peers {
        let Some((answer, agreement)) = open.compared(peer, interpreters, &csv, &ours) else { continue };
        let theirs = answer.taken.processor;
        let words = [peer_name(peer, &answer), study.name().to_owned(), tests.to_string()];
        let times =
            [from_csv, from_parquet].map(|taken| [seconds(taken.processor), figure(theirs / taken.processor)]).concat();
        let rows = (tests * study.rows()).to_string();
        let apart = [figure(agreement.log_likelihood), figure(agreement.estimates)];
        row(&[&words[..], &[rows, seconds(theirs)], &times, &apart].concat());
    }
    Ok(())
}

const SUMS_HEAD: &[&str] = &["peer", "tests", "its reading and sums", "kalfit, from Parquet, `--no-tests`", "ratio"];

/// Prints a row of what a peer needs to read and sum what kalfit fits.
fn sums(
    kalfit: &KalfitCommand,
    interpreters: &Interpreters,
    tests: usize,
    open: &mut ComparisonGaps,
) -> Result<(), String> {
    let [_, parquet] = PeerStudy::Regression.draw(tests, kalfit)?;
    let model = PeerStudy::Regression.model();
    let arguments = ["fit", whole::path(&model)?, whole::path(&parquet)?, "--threads", "1", "--no-tests"];
    let ours = kalfit.median(5, &arguments)?.processor;
    match peer::POLARS.answer(interpreters, &parquet) {
        Ok(PeerOutcome::Answered(answer)) => {
            let theirs = answer.taken.processor;
            let name = peer_name(&peer::POLARS, &answer);
            row(&[name, tests.to_string(), seconds(theirs), seconds(ours), figure(theirs / ours)]);
        }
        Ok(PeerOutcome::Missing) if open.missing.contains(&peer::POLARS) => {}
        Ok(PeerOutcome::Missing) => open.missing.push(peer::POLARS),
        Err(why) => open.problems.push(why),
    }
    Ok(())
}

/// Prints the row of one long record, if the peer agrees.
fn record(kalfit: &KalfitCommand, interpreters: &Interpreters, open: &mut ComparisonGaps) -> Result<(), String> {
    let record = DrawnRecord::draw();
    let file = record.write(&kalfit.folder)?;
    let (ours, taken) = record.ours()?;
    if let Some((answer, agreement)) = open.compared(&peer::CELERITE, interpreters, &file, &ours) {
        let theirs = answer.taken.processor;
        row(&[
            peer_name(&peer::CELERITE, &answer),
            "one record, times of its own".to_owned(),
            "1".to_owned(),
            record::ROWS.to_string(),
            seconds(theirs),
            seconds(taken.processor),
            figure(theirs / taken.processor),
            figure(agreement.log_likelihood),
        ]);
    }
    Ok(())
}

/// Prints a row, if the peer agrees.
fn value(
    kalfit: &KalfitCommand,
    interpreters: &Interpreters,
    (peer, tests, shared): (&Peer, usize, bool),
    open: &mut ComparisonGaps,
) -> Result<(), String> {
    let space = SpaceEnsemble::draw(tests, shared);
    let file = space.write(&kalfit.folder)?;
    let (ours, taken) = space.ours()?;
    if let Some((answer, agreement)) = open.compared(peer, interpreters, &file, &ours) {
        let theirs = answer.taken.processor;
        row(&[
            peer_name(peer, &answer),
            if shared { "one for all" } else { "own" }.to_owned(),
            tests.to_string(),
            (tests * space::ROWS).to_string(),
            seconds(theirs),
            seconds(taken.processor),
            figure(theirs / taken.processor),
            figure(agreement.log_likelihood),
        ]);
    }
    Ok(())
}

/// The program that answered, with its version, and what of it was run.
fn peer_name(peer: &Peer, answer: &PeerAnswer) -> String {
    format!("{}, {}", answer.program, peer.what)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_peer_is_named_once_and_is_no_error() {
        let none = "no-such-interpreter".to_owned();
        let interpreters = Interpreters { rscript: none.clone(), python: none };
        let ours = KalfitAnswer { log_likelihood: 0.0, estimates: Vec::new() };
        let mut open = ComparisonGaps::default();
        for peer in [peer::METAFOR_DENSE, peer::DYNAMAX, peer::METAFOR_SPARSE] {
            assert!(open.compared(&peer, &interpreters, Path::new("data.csv"), &ours).is_none());
        }
        assert_eq!(open.missing, [peer::METAFOR_DENSE, peer::DYNAMAX]);
        assert_eq!(open.tell(), Ok(()));
        open.problems.push("lme4: the answers differ".to_owned());
        assert_eq!(open.tell(), Err("lme4: the answers differ".to_owned()));
    }

    #[test]
    fn a_program_given_by_its_path_is_found_from_any_folder() {
        assert_eq!(program("python3"), Ok("python3".to_owned()));
        let path = program("venv/bin/python").unwrap();
        assert!(Path::new(&path).is_absolute() && path.contains("python"), "{path}");
    }
}
