//! What can be typed. Every option does something; what it does is said here once, and the help shows it.

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{ArgAction, Args as Group, Parser, Subcommand};
use clap_complete::Shell;
use kalfit::apply::StateKind;
use kalfit::estimate::{Combination, Criterion, Solver};
use kalfit::infer::{DeletionChoice, IntervalKind, StdErrors};
use kalfit_job::words::{self, Word};
use kalfit_job::{Form, MethodChoice, Units};

use crate::examples;
use crate::templates::Template;

/// Error models from ensembles of non-identical tests, by maximum likelihood.
#[derive(Debug, Parser)]
#[command(
    name = "kalfit",
    version,
    max_term_width = 100,
    after_help = examples::PROGRAM
)]
pub(crate) struct Args {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Write a starter model, with comments, and a small data set: both run as they are
    Init(InitArgs),
    /// Fit a model to data: a summary to standard output, all results to a file
    Fit(FitArgs),
    /// Run the filters once, at known parameters, and write what they make of the data: all that a fit needs
    #[command(after_help = examples::REDUCE)]
    Reduce(ExchangeArgs),
    /// Run the `[filter]` of each phase, optimal or not, and write its estimates with the errors they make
    #[command(after_help = examples::ESTIMATES)]
    Estimates(ExchangeArgs),
    /// Sums over the tests of one place, for a fit of tests in several places that exchange nothing else
    Sums(SumsArgs),
    /// Put the sums of all places together: what is asked next of each of them, or the fit
    Join(JoinArgs),
    /// Test a hypothesis within a model by the ratio of the likelihoods
    Test(TestArgs),
    /// Read a model, and data if given, and fit nothing: the model in words, counts, what the data identify
    Check(CheckArgs),
    /// Draw an ensemble of tests from a fit, or from the values of a model
    Simulate(SimulateArgs),
    /// Expected standard errors against the number of tests, before any is run
    Plan(PlanArgs),
    /// Apply a fitted model to tests, old or new: are they of the population, and what were their states
    Apply(ApplyArgs),
    /// How well a model predicts tests that it was not fitted to, and whether another one does so better
    Validate(ValidateArgs),
    /// What a test that nobody has made will give: means, spread and limits of states and outputs
    Predict(PredictArgs),
    /// The filter that follows from a fit, for programs that are not kalfit: JSON, numpy, Matlab, C or Python
    Export(ExportArgs),
    /// The numbers of a datasheet, in its units: random walks, Gauss-Markov pairs, turn-on repeatability, Allan deviations
    Datasheet(DatasheetArgs),
    /// Fits of the same data side by side: likelihoods, AIC and BIC, tests of one within another
    Compare(CompareArgs),
    /// The report of a fit, one HTML page, from its results alone
    Report(ReportArgs),
    /// The script that completes commands and options in a shell, to standard output
    Completions(CompletionsArgs),
    /// The manual page, to standard output, or the pages of all commands, to a folder
    Man(ManArgs),
}

#[derive(Debug, Group)]
#[command(after_help = examples::INIT)]
pub(crate) struct InitArgs {
    /// What to start from
    #[arg(value_enum)]
    pub(crate) template: Template,

    /// Folder for the files, made if it does not exist [default: this folder]
    pub(crate) dir: Option<PathBuf>,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
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
    /// Folder for the pages, made if it does not exist; pages that are there are replaced
    pub(crate) dir: Option<PathBuf>,
}

/// Options that say what the model and the data are.
#[derive(Debug, Group)]
pub(crate) struct ModelArgs {
    /// Model file (TOML)
    pub(crate) model: PathBuf,

    /// Fix a parameter: `tau=90`, or `sigma[A]=0.7` at one level; may be given many times
    #[arg(long, value_name = "NAME=VALUE")]
    pub(crate) set: Vec<String>,

    /// Threads to use; the results do not depend on it [default: all processors]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) threads: Option<u16>,

    /// Instructions to use: `portable`, `avx2` or `avx512`, for the same bits on every machine that has them [default: the widest;
    /// or the variable KALFIT_INSTRUCTIONS]
    #[arg(long, value_name = "SET")]
    pub(crate) instructions: Option<String>,
}

