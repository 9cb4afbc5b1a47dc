//! What is meant by what was typed.

use std::path::PathBuf;
use std::process::ExitCode;

use kalfit::dynamic::{self, Method};
use kalfit::estimate::{Combination, Criterion, Settings, Solver};
use kalfit::infer::{Bootstrap, Choices, DeletionChoice, IntervalKind, StdErrors};

use crate::args::{
    Args, CheckArgs, Command, CriterionArg, DeletionArg, ExchangeArgs, FitArgs, InnovationsArg, IntervalsArg,
    MethodArg, ModelArgs, PhasesArg, PlanArgs, ReportArgs, SimulateArgs, SolverArg, StdErrorsArg, TestArgs,
};
use crate::estimates::Filters;
use crate::failure::Failure;
use crate::reduce::Reductions;
use crate::report::ReportJob;
use crate::{check, exchange, fit, plan, report, simulate, test};

/// One command with all that it needs to know.
#[derive(Debug)]
pub(crate) enum Job {
    Fit(FitJob),
    Reduce(ExchangeJob),
    Estimates(ExchangeJob),
    Test(TestJob),
    Check(CheckJob),
    Simulate(SimulateJob),
    Plan(PlanJob),
    Report(ReportJob),
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
    /// File for the HTML report.
    pub(crate) report: Option<PathBuf>,
    pub(crate) settings: Settings,
    /// Of free dynamic parameters.
    pub(crate) search: dynamic::Settings,
    /// How they are sought; in every way when none.
    pub(crate) method: Option<Method>,
    pub(crate) choices: Choices,
    /// Look at the data once more after the fit.
    pub(crate) innovations: bool,
    pub(crate) quiet: bool,
}

#[derive(Debug)]
pub(crate) struct ExchangeJob {
    pub(crate) model: ModelJob,
    pub(crate) data: Vec<String>,
    /// Results of a fit, for the parameters.
    pub(crate) at: Option<PathBuf>,
    pub(crate) out: PathBuf,
    pub(crate) quiet: bool,
}

#[derive(Debug)]
pub(crate) struct TestJob {
    pub(crate) model: ModelJob,
    pub(crate) data: Vec<String>,
    pub(crate) null: PathBuf,
    pub(crate) bootstrap: Option<Bootstrap>,
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
            Job::Reduce(job) | Job::Estimates(job) => job.model.threads,
            Job::Test(job) => job.model.threads,
            Job::Check(job) => job.model.threads,
            Job::Simulate(job) => job.model.threads,
            Job::Plan(job) => job.model.threads,
            Job::Report(_) => None,
        };
        if let Some(threads) = threads {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
            pool.map_err(|error| Failure::Threads { threads, reason: error.to_string() })?;
        }
        match self {
            Job::Fit(job) => fit::run(job),
            Job::Reduce(job) => exchange::run::<Reductions>(job),
            Job::Estimates(job) => exchange::run::<Filters>(job),
            Job::Test(job) => test::run(job),
            Job::Check(job) => check::run(job),
            Job::Simulate(job) => simulate::run(job),
            Job::Plan(job) => plan::run(job),
            Job::Report(job) => report::run(job),
        }
    }
}

impl From<Args> for Job {
    fn from(args: Args) -> Job {
        match args.command {
            Command::Fit(args) => Job::Fit(args.into()),
            Command::Reduce(args) => Job::Reduce(args.into()),
            Command::Estimates(args) => Job::Estimates(args.into()),
            Command::Test(args) => Job::Test(args.into()),
            Command::Check(args) => Job::Check(args.into()),
            Command::Simulate(args) => Job::Simulate(args.into()),
            Command::Plan(args) => Job::Plan(args.into()),
            Command::Report(args) => Job::Report(args.into()),
        }
    }
}

impl From<ModelArgs> for ModelJob {
    fn from(args: ModelArgs) -> ModelJob {
        ModelJob { path: args.model, set: args.set, threads: args.threads.map(usize::from) }
    }
}

/// Settings of a solver with what was asked for.
fn settings(solver: SolverArg, tolerance: Option<f64>, passes: Option<u32>) -> Settings {
    let mut settings = Settings::of(match solver {
        SolverArg::Newton => Solver::Newton,
        SolverArg::Em => Solver::Em,
    });
    settings.tolerance = tolerance.unwrap_or(settings.tolerance);
    settings.max_passes = passes.map_or(settings.max_passes, |passes| passes as usize);
    settings
}

impl From<TestArgs> for TestJob {
    fn from(args: TestArgs) -> TestJob {
        let seed = args.seed.unwrap_or(1);
        TestJob {
            model: args.model.into(),
            data: args.data,
            null: args.null,
            bootstrap: args.bootstrap.map(|n| Bootstrap { replicates: n as usize, seed }),
            out: args.out,
            settings: settings(SolverArg::Newton, args.tolerance, args.max_iterations),
            quiet: args.quiet,
        }
    }
}

impl From<FitArgs> for FitJob {
    fn from(args: FitArgs) -> FitJob {
        let mut settings = settings(args.solver, args.tolerance, args.max_iterations);
        settings.criterion = match args.criterion {
            CriterionArg::Ml => Criterion::Ml,
            CriterionArg::Reml => Criterion::Reml,
        };
        settings.phases = match args.phases {
            PhasesArg::Chain => Combination::Chain,
            PhasesArg::Marginal => Combination::Marginal,
            PhasesArg::Stacked => Combination::Stacked,
        };
        let choices = Choices {
            std_errors: match args.std_errors {
                StdErrorsArg::Observed => StdErrors::Observed,
                StdErrorsArg::Expected => StdErrors::Expected,
                StdErrorsArg::Sandwich => StdErrors::Sandwich,
            },
            intervals: match args.intervals {
                IntervalsArg::Wald => IntervalKind::Wald,
                IntervalsArg::Profile => IntervalKind::Profile,
            },
            deletion: match args.deletion {
                DeletionArg::Auto => DeletionChoice::Cheap,
                DeletionArg::All => DeletionChoice::All,
                DeletionArg::None => DeletionChoice::None,
            },
        };
        let search = dynamic::Settings {
            method: Method::Hybrid,
            inner: settings.clone(),
            starts: args.starts.unwrap_or(0) as usize,
            seed: args.seed.unwrap_or(1),
        };
        FitJob {
            model: args.model.into(),
            data: args.data,
            out: args.out,
            report: args.report,
            settings,
            search,
            method: match args.method {
                MethodArg::Hybrid => Some(Method::Hybrid),
                MethodArg::Innovations => Some(Method::Innovations),
                MethodArg::Em => Some(Method::Em),
                MethodArg::All => None,
            },
            choices,
            innovations: args.innovations == InnovationsArg::On,
            quiet: args.quiet,
        }
    }
}

impl From<ExchangeArgs> for ExchangeJob {
    fn from(args: ExchangeArgs) -> ExchangeJob {
        let ExchangeArgs { model, data, at, out, quiet } = args;
        ExchangeJob { model: model.into(), data, at, out, quiet }
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

impl From<ReportArgs> for ReportJob {
    fn from(args: ReportArgs) -> ReportJob {
        let ReportArgs { fit, out, test, quiet } = args;
        ReportJob { fit, test, out, quiet }
    }
}
