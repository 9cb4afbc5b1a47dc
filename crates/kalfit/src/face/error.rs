//! Why there is no fit.

use kalfit_estimate::FitError;
use kalfit_filter::reduce::ReduceError;
use kalfit_model::ParameterError;
use kalfit_model::build::ColumnsError;
use kalfit_record::MixedGroup;
use kalfit_search::DynamicError;

/// Why there is no fit.
#[derive(Debug, thiserror::Error)]
pub enum EnsembleError {
    /// The columns are not those of the model.
    #[error(transparent)]
    Columns(#[from] ColumnsError),
    /// A test has no reduction.
    #[error(transparent)]
    Reduce(#[from] Box<ReduceError>),
    /// μ and Σ cannot be estimated.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// Nor can α.
    #[error(transparent)]
    Dynamic(#[from] Box<DynamicError>),
    /// Free parameters where nothing estimates them.
    #[error(transparent)]
    Parameters(#[from] ParameterError),
    /// A test of two groups.
    #[error(transparent)]
    Group(#[from] MixedGroup),
    /// A reduction of another model.
    #[error("test `{test}` has {found} unknown numbers, expected {expected}: {}", names.join(", "))]
    Dimension {
        /// Id of the test.
        test: String,
        /// Unknown numbers of the test.
        found: usize,
        /// Those of the model.
        expected: usize,
        /// Their names.
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