#[derive(Debug, Group)]
#[command(after_help = examples::FIT)]
pub(crate) struct FitArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    #[arg(required = true)]
    pub(crate) data: Vec<String>,

    /// File for all results, as JSON
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,

    /// File for a report, one HTML page that needs nothing else; of records with times it shows them, too
    #[arg(long, value_name = "FILE.html")]
    pub(crate) report: Option<PathBuf>,

    /// File for a table of the tests: distance, likelihood, innovations, influence, posterior. `.parquet`, `.arrow`, `.csv` or `.tsv`
    #[arg(long, value_name = "FILE", conflicts_with = "no_tests")]
    pub(crate) tests: Option<PathBuf>,

    /// File for a table of all estimates: means, spreads, correlations and parameters, with standard errors and intervals
    #[arg(long, value_name = "FILE")]
    pub(crate) parameters: Option<PathBuf>,

    /// File for a table of the constraints, and what each costs
    #[arg(long, value_name = "FILE")]
    pub(crate) constraints: Option<PathBuf>,

    /// How free dynamic parameters are sought
    #[arg(long, value_parser = one_of(words::METHODS), default_value = words::METHODS[0].word)]
    pub(crate) method: MethodChoice,

    /// Random starts of the search for dynamic parameters, besides the one worked out from the data [default: 0]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=10_000))]
    pub(crate) starts: Option<u32>,

    /// Seed of the random starts [default: 1]
    #[arg(long, value_name = "N", requires = "starts")]
    pub(crate) seed: Option<u64>,

    /// How the mean and the covariance are sought
    #[arg(long, value_parser = one_of(words::SOLVERS), default_value = words::SOLVERS[0].word)]
    pub(crate) solver: Solver,

    /// What is maximised
    #[arg(long, value_parser = one_of(words::CRITERIA), default_value = words::CRITERIA[0].word)]
    pub(crate) criterion: Criterion,

    /// How tests in several phases are put together
    #[arg(long, value_parser = one_of(words::PHASES), default_value = words::PHASES[0].word)]
    pub(crate) phases: Combination,

    /// Stop within this many standard errors of the optimum [default: 1e-8]
    #[arg(long, value_name = "T", value_parser = tolerance)]
    pub(crate) tolerance: Option<f64>,

    /// Stop after this many passes over the reduced data [default: 200 with newton, 20000 with em]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) max_iterations: Option<u32>,

    /// What 95 % intervals are made of
    #[arg(long, value_parser = one_of(words::INTERVALS), default_value = words::INTERVALS[0].word)]
    pub(crate) intervals: IntervalKind,

    /// What standard errors are made of
    #[arg(long, value_parser = one_of(words::STD_ERRORS), default_value = words::STD_ERRORS[0].word)]
    pub(crate) std_errors: StdErrors,

    /// Whether to fit again without each test in turn
    #[arg(long, value_parser = one_of(words::DELETIONS), default_value = words::DELETIONS[0].word)]
    pub(crate) deletion: DeletionChoice,

    /// Look at each test's innovations after the fit: is the model right for it
    #[arg(long, value_parser = one_of(words::INNOVATIONS), value_name = "WHEN", default_value = words::INNOVATIONS[0].word,
          action = ArgAction::Set)]
    pub(crate) innovations: bool,

    /// Fit each group of `[data] group` by itself too, and say whether the groups differ
    #[arg(long)]
    pub(crate) group_test: bool,

    /// Leave out what each test says, its innovations and the fits without it: `tests` of the results is empty. For millions of
    /// tests, of which that would take more time, memory and disk than the fit
    #[arg(long, conflicts_with_all = ["deletion", "innovations"])]
    pub(crate) no_tests: bool,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
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

    /// Also draw this many ensembles from the hypothesis, and test it in each: no large-sample law is needed
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub(crate) bootstrap: Option<u32>,

    /// Seed of the bootstrap [default: 1]
    #[arg(long, value_name = "S", requires = "bootstrap")]
    pub(crate) seed: Option<u64>,

    /// File for the results, as JSON
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,

    /// Stop within this many standard errors of the optimum [default: 1e-8]
    #[arg(long, value_name = "T", value_parser = tolerance)]
    pub(crate) tolerance: Option<f64>,

    /// Stop a fit after this many passes over the reduced data [default: 200]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) max_iterations: Option<u32>,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Group)]
