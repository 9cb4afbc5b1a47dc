//! What can be typed. Every option does something; what it does is said here once, and the help shows it.

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{ArgAction, Args as Group, ColorChoice, Parser, Subcommand};
use clap_complete::Shell;
use kalfit::apply::StateKind;
use kalfit::estimate::{Combination, Criterion, Solver};
use kalfit::infer::{DeletionChoice, DfChoice, IntervalKind, StdErrors};
use kalfit_job::words::{self, OptionWord};
use kalfit_job::{ExportFormat, MethodChoice, PredictedUnits};
use kalfit_report::{PlotKind, WIDTHS};

use crate::examples;
use crate::templates::Template;

/// Error models from ensembles of non-identical tests, by maximum likelihood.
#[derive(Debug, Parser)]
#[command(
    name = "kalfit",
    version,
    long_version = long_version(),
    max_term_width = 100,
    after_help = examples::PROGRAM
)]
pub(crate) struct Args {
    #[command(flatten)]
    pub(crate) global: GlobalArgs,

    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Headings of the help.
const GLOBAL: &str = "Global options";
const MODEL: &str = "Model";
const SEARCH: &str = "Search";
const INFERENCE: &str = "Inference";
const OUTPUT: &str = "Output";
const PLAN_OF_DESIGN: &str = "Numbers of tests like those of a design";
const BEST_PLAN: &str = "The best plan among candidates";

/// Options of every command.
#[derive(Debug, Group)]
pub(crate) struct GlobalArgs {
    /// Print nothing but errors
    #[arg(short, long, global = true, help_heading = GLOBAL)]
    pub(crate) quiet: bool,

    /// Threads to use, at most four for each processor; the results do not depend on it [default: all processors]
    #[arg(short = 'j', long, value_name = "N", global = true, help_heading = GLOBAL,
          value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) threads: Option<u16>,

    /// When to colour what is printed: `auto`, `always` or `never`
    #[arg(long, value_name = "WHEN", default_value = "auto", global = true, help_heading = GLOBAL, hide_possible_values = true)]
    pub(crate) color: ColorChoice,

    /// Processor instructions to use: `portable`, `neon`, `avx2` or `avx512`; with the same choice, all machines give the same bits
    /// [default: the widest; or the variable KALFIT_INSTRUCTIONS]
    #[arg(long, value_name = "SET", global = true, help_heading = GLOBAL)]
    pub(crate) instructions: Option<String>,
}

/// The version, with the commit where that is known.
fn long_version() -> &'static str {
    match env!("KALFIT_COMMIT") {
        "" => env!("CARGO_PKG_VERSION"),
        _ => concat!(env!("CARGO_PKG_VERSION"), " (commit ", env!("KALFIT_COMMIT"), ")"),
    }
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Write a starter model with comments, and a small data set; both run as they are
    Init(InitArgs),
    /// Fit a model to data: print a summary, write all results to a file
    Fit(FitArgs),
    /// Run the filters once with known parameters and write the reduced data: all that a fit needs
    #[command(after_help = examples::REDUCE)]
    Reduce(ExchangeArgs),
    /// Run the `[filter]` of each phase, optimal or not, and write its estimates with their errors
    #[command(after_help = examples::ESTIMATES)]
    Estimates(ExchangeArgs),
    /// Sum over the tests of one place, for a fit of tests in several places that exchange nothing else
    Sums(SumsArgs),
    /// Put the sums of all places together: write what each of them is asked next, or the fit
    Join(JoinArgs),
    /// Test a hypothesis within a model by a likelihood-ratio test
    Test(TestArgs),
    /// Describe a model in words, count the data, and say what they can identify; nothing is fitted
    Check(CheckArgs),
    /// Draw an ensemble of tests from a fit, or from the values in a model
    Simulate(SimulateArgs),
    /// Expected standard errors for different numbers of tests, before any test is run
    Plan(PlanArgs),
    /// Apply a fitted model to old or new tests: whether they belong to the population, and their states
    Apply(ApplyArgs),
    /// Cross-validate: how well a model predicts tests that were left out, and whether another does better
    Validate(ValidateArgs),
    /// Predict a test that has not been made: means, spreads and limits of states and outputs
    Predict(PredictArgs),
    /// Write the filter of a fit for other programs: JSON, numpy, Matlab, C or Python
    Export(ExportArgs),
    /// Datasheet numbers in their usual units: random walks, turn-on repeatability, Allan deviations
    Datasheet(DatasheetArgs),
    /// Compare fits of the same data: likelihoods, AIC, BIC, likelihood-ratio tests of nested fits
    Compare(CompareArgs),
    /// Make the report of a fit, one HTML page, from its results
    Report(ReportArgs),
    /// Draw a figure of a fit as SVG, PDF or PNG
    Plot(PlotArgs),
    /// Print the JSON Schema of model files, with which editors complete keys and find mistakes
    #[command(after_help = examples::SCHEMA)]
    Schema,
    /// Print the script that completes commands and options in a shell
    Completions(CompletionsArgs),
    /// Print the manual page, or write the pages of all commands to a folder
    Man(ManArgs),
}

