//! The words of options: what the command line and Python call what can be asked for.

use kalfit::apply::StateKind;
use kalfit::dynamic::Method;
use kalfit::estimate::{Combination, Criterion, Solver};
use kalfit::infer::{DeletionChoice, IntervalKind, StdErrors};

use crate::export::form::Form;
use crate::job::{MethodChoice, Units};

/// One of the words of an option. Of each option the first is what is done unasked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Word<T> {
    /// The word.
    pub word: &'static str,
    /// What is done, in a line.
    pub help: &'static str,
    /// What it means.
    pub means: T,
}

const fn word<T>(word: &'static str, means: T, help: &'static str) -> Word<T> {
    Word { word, help, means }
}

/// How free parameters are sought.
pub const METHODS: &[Word<MethodChoice>] = &[
    word(
        "hybrid",
        MethodChoice::By(Method::Hybrid),
        "Mean and covariance are solved for each value of the parameters, which an outer search moves",
    ),
    word(
        "innovations",
        MethodChoice::By(Method::Innovations),
        "Maximum likelihood of the innovations, jointly in all that is free",
    ),
    word("em", MethodChoice::By(Method::Em), "EM on the states and noises: many more steps, to the same point"),
    word("all", MethodChoice::All, "All three, side by side; the results are those of `hybrid`"),
];

/// How the mean and the covariance are sought.
pub const SOLVERS: &[Word<Solver>] = &[
    word("newton", Solver::Newton, "Newton's method with the exact Hessian, safeguarded by EM"),
    word("em", Solver::Em, "The EM algorithm: many more passes, to the same point"),
];

/// What is as likely as can be.
pub const CRITERIA: &[Word<Criterion>] = &[
    word("ml", Criterion::Ml, "The likelihood of the mean and the covariance"),
    word(
        "reml",
        Criterion::Reml,
        "The restricted likelihood of the covariance, whose estimate does not shrink when tests are few",
    ),
];

/// How the phases of a test are put together.
pub const PHASES: &[Word<Combination>] = &[
    word("chain", Combination::Chain, "Phase by phase: exact, at a cost that is linear in the number of phases"),
    word(
        "marginal",
        Combination::Marginal,
        "Each phase by itself: the correlation between phases is ignored, and information with it",
    ),
    word("stacked", Combination::Stacked, "As one large test: exact, the reference"),
];

/// What intervals are made from.
pub const INTERVALS: &[Word<IntervalKind>] = &[
    word("wald", IntervalKind::Wald, "Standard errors"),
    word("profile", IntervalKind::Profile, "Profile likelihood: what a likelihood-ratio test at 5 % does not reject"),
];

/// What standard errors are made from.
pub const STD_ERRORS: &[Word<StdErrors>] = &[
    word("observed", StdErrors::Observed, "The curvature of the log-likelihood"),
    word("expected", StdErrors::Expected, "Its expectation"),
    word(
        "sandwich",
        StdErrors::Sandwich,
        "Both, and the spread of the tests' scores: right also for a wrong model, given many tests",
    ),
];

/// Whether tests are left out one by one.
pub const DELETIONS: &[Word<DeletionChoice>] = &[
    word("auto", DeletionChoice::Cheap, "When it takes about a second at most"),
    word("all", DeletionChoice::All, "Whatever it takes"),
    word("none", DeletionChoice::None, "Never"),
];

/// Whether innovations are looked at.
pub const INNOVATIONS: &[Word<bool>] = &[
    word("on", true, "Look at them; large data are read a second time"),
    word("off", false, "Leave them out, and read the data once"),
];

/// What the states of a step are told from.
pub const KINDS: &[Word<StateKind>] = &[
    word("smoothed", StateKind::Smoothed, "From all of the test"),
    word("filtered", StateKind::Filtered, "From what was measured up to the step"),
    word("predicted", StateKind::Predicted, "From what was measured before the step"),
];

/// Whose tests are predicted.
pub const UNITS: &[Word<Units>] = &[
    word("new", Units::New, "Of units that nobody has seen"),
    word("known", Units::Known, "Of units that the fit knows, by their names in the design"),
];

/// What kind of file a filter is written to.
pub const FORMS: &[Word<Form>] = &[
    word("json", Form::Json, "Text for any program"),
    word("npz", Form::Npz, "Arrays of numpy"),
    word("mat", Form::Mat, "Variables of Matlab and Octave"),
    word("c", Form::C, "A header for C and C++"),
    word("python", Form::Python, "A module that needs numpy alone"),
];
