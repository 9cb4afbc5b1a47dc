//! Why nothing is predicted.

use kalfit_filter::reduce::ReduceError;

/// Why nothing is predicted.
#[derive(Debug, thiserror::Error)]
pub enum PredictError {
    /// A design that the model does not allow.
    #[error(transparent)]
    Reduce(Box<ReduceError>),
    /// A design is rows.
    #[error("test `{test}` has no rows in phase `{phase}`: a design is rows with times and inputs")]
    NoRows {
        /// The test.
        test: String,
        /// The phase.
        phase: String,
    },
    /// A value beyond all numbers.
    #[error("test `{test}`, row {row}: {what} is not a finite number")]
    NotFinite {
        /// The test.
        test: String,
        /// Its row, from 1.
        row: usize,
        /// Which figure of it.
        what: &'static str,
    },
}

impl From<ReduceError> for PredictError {
    fn from(error: ReduceError) -> PredictError {
        PredictError::Reduce(Box::new(error))
    }
}