#[derive(Debug, Group)]
#[command(after_help = examples::INIT)]
pub(crate) struct InitArgs {
    /// Template to start from; without it the templates are listed
    #[arg(value_enum)]
    pub(crate) template: Option<Template>,

    /// Folder for the files, made if it does not exist [default: this folder]
    pub(crate) dir: Option<PathBuf>,
}

#[derive(Debug, Group)]
#[command(after_help = examples::COMPLETIONS)]
pub(crate) struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    pub(crate) shell: Shell,
}

#[derive(Debug, Group)]
#[command(after_help = examples::MAN)]
pub(crate) struct ManArgs {
    /// Folder for the pages, made if it does not exist; existing pages are replaced
    pub(crate) dir: Option<PathBuf>,
}

/// Options that say what the model and the data are.
#[derive(Debug, Group)]
pub(crate) struct ModelArgs {
    /// Model file (TOML)
    pub(crate) model: PathBuf,

    /// Fix a parameter: `tau=90`, or `sigma[A]=0.7` at one level; may be given many times
    #[arg(long, value_name = "NAME=VALUE", help_heading = MODEL)]
    pub(crate) set: Vec<String>,
}

#[derive(Debug, Group)]
#[command(after_help = examples::FIT)]
pub(crate) struct FitArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    #[arg(required = true)]
    pub(crate) data: Vec<String>,

    /// File for all results, as JSON; `-` writes them to standard output in place of the summary
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: Option<PathBuf>,

    /// File for a report: one self-contained HTML page; for data with times it also shows records
    #[arg(long, help_heading = OUTPUT, value_name = "FILE.html")]
    pub(crate) report: Option<PathBuf>,

    /// File for a table of the tests: distance, likelihood, innovations, influence, posterior. `.parquet`, `.arrow`, `.csv` or `.tsv`
    #[arg(long, help_heading = OUTPUT, value_name = "FILE", conflicts_with = "no_tests")]
    pub(crate) tests: Option<PathBuf>,

    /// File for a table of all estimates: means, spreads, correlations and parameters, with standard errors and intervals
    #[arg(long, help_heading = OUTPUT, value_name = "FILE")]
    pub(crate) parameters: Option<PathBuf>,

    /// File for a table of the constraints, with a score test of each
    #[arg(long, help_heading = OUTPUT, value_name = "FILE")]
    pub(crate) constraints: Option<PathBuf>,

    /// File for a table of the measurements that contradict the others of their test
    #[arg(long, help_heading = OUTPUT, value_name = "FILE", conflicts_with = "no_tests")]
    pub(crate) rows: Option<PathBuf>,

    /// How free dynamic parameters are estimated
    #[arg(long, help_heading = SEARCH, value_parser = one_of(words::METHODS), default_value = words::METHODS[0].word)]
    pub(crate) method: MethodChoice,

    /// Additional random starts of the search for dynamic parameters [default: 0]
    #[arg(long, help_heading = SEARCH, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=10_000))]
    pub(crate) starts: Option<u32>,

    /// Seed of the random starts [default: 1]
    #[arg(long, help_heading = SEARCH, value_name = "N", requires = "starts")]
    pub(crate) seed: Option<u64>,

    /// How the mean and the covariance are estimated
    #[arg(long, help_heading = SEARCH, value_parser = one_of(words::SOLVERS), default_value = words::SOLVERS[0].word)]
    pub(crate) solver: Solver,

    /// Likelihood that is maximised
    #[arg(long, help_heading = SEARCH, value_parser = one_of(words::CRITERIA), default_value = words::CRITERIA[0].word)]
    pub(crate) criterion: Criterion,

    /// How the phases of a test are combined
    #[arg(long, help_heading = SEARCH, value_parser = one_of(words::PHASES), default_value = words::PHASES[0].word)]
    pub(crate) phases: Combination,

    /// Stop within this many standard errors of the optimum [default: 1e-8]
    #[arg(long, help_heading = SEARCH, value_name = "T", value_parser = tolerance)]
    pub(crate) tolerance: Option<f64>,

    /// Stop after this many iterations [default: 200 with newton, 20000 with em]
    #[arg(long, help_heading = SEARCH, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) max_iterations: Option<u32>,

    /// How 95 % intervals are computed
    #[arg(long, help_heading = INFERENCE, value_parser = one_of(words::INTERVALS), default_value = words::INTERVALS[0].word)]
    pub(crate) intervals: IntervalKind,

    /// How degrees of freedom of means are computed, with `--criterion reml` [default: kenward-roger]
    #[arg(long, help_heading = INFERENCE, value_parser = one_of(words::DF), value_name = "DF")]
    pub(crate) df: Option<DfChoice>,

    /// How standard errors are computed
    #[arg(long, help_heading = INFERENCE, value_parser = one_of(words::STD_ERRORS), default_value = words::STD_ERRORS[0].word)]
    pub(crate) std_errors: StdErrors,

    /// Whether to repeat the fit without each test in turn, to find influential tests
    #[arg(long, help_heading = INFERENCE, value_parser = one_of(words::DELETIONS), default_value = words::DELETIONS[0].word)]
    pub(crate) deletion: DeletionChoice,

    /// Whether to compute the innovations of each test, to check the model
    #[arg(long, help_heading = INFERENCE, value_parser = one_of(words::INNOVATIONS), value_name = "WHEN", default_value = words::INNOVATIONS[0].word,
          action = ArgAction::Set)]
    pub(crate) innovations: bool,

    /// Also fit each group of `[data] group` separately, and test whether the groups differ
    #[arg(long, help_heading = INFERENCE)]
    pub(crate) group_test: bool,

    /// Leave out all results of single tests (estimates, innovations, influence): for millions of tests, where they would take more
    /// time and memory than the fit
    #[arg(long, help_heading = OUTPUT, conflicts_with_all = ["deletion", "innovations"])]
    pub(crate) no_tests: bool,
}

