//! Tasks that measure kalfit itself.

use std::process::ExitCode;

use clap::Subcommand;

use crate::{bench, coverage, false_alarms, fuzz, maxima, peers, verdicts, whiteness};

/// What is measured here allocates as the command does.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

#[derive(Debug, Subcommand)]
pub(crate) enum MeasureTask {
    /// Coverage of confidence intervals in simulated ensembles: the tables of `book/src/guide/coverage.md`.
    Coverage {
        /// Ensembles of each set-up; of those with levels a tenth of them.
        #[arg(long, default_value_t = 20_000, value_parser = clap::value_parser!(u64).range(1..))]
        ensembles: u64,
        /// Only the set-ups whose title contains this.
        #[arg(long, default_value = "")]
        only: String,
    },
    /// Fits random models from several starts and probes around every certified end: a table of `book/src/guide/coverage.md`.
    Maxima(maxima::MaximaOptions),
    /// How often the checks of a fit reject a correct model: tables of `book/src/guide/coverage.md`.
    FalseAlarms(false_alarms::FalseAlarmOptions),
    /// How often the check of a fit doubts correct models of every kind, and finds faults that are planted in the data: tables of
    /// `book/src/guide/coverage.md`.
    Verdicts(verdicts::VerdictOptions),
    /// Simulates the distribution of the whiteness statistic: the table from which p-values of innovations come.
    Whiteness,
    /// Times the reduction and the iterations of the solver against the measured peak of the machine.
    Bench {
        /// Run in this process; without it the benchmark is first built for this machine's own instructions.
        #[arg(long)]
        here: bool,
    },
    /// Gives damaged models, tables, exchange files and results to the libraries in this process, and fits small models whose
    /// log-likelihood is compared with that of a dense law: no input may panic, hang or take more memory than it is given.
    FuzzInProcess(fuzz::InProcessOptions),
    /// Times whole fits against other programs, where they are installed, after comparing the answers: the tables of the book's "How fast it is".
    Peers(peers::PeerOptions),
}

pub(crate) fn run(task: MeasureTask) -> ExitCode {
    match task {
        MeasureTask::Coverage { ensembles, only } => coverage::run(ensembles, &only),
        MeasureTask::Maxima(options) => maxima::run(&options),
        MeasureTask::FalseAlarms(options) => false_alarms::run(&options),
        MeasureTask::Verdicts(options) => verdicts::run(&options),
        MeasureTask::Whiteness => whiteness::run(),
        MeasureTask::Bench { here: true } => bench::run(),
        MeasureTask::Bench { here: false } => bench::build_and_run(),
        MeasureTask::FuzzInProcess(options) => fuzz::in_process(&options),
        MeasureTask::Peers(options) => peers::run(&options),
    }
}
