//! Why a model is not validated.

use crate::face::EnsembleError;
use kalfit_apply::apply::ApplyError;
use kalfit_filter::reduce::GroupingError;

/// Why a model is not validated.
#[derive(Debug, thiserror::Error)]
pub enum ValidateError {
    /// A fit that cannot be made.
    #[error(transparent)]
    Fit(#[from] EnsembleError),
    /// A fit that cannot be applied to its fold.
    #[error(transparent)]
    Apply(#[from] ApplyError),
    /// Tests that stand in no groups.
    #[error(transparent)]
    Grouping(#[from] GroupingError),
    /// There is nothing to predict.
    #[error("nothing was measured in any test")]
    NothingMeasured,
    /// Nobody waits.
    #[error("interrupted")]
    Interrupted,
}
