//! Why a model is not applied.

use kalfit_estimate::FitError;
use kalfit_filter::reduce::{GroupingError, ReduceError};
use kalfit_model::{PopulationError, StructureError};

/// Why a model is not applied to tests.
#[derive(Debug, thiserror::Error)]
pub enum ApplyError {
    /// There are no tests.
    #[error("there are no tests")]
    NoTests,
    /// A test that the model does not allow.
    #[error(transparent)]
    Reduce(Box<ReduceError>),
    /// Tests that stand in no groups.
    #[error(transparent)]
    Grouping(#[from] GroupingError),
    /// Values of another shape than the model's.
    #[error(transparent)]
    Population(#[from] PopulationError),
    /// Values that cannot be.
    #[error(transparent)]
    Structure(#[from] StructureError),
    /// Reductions that say nothing.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// States of a phase that is not known by its rows are not known either.
    #[error("the states of test `{test}` are not known: phase `{phase}` has {found}, not rows that are filtered here")]
    NoRows {
        /// The test.
        test: String,
        /// The phase.
        phase: String,
        /// What it has.
        found: &'static str,
    },
}

impl From<ReduceError> for ApplyError {
    fn from(error: ReduceError) -> ApplyError {
        ApplyError::Reduce(Box::new(error))
    }
}
