//! What is meant by what was typed.

use std::path::PathBuf;

use clap_complete::Shell;
use kalfit::apply::StateKind;
use kalfit::dynamic::{self, Method};
use kalfit::estimate::{Settings, Solver};
use kalfit::infer::{Choices, TestsChoice};
use kalfit::predict::{Limits, Sides};
use kalfit_data::Datum;
use kalfit_job::sums::{JoinJob, SumsJob};
use kalfit_job::{
    ApplyJob, BestPlanRequest, BootstrapChoice, CheckJob, CompareJob, DatasheetJob, DesignPlan, ExchangeJob, ExportJob,
    FitJob, FitTables, FoldChoice, ModelJob, PlanJob, PlanRequest, PlotJob, PredictJob, ReportJob, SimulateJob, SoFar,
    TestJob, ValidateJob,
};

use crate::args::{
    ApplyArgs, Args, CheckArgs, Command, CompareArgs, DatasheetArgs, ExchangeArgs, ExportArgs, FitArgs, GlobalArgs,
    JoinArgs, ModelArgs, PlanArgs, PlotArgs, PredictArgs, ReportArgs, SimulateArgs, SumsArgs, TestArgs, ValidateArgs,
};
use crate::ended::{CommandFailure, CommandOutcome};
use crate::init::InitJob;
use crate::interrupt;
use crate::show::{self, ShowOptions};
use crate::threads;

/// One command with all that it needs to know.
#[derive(Debug)]
pub(crate) struct CommandOrder {
    job: CommandJob,
    /// Threads; all processors when none.
    threads: Option<usize>,
    /// Instructions, where an option fixes them.
    instructions: Option<String>,
    telling: ShowOptions,
}

#[derive(Debug)]
enum CommandJob {
    Init(Option<InitJob>),
    Fit(FitJob),
    Reduce(ExchangeJob),
    Estimates(ExchangeJob),
    Sums(SumsJob),
    Join(JoinJob),
    Test(TestJob),
    Check(CheckJob),
    Simulate(SimulateJob),
    Plan(PlanJob),
    Apply(ApplyJob),
    Validate(ValidateJob),
    Predict(PredictJob),
    Export(ExportJob),
    Datasheet(DatasheetJob),
    Compare(CompareJob),
    Report(ReportJob),
    Plot(PlotJob),
    Schema,
    Completions(Shell),
    Man(Option<PathBuf>),
}

impl CommandOrder {
    pub(crate) fn run(&self) -> Result<CommandOutcome, CommandFailure> {
        kalfit_job::fix_instructions(self.instructions.as_deref())?;
        // now, where it can be told that there are none: whoever wants the first one could not
        threads::start(self.threads)?;
        kalfit_job::memory_is_there()?;
        kalfit_job::check_rows_variable()?;
        let telling = self.telling;
        interrupt::listen(matches!(self.job, CommandJob::Fit(_)), telling.quiet);
        match &self.job {
            CommandJob::Init(None) => show::templates(),
            CommandJob::Init(Some(job)) => show::init(job, telling),
            CommandJob::Schema => show::schema(),
            CommandJob::Fit(job) => show::fit(job, telling),
            CommandJob::Reduce(job) => show::exchange(job, kalfit_job::reduce, telling),
            CommandJob::Estimates(job) => show::exchange(job, kalfit_job::estimates, telling),
            CommandJob::Sums(job) => show::sums(job, telling),
            CommandJob::Join(job) => show::join(job, telling),
            CommandJob::Test(job) => show::test(job, telling),
            CommandJob::Check(job) => show::check(job, telling),
            CommandJob::Simulate(job) => show::simulate(job, telling),
            CommandJob::Plan(job) => show::plan(job, telling),
            CommandJob::Apply(job) => show::apply(job, telling),
            CommandJob::Validate(job) => show::validate(job, telling),
            CommandJob::Predict(job) => show::predict(job, telling),
            CommandJob::Export(job) => show::export(job, telling),
            CommandJob::Datasheet(job) => show::datasheet(job, telling),
            CommandJob::Compare(job) => show::compare(job, telling),
            CommandJob::Report(job) => show::report(job, telling),
            CommandJob::Plot(job) => show::plot(job, telling),
            CommandJob::Completions(shell) => show::completions(*shell),
            CommandJob::Man(folder) => show::man(folder.as_deref(), telling),
        }
    }
}

