//! Tasks of kalfit's developers: the test command and the benchmarks.
#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a developer's tool talks on the terminal")]

mod book;
mod browser;
mod budget;
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
mod p_values;
#[cfg(feature = "measure")]
mod peak;
#[cfg(feature = "measure")]
mod peers;
#[cfg(feature = "measure")]
mod seed;
#[cfg(feature = "measure")]
mod setup;
#[cfg(feature = "measure")]
mod verdicts;
#[cfg(feature = "measure")]
mod whiteness;

#[cfg(not(feature = "measure"))]
mod build;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// What is not in the list of a program without the feature.
const MEASURE: &str = "Measurements, which are built in release on first use: coverage, maxima, false-alarms, verdicts, fuzz-in-process, mutants, whiteness, \
                       bench, peers. \
                       `cargo dev coverage --help` describes one.";

/// Tasks of kalfit's developers.
#[derive(Debug, Parser)]
#[command(name = "cargo dev", version, after_help = MEASURE)]
struct DevArguments {
    #[command(subcommand)]
    task: DevTask,
}

#[derive(Debug, Subcommand)]
enum DevTask {
    /// Everything a change must pass: format, lints, tests, documentation, dependencies, the Python package, the report in a browser.
    Test {
        /// Only the steps whose name contains this.
        #[arg(long)]
        only: Option<String>,
    },
    /// Runs the program on damaged models, tables, exchange files and results: no run may panic, hang, or leave what is not whole. Best
    /// built with `--release`.
    Fuzz(fuzz::FuzzOptions),
    /// Measures what building costs, beside the budgets of CONTRIBUTING: seconds from a changed line to its tests, and with `--all` an
    /// installation and the test command from nothing.
    Budget(budget::BudgetOptions),
    /// Writes into the pages of the book what its commands print, and its reference anew from the code. Read the difference.
    Book {
        /// Show the book in a browser instead; mdBook is installed into the target directory where it is missing.
        #[arg(long)]
        open: bool,
    },
    /// Changes the core in a hundred small ways, such as `a - b` for `a + b`, and sees whether a test notices each: the table of
    /// `book/src/guide/coverage.md`. An hour.
    #[cfg(feature = "mutants")]
    Mutants(mutants::MutantOptions),
    /// What measures kalfit itself.
    #[cfg(feature = "measure")]
    #[command(flatten)]
    Measure(measure::MeasureTask),
    /// The same, in a program that is not built yet.
    #[cfg(not(feature = "measure"))]
    #[command(external_subcommand)]
    Measure(Vec<String>),
}

fn main() -> ExitCode {
    match DevArguments::parse().task {
        DevTask::Test { only } => test::run(only.as_deref()),
        DevTask::Budget(options) => budget::run(&options),
        DevTask::Fuzz(options) => fuzz::run(&options),
        DevTask::Book { open: true } => book::open(),
        DevTask::Book { open: false } => book::write(),
        #[cfg(feature = "mutants")]
        DevTask::Mutants(options) => mutants::run(&options),
        #[cfg(feature = "measure")]
        DevTask::Measure(task) => measure::run(task),
        #[cfg(not(feature = "measure"))]
        DevTask::Measure(words) => build::run(&words),
    }
}
