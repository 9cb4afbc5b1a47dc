//! Why dynamic parameters cannot be estimated.

use kalfit_estimate::FitError;
use kalfit_filter::reduce::{GroupingError, ReduceError};

/// Reason why there is no fit of α, μ and Σ.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DynamicError {
    /// A test has no reduction, whatever α is tried.
    #[error(transparent)]
    Reduce(#[from] Box<ReduceError>),
    /// μ and Σ cannot be estimated.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// Tests cannot be grouped.
    #[error(transparent)]
    Grouping(#[from] GroupingError),
    /// Parameters are free, and phases are put together by their marginals: the maximised function would be no
    /// likelihood of α.
    #[error("`{parameter}` is free, and `marginal` is for known parameters: found {free} free values, expected none")]
    Marginal {
        /// The first free parameter.
        parameter: String,
        /// Number of free values.
        free: usize,
    },
    /// The work was stopped on request.
    #[error("interrupted")]
    Interrupted,
    /// The expected information of free parameters is not available here.
    #[error(
        "standard errors from the expected information beside free parameters (`{parameter}`) are for tests given as rows, without \
         `[filter]` and without values of single tests"
    )]
    Expected {
        /// The first free parameter.
        parameter: String,
    },
    /// Intervals from drawn ensembles are for known parameters.
    #[error("intervals by `bootstrap` are for known parameters: `{parameter}` is free")]
    Bootstrap {
        /// The first free parameter.
        parameter: String,
    },
    /// A test is given as a reduction, which holds for one value of each parameter, while a parameter is free.
    #[error(
        "test `{test}` comes as a reduction, made at known parameters, but `{parameter}` of phase `{phase}` is free"
    )]
    FixedReduction {
        /// Id of the test.
        test: String,
        /// Name of the phase.
        phase: String,
        /// The first free parameter that the phase depends on.
        parameter: String,
    },
}

impl DynamicError {
    /// A hint at what to do about the error.
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            DynamicError::Reduce(error) => error.hint(),
            DynamicError::Fit(_) | DynamicError::Interrupted => None,
            DynamicError::Grouping(GroupingError::NoRows { .. }) => {
                Some("give the rows of the test, which name its groups")
            }
            DynamicError::Grouping(GroupingError::NoName { .. }) => Some("give every row the names of its groups"),
            DynamicError::Grouping(GroupingError::SlotVaries { .. }) => {
                Some("what is in a slot stays there for a whole test; tests of other instruments have other ids")
            }
            DynamicError::Grouping(GroupingError::Twice { .. }) => {
                Some("one instrument is in one place at a time; a slot that is empty has an empty cell")
            }
            DynamicError::Grouping(GroupingError::Varies { .. }) => {
                Some("a column of `levels` is constant within a test; tests of other groups have other ids")
            }
            DynamicError::Marginal { .. } => {
                Some("give every parameter a value, or put the phases together by `chain`")
            }
            DynamicError::Expected { .. } => {
                Some("take those from the observed information, or the sandwich, or give every parameter a value")
            }
            DynamicError::Bootstrap { .. } => Some("take `profile`, or give every parameter a value with `--set`"),
            DynamicError::FixedReduction { .. } => {
                Some("give the parameter the value that the reduction was made at, or give the data in its place")
            }
        }
    }
}