#[derive(Debug, Group)]
#[command(after_help = examples::TEST)]
pub(crate) struct TestArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    #[arg(required = true)]
    pub(crate) data: Vec<String>,

    /// File of the hypothesis (TOML)
    #[arg(long, value_name = "NULL")]
    pub(crate) null: PathBuf,

    /// Draw this many ensembles from the hypothesis and repeat the test in each: a p-value without large-sample theory; 0 for none [default: 999 with at most 50 tests or units and known parameters]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    pub(crate) bootstrap: Option<u32>,

    /// Seed of the bootstrap [default: 1]
    #[arg(long, value_name = "S")]
    pub(crate) seed: Option<u64>,

    /// File for the results, as JSON; `-` writes them to standard output in place of the summary
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: Option<PathBuf>,

    /// Stop within this many standard errors of the optimum [default: 1e-8]
    #[arg(long, value_name = "T", value_parser = tolerance)]
    pub(crate) tolerance: Option<f64>,

    /// Stop a fit after this many iterations [default: 200]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) max_iterations: Option<u32>,
}

#[derive(Debug, Group)]
pub(crate) struct ExchangeArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    #[arg(required = true)]
    pub(crate) data: Vec<String>,

    /// Results of `kalfit fit`: free parameters of the model get their values from there
    #[arg(long, value_name = "FIT.json", alias = "at")]
    pub(crate) from: Option<PathBuf>,

    /// File to write: `.parquet`
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: PathBuf,
}

#[derive(Debug, Group)]
#[command(after_help = examples::SUMS)]
pub(crate) struct SumsArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data of this place: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    #[arg(required = true)]
    pub(crate) data: Vec<String>,

    /// What is asked: the last file of `kalfit join --out` [default: what every fit begins with]
    #[arg(long, value_name = "THETA.json")]
    pub(crate) at: Option<PathBuf>,

    /// Refuse to tell sums over fewer tests than this
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) at_least: u32,

    /// File for the sums, as JSON: nothing else of the data is in it
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: PathBuf,
}

