//! Tasks of kalfit's developers: the test command and the benchmarks.
#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a developer's tool talks on the terminal")]

mod bench;
mod book;
mod browser;
mod coverage;
mod false_alarms;
mod fuzz;
mod maxima;
mod peak;
mod peers;
mod places;
mod python;
mod test;
mod whiteness;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// What is measured here allocates as the command does.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Tasks of kalfit's developers.
#[derive(Debug, Parser)]
#[command(name = "cargo dev", version)]
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
    /// Coverage of confidence intervals in simulated ensembles: the table of `docs/coverage.md`. Best built with `--release`.
    Coverage {
        /// Ensembles of each set-up; of those with levels a tenth of them.
        #[arg(long, default_value_t = 20_000, value_parser = clap::value_parser!(u64).range(1..))]
        ensembles: u64,
        /// Only the set-ups whose title contains this.
        #[arg(long, default_value = "")]
        only: String,
    },
    /// Fits random models from several starts and probes around every certified end: the table of `docs/coverage.md`. Best built with
    /// `--release`.
    Maxima(maxima::Options),
    /// How often the checks of a fit accuse a model that is right: tables of `docs/coverage.md`. Best built with `--release`.
    FalseAlarms(false_alarms::Options),
    /// Runs the program on damaged models, tables, exchange files and results: no run may panic, hang, or leave what is not whole. Best
    /// built with `--release`.
    Fuzz(fuzz::Options),
    /// Simulates the law of the whiteness statistic anew: the table from which p-values of innovations come. Best built with `--release`.
    Whiteness,
    /// Writes into the pages of the book what its commands print, and its reference anew from the code. Read the difference.
    Book {
        /// Show the book in a browser instead; mdBook is installed into the target directory where it is missing.
        #[arg(long)]
        open: bool,
    },
    /// Times the reduction and the solver's passes against the machine's measured peak.
    Bench {
        /// Run in this process; without it the benchmark is first built for this machine's own instructions.
        #[arg(long)]
        here: bool,
    },
    /// Times whole fits against other programs, where they are installed, after comparing the answers: the tables of the book's "How fast it is".
    Peers(peers::Options),
}

fn main() -> ExitCode {
    match Arguments::parse().task {
        Task::Test { only } => test::run(only.as_deref()),
        Task::Coverage { ensembles, only } => coverage::run(ensembles, &only),
        Task::Maxima(options) => maxima::run(&options),
        Task::FalseAlarms(options) => false_alarms::run(&options),
        Task::Fuzz(options) => fuzz::run(&options),
        Task::Whiteness => whiteness::run(),
        Task::Book { open: true } => book::open(),
        Task::Book { open: false } => book::write(),
        Task::Bench { here: true } => bench::run(),
        Task::Bench { here: false } => bench::build_and_run(),
        Task::Peers(options) => peers::run(&options),
    }
}
