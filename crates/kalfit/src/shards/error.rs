//! Why a model cannot be fitted to tests in several places, or why one of them has no answer.

use kalfit_filter::reduce::{GroupingError, ReduceError};
use kalfit_search::DynamicError;

/// Why a model cannot be fitted to tests in several places, or why one of them has no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ShardError {
    /// Levels of a parameter are texts of the data, which stay where they are.
    #[error("`{parameter}` has one free value for each level, which a fit by sums does not support")]
    PerLevel {
        /// The parameter.
        parameter: String,
    },
    /// Bounds of noise covariances follow from rows.
    #[error(
        "noise covariances beside free parameters (`{parameter}`) have bounds that follow from rows, which a fit by sums does not see"
    )]
    NoiseCovariance {
        /// The first free parameter.
        parameter: String,
    },
    /// Phases put together by their marginals.
    #[error("phases combined by `marginal` cannot be fitted by sums")]
    Marginal,
    /// Standard errors that are made test by test.
    #[error("standard errors from the {found} are not available in a fit by sums")]
    StdErrors {
        /// What was asked for.
        found: &'static str,
    },
    /// Profiles take very many sums.
    #[error("intervals by profile likelihood are not available in a fit by sums")]
    Profiles,
    /// The restricted likelihood beside free parameters.
    #[error("the restricted likelihood with free parameters (`{parameter}`) is not available in a fit by sums")]
    Restricted {
        /// The first free parameter.
        parameter: String,
    },
    /// Estimates of a filter beside free parameters.
    #[error("test `{test}` comes as a filter's estimates or as a reduction, but `{parameter}` is free")]
    NotRows {
        /// Id of the test.
        test: String,
        /// The first free parameter.
        parameter: String,
    },
    /// What is asked is not of this model.
    #[error("what is asked does not fit the model: {what}")]
    Question {
        /// What does not fit.
        what: &'static str,
    },
    /// Tests that cannot be grouped.
    #[error(transparent)]
    Grouping(#[from] GroupingError),
    /// No place has a test.
    #[error("there are no tests")]
    NoTests,
    /// A test has no reduction at the only values of the parameters.
    #[error(transparent)]
    Reduce(#[from] Box<ReduceError>),
    /// There is no fit.
    #[error(transparent)]
    Dynamic(#[from] Box<DynamicError>),
}

impl ShardError {
    /// What to do about it.
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