#[derive(Debug, Group)]
#[command(after_help = examples::JOIN)]
pub(crate) struct JoinArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// The sums of all places, one file of `kalfit sums --out` each
    #[arg(required = true, value_name = "SUMS")]
    pub(crate) sums: Vec<PathBuf>,

    /// What is maximised; the same in every round
    #[arg(long, value_parser = one_of(words::CRITERIA), default_value = words::CRITERIA[0].word)]
    pub(crate) criterion: Criterion,

    /// File for what is asked next
    #[arg(short, long, value_name = "THETA.json", help_heading = OUTPUT)]
    pub(crate) out: PathBuf,

    /// File for the results, which is written when the search has ended, and not before
    #[arg(long, value_name = "FIT.json", default_value = "fit.json", help_heading = OUTPUT)]
    pub(crate) fit: PathBuf,
}

#[derive(Debug, Group)]
#[command(after_help = examples::CHECK)]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    pub(crate) data: Vec<String>,

    /// File for what was found, as JSON; `-` writes it to standard output in place of the summary
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: Option<PathBuf>,
}

/// Where the population and the design come from.
#[derive(Debug, Group)]
pub(crate) struct TruthArgs {
    /// Where the true population comes from: results of `kalfit fit`, or a model file with fixed or start values. Free parameters
    /// of MODEL get their values from there too
    #[arg(long, value_name = "FIT.json|MODEL.toml")]
    pub(crate) from: PathBuf,

    /// Data that give times, inputs and missing values; the measured values in them are not used
    #[arg(long, required = true, num_args = 1.., value_name = "DATA")]
    pub(crate) design: Vec<String>,
}

#[derive(Debug, Group)]
#[command(after_help = examples::SIMULATE)]
pub(crate) struct SimulateArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    #[command(flatten)]
    pub(crate) truth: TruthArgs,

    /// Number of tests to draw. The tests of the design are used in turn; from the second round on they get ids such as `A#2`
    /// [default: as many as the design has]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    pub(crate) tests: Option<u64>,

    /// A best plan by `kalfit plan --candidates … --out`: the tests of the design, which are its candidates, are drawn as often as it says
    #[arg(long, value_name = "PLAN.json", conflicts_with = "tests")]
    pub(crate) plan: Option<PathBuf>,

    /// Seed: the same seed draws the same ensemble
    #[arg(long, value_name = "S")]
    pub(crate) seed: u64,

    /// File for the data: `.csv`, `.tsv`, `.parquet` or `.arrow`
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: PathBuf,

    /// File for the true initial state of each test: `.csv`, `.tsv`, `.parquet` or `.arrow`
    #[arg(long = "truth", value_name = "FILE")]
    pub(crate) states: Option<PathBuf>,
}