pub(crate) struct ExchangeArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    #[arg(required = true)]
    pub(crate) data: Vec<String>,

    /// Results of `kalfit fit`: free parameters of the model get their values from there
    #[arg(long, value_name = "FIT.json")]
    pub(crate) at: Option<PathBuf>,

    /// File to write: `.parquet`
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
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
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
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
    #[arg(long, value_name = "THETA.json")]
    pub(crate) out: PathBuf,

    /// File for the results, which is written when the search has ended, and not before
    #[arg(long, value_name = "FIT.json", default_value = "fit.json")]
    pub(crate) fit: PathBuf,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Group)]
#[command(after_help = examples::CHECK)]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    pub(crate) data: Vec<String>,
}

/// Where the population and the design come from.
#[derive(Debug, Group)]
pub(crate) struct TruthArgs {
    /// The true population: results of `kalfit fit`, or a model file, whose fixed values and start values are taken. Free
    /// parameters of MODEL get their values from there too
    #[arg(long, value_name = "FIT.json|MODEL.toml")]
    pub(crate) from: PathBuf,

    /// Data that give times, inputs and which values are missing; measured values in them do not matter
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

    /// Number of tests: those of the design are taken in turn, and after the first round get ids such as `A#2` [default: as
    /// many as the design has]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    pub(crate) tests: Option<u64>,

    /// Seed: the same seed draws the same ensemble
    #[arg(long, value_name = "S")]
    pub(crate) seed: u64,

    /// File for the data: `.csv`, `.tsv`, `.parquet` or `.arrow`
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,

    /// CSV file for the true initial state of each test
    #[arg(long = "truth", value_name = "FILE.csv")]
    pub(crate) states: Option<PathBuf>,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Group)]
#[command(after_help = examples::PLAN)]
pub(crate) struct PlanArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    #[command(flatten)]
    pub(crate) truth: TruthArgs,

    /// Numbers of tests, each like those of the design: `5,10,20,50`
    #[arg(long, required = true, value_delimiter = ',', value_name = "N,N,...",
          value_parser = clap::value_parser!(u32).range(1..=1_000_000_000))]
    pub(crate) tests: Vec<u32>,

    /// Of a model with levels, how many groups of a level in each group of the one above: `serial=5,10,20`, once for each level;
    /// `--tests` is then how many tests in each group of the innermost level
    #[arg(long, value_name = "LEVEL=N,N,...", value_parser = groups)]
    pub(crate) groups: Vec<(String, Vec<usize>)>,

    /// File for the plan, as JSON
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Group)]
#[command(after_help = examples::APPLY)]
pub(crate) struct ApplyArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    #[arg(required = true)]
    pub(crate) data: Vec<String>,

    /// The population and all parameters: results of `kalfit fit`, or a model file, whose fixed values and start values are taken
    #[arg(long, value_name = "FIT.json|MODEL.toml")]
    pub(crate) from: PathBuf,

    /// File for a table of the tests: posterior, distance, log density, innovations. `.parquet`, `.arrow`, `.csv` or `.tsv`
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,

    /// File for a table of the states at every step of every test, and of what they say of each measured value
    #[arg(long, value_name = "FILE")]
    pub(crate) states: Option<PathBuf>,

    /// What the states of a step are told from [default: smoothed]
    #[arg(long, value_parser = one_of(words::KINDS), requires = "states")]
    pub(crate) kind: Option<StateKind>,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Group)]