impl From<Args> for CommandOrder {
    fn from(mut args: Args) -> CommandOrder {
        let GlobalArgs { quiet, threads, instructions, color: _ } = args.global;
        let telling = ShowOptions { quiet, json: takes_standard_output(&mut args.command) };
        let job = match args.command {
            Command::Fit(args) => CommandJob::Fit(args.into()),
            Command::Reduce(args) => CommandJob::Reduce(args.into()),
            Command::Estimates(args) => CommandJob::Estimates(args.into()),
            Command::Sums(args) => CommandJob::Sums(args.into()),
            Command::Join(args) => CommandJob::Join(args.into()),
            Command::Test(args) => CommandJob::Test(args.into()),
            Command::Check(args) => CommandJob::Check(args.into()),
            Command::Simulate(args) => CommandJob::Simulate(args.into()),
            Command::Plan(args) => CommandJob::Plan(args.into()),
            Command::Apply(args) => CommandJob::Apply(args.into()),
            Command::Validate(args) => CommandJob::Validate(args.into()),
            Command::Predict(args) => CommandJob::Predict(args.into()),
            Command::Export(args) => CommandJob::Export(args.into()),
            Command::Datasheet(args) => CommandJob::Datasheet(args.into()),
            Command::Compare(args) => CommandJob::Compare(args.into()),
            Command::Report(args) => CommandJob::Report(args.into()),
            Command::Init(args) => {
                let folder = args.dir.unwrap_or_default();
                CommandJob::Init(args.template.map(|template| InitJob { template, folder }))
            }
            Command::Schema => CommandJob::Schema,
            Command::Plot(args) => CommandJob::Plot(args.into()),
            Command::Completions(args) => CommandJob::Completions(args.shell),
            Command::Man(args) => CommandJob::Man(args.dir),
        };
        CommandOrder { job, threads: threads.map(usize::from), instructions, telling }
    }
}

/// True when results were asked for as JSON on standard output, `--out -`, which no job knows of.
fn takes_standard_output(command: &mut Command) -> bool {
    let out = match command {
        Command::Fit(args) => &mut args.out,
        Command::Test(args) => &mut args.out,
        Command::Check(args) => &mut args.out,
        Command::Plan(args) => &mut args.out,
        Command::Validate(args) => &mut args.out,
        Command::Datasheet(args) => &mut args.out,
        Command::Compare(args) => &mut args.out,
        _ => return false, // tables and pages are files
    };
    out.take_if(|out| out.as_os_str() == "-").is_some()
}

/// The data that were named.
fn data(names: Vec<String>) -> Vec<Datum> {
    names.into_iter().map(Datum::Named).collect()
}

impl From<ModelArgs> for ModelJob {
    fn from(args: ModelArgs) -> ModelJob {
        ModelJob { document: args.model.into(), set: args.set }
    }
}

/// Settings of a solver with what was asked for.
fn settings(solver: Solver, tolerance: Option<f64>, passes: Option<u32>) -> Settings {
    let mut settings = Settings::of(solver);
    settings.tolerance = tolerance.unwrap_or(settings.tolerance);
    settings.max_passes = passes.map_or(settings.max_passes, |passes| passes as usize);
    settings
}

impl From<TestArgs> for TestJob {
    fn from(args: TestArgs) -> TestJob {
        let seed = args.seed.unwrap_or(1);
        TestJob {
            model: args.model.into(),
            data: data(args.data),
            null: args.null.into(),
            bootstrap: BootstrapChoice::of(args.bootstrap.map(|n| n as usize), seed),
            out: args.out,
            settings: settings(Solver::Newton, args.tolerance, args.max_iterations),
        }
    }
}

impl From<FitArgs> for FitJob {
    fn from(args: FitArgs) -> FitJob {
        let mut settings = settings(args.solver, args.tolerance, args.max_iterations);
        settings.criterion = args.criterion;
        settings.phases = args.phases;
        let choices = Choices {
            std_errors: args.std_errors,
            intervals: args.intervals,
            df: args.df.unwrap_or_default(),
            deletion: args.deletion,
            tests: if args.no_tests { TestsChoice::None } else { TestsChoice::Each },
        };
        let search = dynamic::Settings {
            method: Method::Hybrid,
            inner: settings.clone(),
            starts: args.starts.unwrap_or(0) as usize,
            seed: args.seed.unwrap_or(1),
        };
        FitJob {
            model: args.model.into(),
            data: data(args.data),
            out: args.out,
            report: args.report,
            tables: FitTables {
                tests: args.tests,
                parameters: args.parameters,
                constraints: args.constraints,
                rows: args.rows,
            },
            settings,
            search,
            method: args.method,
            choices,
            innovations: args.innovations && !args.no_tests,
            group_test: args.group_test,
            keeps_stopped: true,
        }
    }
}

impl From<ExchangeArgs> for ExchangeJob {
    fn from(args: ExchangeArgs) -> ExchangeJob {
        ExchangeJob {
            model: args.model.into(),
            data: data(args.data),
            at: args.from.map(Into::into),
            out: Some(args.out),
        }
    }
}

impl From<SumsArgs> for SumsJob {
    fn from(args: SumsArgs) -> SumsJob {
        SumsJob {
            model: args.model.into(),
            data: data(args.data),
            at: args.at.map(Into::into),
            at_least: args.at_least as usize,
            out: args.out,
        }
    }
}