#[derive(Debug, Group)]
#[command(after_help = examples::PLAN)]
pub(crate) struct PlanArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Where the true population comes from: results of `kalfit fit`, or a model file with fixed or start values. Free parameters
    /// of MODEL get their values from there too
    #[arg(long, value_name = "FIT.json|MODEL.toml")]
    pub(crate) from: PathBuf,

    /// Data that give times, inputs and missing values of a design; the measured values in them are not used
    #[arg(long, num_args = 1.., value_name = "DATA", required_unless_present = "candidates", requires = "tests",
          help_heading = PLAN_OF_DESIGN)]
    pub(crate) design: Vec<String>,

    /// Numbers of tests, each like those of the design: `5,10,20,50`
    #[arg(long, value_delimiter = ',', value_name = "N,N,...", requires = "design",
          value_parser = clap::value_parser!(u32).range(1..=1_000_000_000), help_heading = PLAN_OF_DESIGN)]
    pub(crate) tests: Vec<u32>,

    /// For a model with levels: numbers of groups of a level in each group of the level above, `serial=5,10,20`, once for each level;
    /// `--tests` is then the number of tests in each group of the innermost level
    #[arg(long, value_name = "LEVEL=N,N,...", value_parser = groups, requires = "design", help_heading = PLAN_OF_DESIGN)]
    pub(crate) groups: Vec<(String, Vec<usize>)>,

    /// Data whose tests are the kinds of tests that could be made; for a model with levels its units of the outermost level.
    /// The measured values are not used
    #[arg(long, num_args = 1.., value_name = "DATA", conflicts_with_all = ["design", "tests", "groups"], requires = "budget",
          help_heading = BEST_PLAN)]
    pub(crate) candidates: Vec<String>,

    /// Largest cost of all tests together
    #[arg(long, value_name = "COST", requires = "candidates", conflicts_with = "design", value_parser = length,
          allow_negative_numbers = true, help_heading = BEST_PLAN)]
    pub(crate) budget: Option<f64>,

    /// Column of the cost of one test, constant in each candidate [default: `cost` where there is one, else 1]
    #[arg(long, value_name = "COLUMN", requires = "candidates", help_heading = BEST_PLAN)]
    pub(crate) cost: Option<String>,

    /// Column of the largest number of tests, constant in each candidate [default: `most` where there is one, else no limit]
    #[arg(long, value_name = "COLUMN", requires = "candidates", help_heading = BEST_PLAN)]
    pub(crate) most: Option<String>,

    /// What is to become best known: `D` (all that is free), `A` (the means, over their standard deviations), figures such as
    /// `sd(scale)`, `mean(bias)`, `corr(bias, scale)`, `coefficient(bias, T)` or a parameter's name, or `D(…)` of figures; with
    /// `--mission` also `output(NAME, 3)` and `limit(NAME, 3)` [default: D]
    #[arg(long = "for", value_name = "FIGURE", requires = "candidates", help_heading = BEST_PLAN)]
    pub(crate) goal: Option<String>,

    /// What is known already: results of `kalfit fit`, or data of tests that were made
    #[arg(long, num_args = 1.., value_name = "FIT.json|DATA", requires = "candidates", help_heading = BEST_PLAN)]
    pub(crate) with: Vec<PathBuf>,

    /// Plan for this many draws of the parameters by the errors of the fit, too: best on average
    #[arg(long, value_name = "N", requires = "candidates", value_parser = clap::value_parser!(u32).range(1..=1000),
          help_heading = BEST_PLAN)]
    pub(crate) draws: Option<u32>,

    /// A test that has not been made: means of its states and outputs at row 3 are the figures `output(NAME, 3)`, limits below which
    /// 95 % of all tests stay `limit(NAME, 3)`
    #[arg(long, num_args = 1.., value_name = "DATA", requires = "candidates", help_heading = BEST_PLAN)]
    pub(crate) mission: Vec<String>,

    /// With `--mission`: file of outputs, which are linear in the states: `[outputs.NAME] equation = "…"`
    #[arg(long, value_name = "FILE", requires = "mission", help_heading = BEST_PLAN)]
    pub(crate) outputs: Option<PathBuf>,

    /// Seed of the draws [default: 1]
    #[arg(long, value_name = "S", requires = "draws", help_heading = BEST_PLAN)]
    pub(crate) seed: Option<u64>,

    /// File for the plan, as JSON; `-` writes it to standard output in place of the summary
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Debug, Group)]
#[command(after_help = examples::APPLY)]
pub(crate) struct ApplyArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    #[arg(required = true)]
    pub(crate) data: Vec<String>,

    /// Where the population and all parameters come from: results of `kalfit fit`, or a model file with fixed or start values
    #[arg(long, value_name = "FIT.json|MODEL.toml")]
    pub(crate) from: PathBuf,

    /// File for a table of the tests: posterior, distance, log density, innovations. `.parquet`, `.arrow`, `.csv` or `.tsv`
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: Option<PathBuf>,

    /// File for a table of the states at every step of every test, with predictions of the measured values
    #[arg(long, value_name = "FILE")]
    pub(crate) states: Option<PathBuf>,

    /// Which measurements the states of a step are estimated from [default: smoothed]
    #[arg(long, value_parser = one_of(words::KINDS), requires = "states")]
    pub(crate) kind: Option<StateKind>,
}

