//! What can be typed. Every option does something; what it does is said here once, and the help shows it.

use std::path::PathBuf;

use clap::{Args as Group, Parser, Subcommand, ValueEnum};

/// Error models from ensembles of non-identical tests, by maximum likelihood.
#[derive(Debug, Parser)]
#[command(
    name = "kalfit",
    version,
    max_term_width = 100,
    after_help = "Exit status: 0 done and certified; 1 finished without a certified optimum; 2 bad input, nothing is written."
)]
pub(crate) struct Args {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Fit a model to data: a summary to standard output, all results to a file
    Fit(FitArgs),
    /// Read a model, and data if given, and fit nothing: the model in words, counts, what the data identify
    Check(CheckArgs),
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
}

#[derive(Debug, Group)]
pub(crate) struct FitArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    #[arg(required = true)]
    pub(crate) data: Vec<String>,

    /// File for all results, as JSON
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,

    /// How the mean and the covariance are sought
    #[arg(long, value_enum, default_value_t = SolverArg::Newton)]
    pub(crate) solver: SolverArg,

    /// Stop within this many standard errors of the optimum [default: 1e-8]
    #[arg(long, value_name = "T", value_parser = tolerance)]
    pub(crate) tolerance: Option<f64>,

    /// Stop after this many passes over the reduced data [default: 200 with newton, 20000 with em]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) max_iterations: Option<u32>,

    /// Look at each test's innovations after the fit: is the model right for it
    #[arg(long, value_enum, value_name = "WHEN", default_value_t = InnovationsArg::On)]
    pub(crate) innovations: InnovationsArg,

    /// Print nothing but errors
    #[arg(long)]
    pub(crate) quiet: bool,

    #[command(flatten)]
    pub(crate) only: OnlyArgs,
}

/// Choices of the contract of which this version has one: they may be spelled out, and anything else is refused.
#[derive(Debug, Group)]
pub(crate) struct OnlyArgs {
    #[arg(long, hide = true, value_parser = only("hybrid"))]
    method: Option<String>,
    #[arg(long, hide = true, value_parser = only("ml"))]
    criterion: Option<String>,
    #[arg(long, hide = true, value_parser = only("chain"))]
    phases: Option<String>,
    #[arg(long, hide = true, value_parser = only("wald"))]
    intervals: Option<String>,
}

#[derive(Debug, Group)]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    pub(crate) model: ModelArgs,

    /// Data: CSV, Parquet or Arrow files, patterns such as `runs/*.csv`, `-` for standard input
    pub(crate) data: Vec<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum SolverArg {
    /// Newton's method with the exact Hessian, safeguarded by EM
    Newton,
    /// The EM algorithm: many more passes, to the same point
    Em,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum InnovationsArg {
    /// Look at them; large data are read a second time
    On,
    /// Leave them out, and read the data once
    Off,
}

fn tolerance(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if value > 0.0 && value <= 1.0 => Ok(value),
        _ => Err("expected a number above 0 and at most 1".to_owned()),
    }
}

fn only(value: &'static str) -> impl Fn(&str) -> Result<String, String> + Clone {
    move |text| match text == value {
        true => Ok(text.to_owned()),
        false => Err(format!("this version has only `{value}`")),
    }
}
