//! Why a model cannot be applied.

use kalfit_estimate::FitError;
use kalfit_filter::reduce::{GroupingError, ReduceError};
use kalfit_model::{PopulationError, StructureError};

/// Why a model cannot be applied to tests.
#[derive(Debug, thiserror::Error)]
pub enum ApplyError {
    /// There are no tests.
    #[error("there are no tests")]
    NoTests,
    /// A test that the model does not allow.
    #[error(transparent)]
    Reduce(Box<ReduceError>),
    /// Tests whose groups are not known.
    #[error(transparent)]
    Grouping(#[from] GroupingError),
    /// A population whose shape differs from the shape of the model.
    #[error(transparent)]
    Population(#[from] PopulationError),
    /// A matrix of the structure that is not possible.
    #[error(transparent)]
    Structure(#[from] StructureError),
    /// Reductions that the model cannot be applied to.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// A test whose states cannot be computed, because a phase is not given by rows.
    #[error("the states of test `{test}` are not known: phase `{phase}` has {found}, not rows that are filtered here")]
    NoRows {
        /// Id of the test.
        test: String,
        /// Name of the phase.
        phase: String,
        /// Evidence that the phase has in place of rows.
        found: &'static str,
    },
}

impl From<ReduceError> for ApplyError {
    fn from(error: ReduceError) -> ApplyError {
        ApplyError::Reduce(Box::new(error))
    }
}
