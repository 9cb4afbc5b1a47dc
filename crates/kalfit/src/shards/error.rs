//! Why a model cannot be fitted to tests in several places, or why one of the places has no answer.

use kalfit_filter::reduce::{GroupingError, ReduceError};
use kalfit_search::DynamicError;

/// Why a model cannot be fitted to tests in several places, or why one of the places has no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ShardError {
    /// A parameter has a free value for each level; levels are texts of the data, and texts do not leave the place of
    /// the tests.
    #[error("`{parameter}` has one free value for each level, which a fit by sums does not support")]
    PerLevel {
        /// Name of the parameter.
        parameter: String,
    },
    /// The bounds of noise covariances follow from rows of data, which a fit by sums does not see.
    #[error(
        "noise covariances beside free parameters (`{parameter}`) have bounds that follow from rows, which a fit by sums does not see"
    )]
    NoiseCovariance {
        /// Name of the first free parameter.
        parameter: String,
    },
    /// The phases are combined by their marginals.
    #[error("phases combined by `marginal` cannot be fitted by sums")]
    Marginal,
    /// The kind of standard errors requested is not available from sums over tests.
    #[error("standard errors from the {found} are not available in a fit by sums")]
    StdErrors {
        /// The kind of standard errors requested.
        found: &'static str,
    },
    /// Intervals by profile likelihood were requested, which would take very many sums.
    #[error("intervals by profile likelihood are not available in a fit by sums")]
    Profiles,
    /// The restricted likelihood was requested together with free parameters.
    #[error("the restricted likelihood with free parameters (`{parameter}`) is not available in a fit by sums")]
    Restricted {
        /// Name of the first free parameter.
        parameter: String,
    },
    /// A test is given by a filter's estimates or by a reduction, although a parameter is free.
    #[error("test `{test}` comes as a filter's estimates or as a reduction, but `{parameter}` is free")]
    NotRows {
        /// Id of the test.
        test: String,
        /// Name of the first free parameter.
        parameter: String,
    },
    /// The question does not fit this model.
    #[error("what is asked does not fit the model: {what}")]
    Question {
        /// The part of the question that does not fit.
        what: &'static str,
    },
    /// The tests cannot be grouped.
    #[error(transparent)]
    Grouping(#[from] GroupingError),
    /// No place has a test.
    #[error("there are no tests")]
    NoTests,
    /// A test has no reduction at the values of the parameters, none of which is free.
    #[error(transparent)]
    Reduce(#[from] Box<ReduceError>),
    /// The fit failed.
    #[error(transparent)]
    Dynamic(#[from] Box<DynamicError>),
}

impl ShardError {
    /// Advice that helps whatever the model; `None` where there is none.
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            ShardError::PerLevel { .. } => Some("make the parameter common to all tests, or give each level its value"),
            ShardError::NoiseCovariance { .. } => Some("give the parameters their values, or fit on one machine"),
            ShardError::Marginal => Some("put the phases together by `chain`"),
            ShardError::StdErrors { .. } => Some("take those from the observed information"),
            ShardError::Profiles => Some("take Wald's"),
            ShardError::Restricted { .. } => {
                Some("maximise the likelihood (`ml`), or give the parameters their values")
            }
            ShardError::NotRows { .. } => Some("give the rows of the test, or give the parameters their values"),
            ShardError::Question { .. } => Some("ask again with the same model and the same version of kalfit"),
            ShardError::Reduce(error) => error.hint(),
            ShardError::Dynamic(error) => error.hint(),
            ShardError::Grouping(_) | ShardError::NoTests => None,
        }
    }
}
