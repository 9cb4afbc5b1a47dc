//! What is meant by what was typed.

use std::path::PathBuf;
use std::process::ExitCode;

use kalfit::estimate::{Settings, Solver};

use crate::args::{Args, CheckArgs, Command, FitArgs, InnovationsArg, ModelArgs, SolverArg};
use crate::failure::Failure;
use crate::{check, fit};

/// One command with all that it needs to know.
#[derive(Debug)]
pub(crate) enum Job {
    Fit(FitJob),
    Check(CheckJob),
}

/// Which model, on how many threads.
#[derive(Debug)]
pub(crate) struct ModelJob {
    pub(crate) path: PathBuf,
    /// `name=value`.
    pub(crate) set: Vec<String>,
    /// All processors when none.
    pub(crate) threads: Option<usize>,
}

#[derive(Debug)]
pub(crate) struct FitJob {
    pub(crate) model: ModelJob,
    pub(crate) data: Vec<String>,
    pub(crate) out: Option<PathBuf>,
    pub(crate) settings: Settings,
    /// Look at the data once more after the fit.
    pub(crate) innovations: bool,
    pub(crate) quiet: bool,
}

#[derive(Debug)]
pub(crate) struct CheckJob {
    pub(crate) model: ModelJob,
    /// Nothing but the model is checked when empty.
    pub(crate) data: Vec<String>,
}

/// How a command ended that had good input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    Done,
    NotCertified,
}

impl Outcome {
    pub(crate) fn exit_code(self) -> ExitCode {
        match self {
            Outcome::Done => ExitCode::SUCCESS,
            Outcome::NotCertified => ExitCode::FAILURE,
        }
    }
}

impl Job {
    pub(crate) fn run(&self) -> Result<Outcome, Failure> {
        let threads = match self {
            Job::Fit(job) => job.model.threads,
            Job::Check(job) => job.model.threads,
        };
        if let Some(threads) = threads {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
            pool.map_err(|error| Failure::Threads { threads, reason: error.to_string() })?;
        }
        match self {
            Job::Fit(job) => fit::run(job),
            Job::Check(job) => check::run(job),
        }
    }
}

impl From<Args> for Job {
    fn from(args: Args) -> Job {
        match args.command {
            Command::Fit(args) => Job::Fit(args.into()),
            Command::Check(args) => Job::Check(args.into()),
        }
    }
}

impl From<ModelArgs> for ModelJob {
    fn from(args: ModelArgs) -> ModelJob {
        ModelJob { path: args.model, set: args.set, threads: args.threads.map(usize::from) }
    }
}

impl From<FitArgs> for FitJob {
    fn from(args: FitArgs) -> FitJob {
        let mut settings = Settings::of(match args.solver {
            SolverArg::Newton => Solver::Newton,
            SolverArg::Em => Solver::Em,
        });
        if let Some(tolerance) = args.tolerance {
            settings.tolerance = tolerance;
        }
        if let Some(passes) = args.max_iterations {
            settings.max_passes = passes as usize;
        }
        FitJob {
            model: args.model.into(),
            data: args.data,
            out: args.out,
            settings,
            innovations: args.innovations == InnovationsArg::On,
            quiet: args.quiet,
        }
    }
}

impl From<CheckArgs> for CheckJob {
    fn from(args: CheckArgs) -> CheckJob {
        CheckJob { model: args.model.into(), data: args.data }
    }
}