#[command(after_help = examples::VALIDATE)]
pub(crate) struct ValidateArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    #[arg(required = true)]
    pub(crate) data: Vec<String>,

    /// Number of folds that tests are drawn into; as many as there are tests leave each one out by itself [default: 10]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..), conflicts_with = "by")]
    pub(crate) folds: Option<u32>,

    /// Seed of the draw [default: 1]
    #[arg(long, value_name = "N", conflicts_with = "by")]
    pub(crate) seed: Option<u64>,

    /// Column of the data: tests with the same text in it are a fold
    #[arg(long, value_name = "COLUMN")]
    pub(crate) by: Option<String>,

    /// Another model of the same measurements, to compare with on the same folds; `--set` is for the first model alone
    #[arg(long, value_name = "OTHER.toml")]
    pub(crate) against: Option<PathBuf>,

    /// What the fits maximise
    #[arg(long, value_parser = one_of(words::CRITERIA), default_value = words::CRITERIA[0].word)]
    pub(crate) criterion: Criterion,

    /// File for all results, as JSON
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Group)]
#[command(after_help = examples::PREDICT)]
pub(crate) struct PredictArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// The population and all parameters: results of `kalfit fit`, or a model file, whose fixed values and start values are taken
    #[arg(long, value_name = "FIT.json|MODEL.toml")]
    pub(crate) from: PathBuf,

    /// Times and inputs of the tests, a row for each: data of the model without its measurements; may be given many times
    #[arg(long, required = true, value_name = "FILE")]
    pub(crate) design: Vec<String>,

    /// File of outputs, which are linear in the states: `[outputs.NAME] equation = "…"`
    #[arg(long, value_name = "OUT.toml")]
    pub(crate) outputs: Option<PathBuf>,

    /// How sure the limits are: in this part of all ensembles they hold
    #[arg(long, value_name = "P", default_value_t = 0.9, value_parser = part)]
    pub(crate) confidence: f64,

    /// What part of all tests is within the tolerance limits
    #[arg(long, value_name = "P", default_value_t = 0.95, value_parser = part)]
    pub(crate) content: f64,

    /// Each tolerance limit by itself: that part of all tests is below the upper one, and above the lower one
    #[arg(long)]
    pub(crate) one_sided: bool,

    /// Whose tests they are, where tests stand in groups
    #[arg(long, value_parser = one_of(words::UNITS), default_value = words::UNITS[0].word)]
    pub(crate) units: Units,

    /// File for a table of all states and outputs at every row. `.parquet`, `.arrow`, `.csv` or `.tsv`
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
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

    /// The population and all parameters: results of `kalfit fit`, or a model file, whose fixed values and start values are taken
    #[arg(long, value_name = "FIT.json|MODEL.toml")]
    pub(crate) from: PathBuf,

    /// Length of a step, in the model's unit of time; needed where anything depends on it
    #[arg(long, value_name = "DT", value_parser = length)]
    pub(crate) step: Option<f64>,

    /// A column's value on all rows, where coefficients of states or noise depend on it: `temperature=20`; may be given many times
    #[arg(long, value_name = "COLUMN=VALUE")]
    pub(crate) at: Vec<String>,

    /// The phase whose filter it is, of a model with several
    #[arg(long, value_name = "NAME")]
    pub(crate) phase: Option<String>,

    /// What to write [default: as the ending of the file says: `.json`, `.npz`, `.mat`, `.h` or `.py`]
    #[arg(long = "as", value_parser = one_of(words::FORMS), value_name = "FORM")]
    pub(crate) form: Option<Form>,

    /// File for the filter
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Group)]
#[command(after_help = examples::DATASHEET)]
pub(crate) struct DatasheetArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Records to put beside the model: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    pub(crate) data: Vec<String>,

    /// The population and all parameters: results of `kalfit fit`, or a model file, whose fixed values and start values are taken
    #[arg(long, value_name = "FIT.json|MODEL.toml")]
    pub(crate) from: PathBuf,

    /// Time from a value to the next, in the model's unit of time, where no data say it
    #[arg(long, value_name = "DT", value_parser = length, conflicts_with = "data")]
    pub(crate) step: Option<f64>,

    /// A column's value on all rows, where noise or motion depend on it: `temperature=20`; may be given many times
    #[arg(long, value_name = "COLUMN=VALUE")]
    pub(crate) at: Vec<String>,

    /// File for all numbers, as JSON
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Group)]
#[command(after_help = examples::COMPARE)]
pub(crate) struct CompareArgs {
    /// Results of `kalfit fit --out`, two or more, of the same data; results of `kalfit validate --out` stand beside them, or alone
    #[arg(required = true, num_args = 2.., value_name = "FIT.json")]
    pub(crate) fits: Vec<PathBuf>,

    /// File for the comparison, as JSON
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Group)]
#[command(after_help = examples::REPORT)]
pub(crate) struct ReportArgs {
    /// Results of `kalfit fit --out`
    #[arg(value_name = "FIT.json")]
    pub(crate) fit: PathBuf,

    /// File for the report
    #[arg(long, value_name = "FILE.html")]
    pub(crate) out: PathBuf,

    /// Results of `kalfit test --out`: the fit beside the hypothesis that was tested within its model
    #[arg(long, value_name = "TEST.json")]
    pub(crate) test: Option<PathBuf>,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,
}

/// One of the words of an option, each with its help.
fn one_of<T: Copy + Send + Sync + 'static>(words: &'static [Word<T>]) -> impl TypedValueParser<Value = T> {
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
