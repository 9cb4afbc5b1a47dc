//! What is meant by what was typed.

use std::path::PathBuf;
use std::process::ExitCode;

use kalfit::estimate::{Settings, Solver};

use crate::args::{Args, CheckArgs, Command, FitArgs, ModelArgs, PlanArgs, SimulateArgs, SolverArg};
use crate::failure::Failure;
use crate::{check, fit, plan, simulate};

/// One command with all that it needs to know.
#[derive(Debug)]
pub(crate) enum Job {
    Fit(FitJob),
    Check(CheckJob),
    Simulate(SimulateJob),
    Plan(PlanJob),
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
    pub(crate) quiet: bool,
}

#[derive(Debug)]
pub(crate) struct CheckJob {
    pub(crate) model: ModelJob,
    /// Nothing but the model is checked when empty.
    pub(crate) data: Vec<String>,
}

#[derive(Debug)]
pub(crate) struct SimulateJob {
    pub(crate) model: ModelJob,
    /// Where the population comes from.
    pub(crate) from: PathBuf,
    pub(crate) design: Vec<String>,
    /// As many as the design when none.
    pub(crate) tests: Option<u64>,
    pub(crate) seed: u64,
    pub(crate) out: PathBuf,
    /// File for the true initial states.
    pub(crate) states: Option<PathBuf>,
    pub(crate) quiet: bool,
}

#[derive(Debug)]
pub(crate) struct PlanJob {
    pub(crate) model: ModelJob,
    /// Where the population comes from.
    pub(crate) from: PathBuf,
    pub(crate) design: Vec<String>,
    pub(crate) tests: Vec<usize>,
    pub(crate) out: Option<PathBuf>,
    pub(crate) quiet: bool,
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
            Job::Simulate(job) => job.model.threads,
            Job::Plan(job) => job.model.threads,
        };
        if let Some(threads) = threads {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
            pool.map_err(|error| Failure::Threads { threads, reason: error.to_string() })?;
        }
        match self {
            Job::Fit(job) => fit::run(job),
            Job::Check(job) => check::run(job),
            Job::Simulate(job) => simulate::run(job),
            Job::Plan(job) => plan::run(job),
        }
    }
}

impl From<Args> for Job {
    fn from(args: Args) -> Job {
        match args.command {
            Command::Fit(args) => Job::Fit(args.into()),
            Command::Check(args) => Job::Check(args.into()),
            Command::Simulate(args) => Job::Simulate(args.into()),
            Command::Plan(args) => Job::Plan(args.into()),
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
        FitJob { model: args.model.into(), data: args.data, out: args.out, settings, quiet: args.quiet }
    }
}

impl From<CheckArgs> for CheckJob {
    fn from(args: CheckArgs) -> CheckJob {
        CheckJob { model: args.model.into(), data: args.data }
    }
}

impl From<SimulateArgs> for SimulateJob {
    fn from(args: SimulateArgs) -> SimulateJob {
        SimulateJob {
            model: args.model.into(),
            from: args.truth.from,
            design: args.truth.design,
            tests: args.tests,
            seed: args.seed,
            out: args.out,
            states: args.states,
            quiet: args.quiet,
        }
    }
}

impl From<PlanArgs> for PlanJob {
    fn from(args: PlanArgs) -> PlanJob {
        PlanJob {
            model: args.model.into(),
            from: args.truth.from,
            design: args.truth.design,
            tests: args.tests.into_iter().map(|n| n as usize).collect(),
            out: args.out,
            quiet: args.quiet,
        }
    }
}
