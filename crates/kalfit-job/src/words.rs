//! The words of options: what the command line and Python call what can be asked for.

use kalfit::apply::StateKind;
use kalfit::dynamic::Method;
use kalfit::estimate::{Combination, Criterion, Solver};
use kalfit::infer::{DeletionChoice, DfChoice, IntervalKind, StdErrors};
use kalfit_report::PlotKind;

use crate::export::format::ExportFormat;
use crate::job::{MethodChoice, PredictedUnits};

/// One of the words of an option. Of each option the first is what is done unasked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OptionWord<T> {
    /// The word.
    pub word: &'static str,
    /// What is done, in a line.
    pub help: &'static str,
    /// What it means.
    pub means: T,
}

const fn word<T>(word: &'static str, means: T, help: &'static str) -> OptionWord<T> {
    OptionWord { word, help, means }
}

/// How free parameters are sought.
pub const METHODS: &[OptionWord<MethodChoice>] = &[
    word(
        "hybrid",
        MethodChoice::By(Method::Hybrid),
        "A search over the parameters, with mean and covariance solved for at each step",
    ),
    word("innovations", MethodChoice::By(Method::Innovations), "A joint search over parameters, mean and covariance"),
    word("em", MethodChoice::By(Method::Em), "The EM algorithm: many more steps to the same optimum"),
    word("all", MethodChoice::All, "All three, for comparison; the results are those of `hybrid`"),
];

/// How the mean and the covariance are sought.
pub const SOLVERS: &[OptionWord<Solver>] = &[
    word("newton", Solver::Newton, "Newton's method with the exact Hessian, safeguarded by EM"),
    word("em", Solver::Em, "The EM algorithm: many more iterations to the same optimum"),
];

/// What is as likely as can be.
pub const CRITERIA: &[OptionWord<Criterion>] = &[
    word("ml", Criterion::Ml, "Maximum likelihood"),
    word("reml", Criterion::Reml, "Restricted maximum likelihood: less biased covariances with few tests"),
];

/// How the phases of a test are put together.
pub const PHASES: &[OptionWord<Combination>] = &[
    word("chain", Combination::Chain, "Exactly, phase by phase; the cost is linear in the number of phases"),
    word(
        "marginal",
        Combination::Marginal,
        "Separately: the correlation between phases is ignored, which loses information",
    ),
    word("stacked", Combination::Stacked, "Exactly, as one large test: slower, for comparison"),
];

/// What intervals are made from.
pub const INTERVALS: &[OptionWord<IntervalKind>] = &[
    word(
        "auto",
        IntervalKind::Auto,
        "By profiles with `--criterion reml` and at most 50 tests or units, where that is quick; else from standard errors",
    ),
    word("wald", IntervalKind::Wald, "From standard errors"),
    word(
        "profile",
        IntervalKind::Profile,
        "From the profile likelihood: all values that a likelihood-ratio test at 5 % does not reject",
    ),
    word(
        "bootstrap",
        IntervalKind::Bootstrap,
        "From the profile likelihood, with the quantiles of its ratios in 199 ensembles drawn from the fit in place of those of \
         many tests; for known parameters",
    ),
];

/// Methods of the degrees of freedom of means.
pub const DF: &[OptionWord<DfChoice>] = &[
    word("kenward-roger", DfChoice::KenwardRoger, "Standard errors and degrees of freedom by Kenward and Roger"),
    word("satterthwaite", DfChoice::Satterthwaite, "Degrees of freedom by Satterthwaite"),
    word("none", DfChoice::None, "None: intervals as for many tests"),
];

/// What standard errors are made from.
pub const STD_ERRORS: &[OptionWord<StdErrors>] = &[
    word("observed", StdErrors::Observed, "From the curvature of the log-likelihood"),
    word("expected", StdErrors::Expected, "From the expected curvature"),
    word(
        "sandwich",
        StdErrors::Sandwich,
        "From the curvature and the scatter of the tests' scores: valid for wrong models, given many tests",
    ),
];

/// Whether tests are left out one by one.
pub const DELETIONS: &[OptionWord<DeletionChoice>] = &[
    word("auto", DeletionChoice::Cheap, "If that takes about a second at most"),
    word("all", DeletionChoice::All, "Always"),
    word("none", DeletionChoice::None, "Never"),
];

/// Whether innovations are looked at.
pub const INNOVATIONS: &[OptionWord<bool>] = &[
    word("on", true, "Compute them; large data are read twice"),
    word("off", false, "Leave them out, and read the data once"),
];

/// What the states of a step are told from.
pub const KINDS: &[OptionWord<StateKind>] = &[
    word("smoothed", StateKind::Smoothed, "From all measurements of the test"),
    word("filtered", StateKind::Filtered, "From measurements up to the step"),
    word("predicted", StateKind::Predicted, "From measurements before the step"),
];

/// What a figure shows.
pub const FIGURES: &[OptionWord<PlotKind>] = &[
    word("forest", PlotKind::Forest, "Means, standard deviations and free parameters with their 95 % intervals"),
    word("ellipses", PlotKind::Ellipses, "Each pair of states: the population, and the tests in it"),
    word(
        "tests",
        PlotKind::Tests,
        "Each test by itself and as part of the population, and the mean: a meta-analysis' forest plot",
    ),
    word("influence", PlotKind::Influence, "How far the estimates move when a test is left out"),
    word("records", PlotKind::Records, "A test over time: measured and predicted values, innovations"),
    word("residuals", PlotKind::Residuals, "A test over time: innovations over their standard deviations"),
    word("quantiles", PlotKind::Quantiles, "A test: innovations against the quantiles of the normal law"),
    word("allan", PlotKind::Allan, "Allan deviations of the records and of the fitted model"),
    word(
        "sensitivities",
        PlotKind::Sensitivities,
        "Of the results of `kalfit plan --candidates`: what each candidate brings",
    ),
];

/// Whose tests are predicted.
pub const UNITS: &[OptionWord<PredictedUnits>] = &[
    word("new", PredictedUnits::New, "Tests of new units"),
    word("known", PredictedUnits::Known, "Tests of units that were in the fit, by their names in the design"),
];

/// What kind of file a filter is written to.
pub const EXPORT_FORMATS: &[OptionWord<ExportFormat>] = &[
    word("json", ExportFormat::Json, "Text for any program"),
    word("npz", ExportFormat::Npz, "Arrays of numpy"),
    word("mat", ExportFormat::Mat, "Variables of Matlab and Octave"),
    word("c", ExportFormat::C, "A header for C and C++"),
    word("python", ExportFormat::Python, "A module that needs numpy alone"),
];