#[derive(Debug, Group)]
#[command(after_help = examples::VALIDATE)]
pub(crate) struct ValidateArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    #[arg(required = true)]
    pub(crate) data: Vec<String>,

    /// Number of folds; with as many folds as tests, each test is left out by itself [default: 10]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..), conflicts_with = "by")]
    pub(crate) folds: Option<u32>,

    /// Seed of the draw [default: 1]
    #[arg(long, value_name = "N", conflicts_with = "by")]
    pub(crate) seed: Option<u64>,

    /// Column of the data: tests with the same text in it are a fold
    #[arg(long, value_name = "COLUMN")]
    pub(crate) by: Option<String>,

    /// Another model of the same measurements, to compare with on the same folds; `--set` applies to the first model only
    #[arg(long, value_name = "OTHER.toml")]
    pub(crate) against: Option<PathBuf>,

    /// Likelihood that the fits maximise
    #[arg(long, value_parser = one_of(words::CRITERIA), default_value = words::CRITERIA[0].word)]
    pub(crate) criterion: Criterion,

    /// File for all results, as JSON; `-` writes them to standard output in place of the summary
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Debug, Group)]
#[command(after_help = examples::PREDICT)]
pub(crate) struct PredictArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Where the population and all parameters come from: results of `kalfit fit`, or a model file with fixed or start values
    #[arg(long, value_name = "FIT.json|MODEL.toml")]
    pub(crate) from: PathBuf,

    /// Times and inputs of the tests, one row per step: data of the model without its measurements; may be given many times
    #[arg(long, required = true, value_name = "FILE")]
    pub(crate) design: Vec<String>,

    /// File of outputs, which are linear in the states: `[outputs.NAME] equation = "…"`
    #[arg(long, value_name = "OUT.toml")]
    pub(crate) outputs: Option<PathBuf>,

    /// Confidence of the limits
    #[arg(long, value_name = "P", default_value_t = 0.9, value_parser = part)]
    pub(crate) confidence: f64,

    /// Part of all tests that is within the tolerance limits
    #[arg(long, value_name = "P", default_value_t = 0.95, value_parser = part)]
    pub(crate) content: f64,

    /// One-sided tolerance limits: that part of all tests is below the upper one, and that part above the lower one
    #[arg(long)]
    pub(crate) one_sided: bool,

    /// Whether the tests are of new or of known units, for models with levels
    #[arg(long, value_parser = one_of(words::UNITS), default_value = words::UNITS[0].word)]
    pub(crate) units: PredictedUnits,

    /// Data of the fit: limits of the mean by profile likelihood in place of standard errors; may be given many times
    #[arg(long, value_name = "DATA")]
    pub(crate) profile: Vec<String>,

    /// File for a table of all states and outputs at every row. `.parquet`, `.arrow`, `.csv` or `.tsv`
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: Option<PathBuf>,
}

/// A number from a half to less than 1.
fn part(text: &str) -> Result<f64, String> {
    let wrong = || "expected a number from 0.5 to 0.999999, such as 0.9".to_owned();
    text.parse().ok().filter(|part| (0.5..=1.0 - 1e-6).contains(part)).ok_or_else(wrong)
}

#[derive(Debug, Group)]
#[command(after_help = examples::EXPORT)]
pub(crate) struct ExportArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Where the population and all parameters come from: results of `kalfit fit`, or a model file with fixed or start values
    #[arg(long, value_name = "FIT.json|MODEL.toml")]
    pub(crate) from: PathBuf,

    /// Length of a step, in the model's unit of time; needed where anything depends on it
    #[arg(long, value_name = "DT", value_parser = length, allow_negative_numbers = true)]
    pub(crate) step: Option<f64>,

    /// Value of a column on all rows, where coefficients of states or noise depend on it: `temperature=20`; may be given many times
    #[arg(long, value_name = "COLUMN=VALUE")]
    pub(crate) at: Vec<String>,

    /// Phase whose filter is written, for models with several phases
    #[arg(long, value_name = "NAME")]
    pub(crate) phase: Option<String>,

    /// What to write [default: as the ending of the file says: `.json`, `.npz`, `.mat`, `.h` or `.py`]
    #[arg(long = "as", value_parser = one_of(words::EXPORT_FORMATS), value_name = "FORM")]
    pub(crate) form: Option<ExportFormat>,

    /// File for the filter
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: PathBuf,
}

