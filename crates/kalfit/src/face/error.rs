//! Reasons why an ensemble cannot be fitted.

use kalfit_estimate::FitError;
use kalfit_filter::reduce::ReduceError;
use kalfit_lanes::UnknownInstructions;
use kalfit_model::ParameterError;
use kalfit_model::build::ColumnsError;
use kalfit_record::MixedGroup;
use kalfit_search::DynamicError;

/// Why an ensemble cannot be fitted.
#[derive(Debug, thiserror::Error)]
pub enum EnsembleError {
    /// The columns do not fit the model.
    #[error(transparent)]
    Columns(#[from] ColumnsError),
    /// A test cannot be reduced.
    #[error(transparent)]
    Reduce(#[from] Box<ReduceError>),
    /// μ and Σ cannot be estimated.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// α cannot be estimated.
    #[error(transparent)]
    Dynamic(#[from] Box<DynamicError>),
    /// The environment variable of the instruction set names a set that this machine does not have.
    #[error(transparent)]
    Instructions(#[from] UnknownInstructions),
    /// There are free parameters where α must be known.
    #[error(transparent)]
    Parameters(#[from] ParameterError),
    /// A test belongs to two groups.
    #[error(transparent)]
    Group(#[from] MixedGroup),
    /// A reduction has another number of unknowns than the model.
    #[error("test `{test}` has {found} unknown numbers, expected {expected}: {}", names.join(", "))]
    Dimension {
        /// Id of the test.
        test: String,
        /// Number of unknowns of the test.
        found: usize,
        /// Number of unknowns of the model.
        expected: usize,
        /// Names of the unknowns of the model.
        names: Vec<String>,
    },
}

impl From<ReduceError> for EnsembleError {
    fn from(error: ReduceError) -> EnsembleError {
        EnsembleError::Reduce(Box::new(error))
    }
}

impl From<DynamicError> for EnsembleError {
    fn from(error: DynamicError) -> EnsembleError {
        EnsembleError::Dynamic(Box::new(error))
    }
}
