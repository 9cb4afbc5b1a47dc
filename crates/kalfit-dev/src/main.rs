//! Tasks of kalfit's developers: the test command and the benchmarks.
#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a developer's tool talks on the terminal")]

mod book;
mod browser;
mod fuzz;
mod places;
mod python;
mod test;

#[cfg(feature = "measure")]
mod bench;
#[cfg(feature = "measure")]
mod coverage;
#[cfg(feature = "measure")]
mod false_alarms;
#[cfg(feature = "measure")]
mod maxima;
#[cfg(feature = "measure")]
mod measure;
#[cfg(feature = "mutants")]
mod mutants;
#[cfg(feature = "measure")]
mod peak;
#[cfg(feature = "measure")]
mod peers;
#[cfg(feature = "measure")]
mod seed;
#[cfg(feature = "measure")]
mod whiteness;

#[cfg(not(feature = "measure"))]
mod build;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// What is not in the list of a program without the feature.
const MEASURE: &str = "Measurements, which are built in release on first use: coverage, maxima, false-alarms, fuzz-in-process, mutants, whiteness, \
                       bench, peers. \
                       `cargo dev coverage --help` describes one.";

/// Tasks of kalfit's developers.
#[derive(Debug, Parser)]
#[command(name = "cargo dev", version, after_help = MEASURE)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Everything a change must pass: format, lints, tests, documentation, dependencies, the Python package, the report in a browser.
    Test {
        /// Only the steps whose name contains this.
        #[arg(long)]
        only: Option<String>,
    },
    /// Runs the program on damaged models, tables, exchange files and results: no run may panic, hang, or leave what is not whole. Best
    /// built with `--release`.
    Fuzz(fuzz::Options),
    /// Writes into the pages of the book what its commands print, and its reference anew from the code. Read the difference.
    Book {
        /// Show the book in a browser instead; mdBook is installed into the target directory where it is missing.
        #[arg(long)]
        open: bool,
    },
    /// Changes the core in a hundred small ways, such as `a - b` for `a + b`, and sees whether a test notices each: the table of
    /// `book/src/guide/coverage.md`. An hour.
    #[cfg(feature = "mutants")]
    Mutants(mutants::Options),
    /// What measures kalfit itself.
    #[cfg(feature = "measure")]
    #[command(flatten)]
    Measure(measure::Task),
    /// The same, in a program that is not built yet.
    #[cfg(not(feature = "measure"))]
    #[command(external_subcommand)]
    Measure(Vec<String>),
}

fn main() -> ExitCode {
    match Arguments::parse().task {
        Task::Test { only } => test::run(only.as_deref()),
        Task::Fuzz(options) => fuzz::run(&options),
        Task::Book { open: true } => book::open(),
        Task::Book { open: false } => book::write(),
        #[cfg(feature = "mutants")]
        Task::Mutants(options) => mutants::run(&options),
        #[cfg(feature = "measure")]
        Task::Measure(task) => measure::run(task),
        #[cfg(not(feature = "measure"))]
        Task::Measure(words) => build::run(&words),
    }
}