impl From<JoinArgs> for JoinJob {
    fn from(args: JoinArgs) -> JoinJob {
        JoinJob {
            model: args.model.into(),
            sums: args.sums.into_iter().map(Into::into).collect(),
            criterion: args.criterion,
            out: args.out,
            fit: args.fit,
        }
    }
}

impl From<CheckArgs> for CheckJob {
    fn from(args: CheckArgs) -> CheckJob {
        CheckJob { model: args.model.into(), data: data(args.data), out: args.out }
    }
}

impl From<SimulateArgs> for SimulateJob {
    fn from(args: SimulateArgs) -> SimulateJob {
        SimulateJob {
            model: args.model.into(),
            from: args.truth.from.into(),
            design: data(args.truth.design),
            tests: args.tests,
            plan: args.plan.map(Into::into),
            seed: args.seed,
            out: Some(args.out),
            states: args.states,
        }
    }
}

impl From<PlanArgs> for PlanJob {
    fn from(args: PlanArgs) -> PlanJob {
        let request = match args.budget {
            Some(budget) => PlanRequest::Best(Box::new(BestPlanRequest {
                candidates: data(args.candidates),
                budget,
                cost: args.cost,
                most: args.most,
                goal: args.goal.unwrap_or_else(|| "D".to_owned()),
                so_far: SoFar::of_paths(args.with),
                draws: args.draws.map(|count| (count as usize, args.seed.unwrap_or(1))),
                mission: data(args.mission),
                outputs: args.outputs.map(Into::into),
            })),
            None => PlanRequest::Design(DesignPlan {
                design: data(args.design),
                tests: args.tests.into_iter().map(|n| n as usize).collect(),
                groups: args.groups,
            }),
        };
        PlanJob { model: args.model.into(), from: args.from.into(), request, out: args.out }
    }
}

impl From<ValidateArgs> for ValidateJob {
    fn from(args: ValidateArgs) -> ValidateJob {
        let drawn = || FoldChoice::Drawn { count: args.folds.unwrap_or(10) as usize, seed: args.seed.unwrap_or(1) };
        ValidateJob {
            model: args.model.into(),
            data: data(args.data),
            folds: args.by.map_or_else(drawn, FoldChoice::Column),
            against: args.against.map(Into::into),
            criterion: args.criterion,
            out: args.out,
        }
    }
}

impl From<PredictArgs> for PredictJob {
    fn from(args: PredictArgs) -> PredictJob {
        let sides = if args.one_sided { Sides::One } else { Sides::Two };
        PredictJob {
            model: args.model.into(),
            from: args.from.into(),
            design: data(args.design),
            outputs: args.outputs.map(Into::into),
            limits: Limits { confidence: args.confidence, content: args.content, sides },
            units: args.units,
            profile: data(args.profile),
            out: args.out.into(),
        }
    }
}

impl From<ApplyArgs> for ApplyJob {
    fn from(args: ApplyArgs) -> ApplyJob {
        ApplyJob {
            model: args.model.into(),
            data: data(args.data),
            from: args.from.into(),
            tests: args.out.into(),
            states: args.states.into(),
            kind: args.kind.unwrap_or(StateKind::Smoothed),
        }
    }
}

impl From<ExportArgs> for ExportJob {
    fn from(args: ExportArgs) -> ExportJob {
        ExportJob {
            model: args.model.into(),
            from: args.from.into(),
            phase: args.phase,
            step: args.step,
            at: args.at,
            format: args.form,
            out: Some(args.out),
        }
    }
}

impl From<DatasheetArgs> for DatasheetJob {
    fn from(args: DatasheetArgs) -> DatasheetJob {
        DatasheetJob {
            model: args.model.into(),
            from: args.from.into(),
            data: data(args.data),
            step: args.step,
            at: args.at,
            out: args.out,
        }
    }
}

impl From<CompareArgs> for CompareJob {
    fn from(args: CompareArgs) -> CompareJob {
        CompareJob { fits: args.fits.into_iter().map(Into::into).collect(), out: args.out }
    }
}

impl From<ReportArgs> for ReportJob {
    fn from(args: ReportArgs) -> ReportJob {
        let ReportArgs { fit, out, test } = args;
        ReportJob { fit: fit.into(), test: test.map(Into::into), out: Some(out) }
    }
}

impl From<PlotArgs> for PlotJob {
    fn from(args: PlotArgs) -> PlotJob {
        PlotJob {
            fit: args.fit.into(),
            what: args.what,
            model: args.model.map(|model| ModelJob { document: model.into(), set: Vec::new() }),
            data: data(args.data),
            test: args.test,
            width: args.width,
            out: args.out,
        }
    }
}
