//! Why a prediction is not possible.

use kalfit_filter::reduce::ReduceError;

/// Why a prediction is not possible.
#[derive(Debug, thiserror::Error)]
pub enum PredictError {
    /// A design that the model does not allow.
    #[error(transparent)]
    Reduce(Box<ReduceError>),
    /// A design without rows in a phase.
    #[error("test `{test}` has no rows in phase `{phase}`: a design is rows with times and inputs")]
    NoRows {
        /// Id of the test.
        test: String,
        /// Name of the phase.
        phase: String,
    },
    /// A value that is not finite.
    #[error("test `{test}`, row {row}: {what} is not a finite number")]
    NotFinite {
        /// Id of the test.
        test: String,
        /// Number of the row, from 1.
        row: usize,
        /// Name of the figure that is not finite.
        what: &'static str,
    },
}

impl From<ReduceError> for PredictError {
    fn from(error: ReduceError) -> PredictError {
        PredictError::Reduce(Box::new(error))
    }
}