#[derive(Debug, Group)]
#[command(after_help = examples::DATASHEET)]
pub(crate) struct DatasheetArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data whose Allan deviations are compared with those of the model: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    pub(crate) data: Vec<String>,

    /// Where the population and all parameters come from: results of `kalfit fit`, or a model file with fixed or start values
    #[arg(long, value_name = "FIT.json|MODEL.toml")]
    pub(crate) from: PathBuf,

    /// Time between values, in the model's unit of time, if there are no data
    #[arg(long, value_name = "DT", value_parser = length, allow_negative_numbers = true, conflicts_with = "data")]
    pub(crate) step: Option<f64>,

    /// Value of a column on all rows, where noise or motion depend on it: `temperature=20`; may be given many times
    #[arg(long, value_name = "COLUMN=VALUE")]
    pub(crate) at: Vec<String>,

    /// File for all numbers, as JSON; `-` writes them to standard output in place of the summary
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Debug, Group)]
#[command(after_help = examples::COMPARE)]
pub(crate) struct CompareArgs {
    /// Two or more results of `kalfit fit --out` for the same data, of `kalfit validate --out`, or both
    #[arg(required = true, num_args = 2.., value_name = "FIT.json")]
    pub(crate) fits: Vec<PathBuf>,

    /// File for the comparison, as JSON; `-` writes it to standard output in place of the summary
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Debug, Group)]
#[command(after_help = examples::REPORT)]
pub(crate) struct ReportArgs {
    /// Results of `kalfit fit --out`
    #[arg(value_name = "FIT.json")]
    pub(crate) fit: PathBuf,

    /// File for the report
    #[arg(short, long, value_name = "FILE.html", help_heading = OUTPUT)]
    pub(crate) out: PathBuf,

    /// Results of `kalfit test --out`: compare the fit with the tested hypothesis
    #[arg(long, value_name = "TEST.json")]
    pub(crate) test: Option<PathBuf>,
}

#[derive(Debug, Group)]
#[command(after_help = examples::PLOT)]
pub(crate) struct PlotArgs {
    /// Results of `kalfit fit --out`; with `--what sensitivities` those of `kalfit plan --candidates`
    #[arg(value_name = "FIT.json")]
    pub(crate) fit: PathBuf,

    /// With `--what records`, `residuals`, `quantiles` or `allan`: the data of the fit, or new data
    pub(crate) data: Vec<String>,

    /// What the figure shows
    #[arg(long, value_parser = one_of(words::FIGURES), default_value = words::FIGURES[0].word)]
    pub(crate) what: PlotKind,

    /// With `--what records`, `residuals`, `quantiles` or `allan`: the model file
    #[arg(long, value_name = "MODEL")]
    pub(crate) model: Option<PathBuf>,

    /// With `--what records`, `residuals` or `quantiles`: the test to show [default: the least probable]
    #[arg(long, value_name = "ID")]
    pub(crate) test: Option<String>,

    /// Width in points of a screen; the height follows from it, and a PNG has two pixels in a point
    #[arg(long, value_name = "POINTS", default_value_t = 800,
          value_parser = clap::value_parser!(u32).range(i64::from(*WIDTHS.start())..=i64::from(*WIDTHS.end())))]
    pub(crate) width: u32,

    /// File for the figure: `.svg`, `.pdf` or `.png`
    #[arg(short, long, value_name = "FILE", help_heading = OUTPUT)]
    pub(crate) out: PathBuf,
}

/// One of the words of an option, each with its help.
fn one_of<T: Copy + Send + Sync + 'static>(words: &'static [OptionWord<T>]) -> impl TypedValueParser<Value = T> {
    let known = words.iter().map(|own| PossibleValue::new(own.word).help(own.help));
    PossibleValuesParser::new(known).try_map(move |text| {
        let own = words.iter().find(|own| own.word == text);
        own.map(|own| own.means).ok_or("no such word")
    })
}

fn tolerance(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if value > 0.0 && value <= 1.0 => Ok(value),
        _ => Err("expected a number above 0 and at most 1".to_owned()),
    }
}

/// Of a step.
fn length(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("expected a number above 0".to_owned()),
    }
}

/// `LEVEL=N,N,...`.
fn groups(text: &str) -> Result<(String, Vec<usize>), String> {
    let wrong = || format!("found `{text}`, expected LEVEL=N,N,... with numbers from 1 to 1000000");
    let (name, counts) = text.rsplit_once('=').ok_or_else(wrong)?;
    let one = |count: &str| count.trim().parse::<usize>().ok().filter(|n| (1..=1_000_000).contains(n));
    let counts: Option<Vec<usize>> = counts.split(',').map(one).collect();
    Ok((name.to_owned(), counts.filter(|counts| !counts.is_empty()).ok_or_else(wrong)?))
}
