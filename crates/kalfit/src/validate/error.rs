//! Reasons why a model cannot be validated.

use crate::face::EnsembleError;
use kalfit_apply::apply::ApplyError;
use kalfit_filter::reduce::GroupingError;

/// Why a model cannot be validated.
#[derive(Debug, thiserror::Error)]
pub enum ValidateError {
    /// A fit failed.
    #[error(transparent)]
    Fit(#[from] EnsembleError),
    /// A fit cannot be applied to its fold.
    #[error(transparent)]
    Apply(#[from] ApplyError),
    /// The groups of the tests cannot be determined.
    #[error(transparent)]
    Grouping(#[from] GroupingError),
    /// No test has measured values, so there is nothing to predict.
    #[error("nothing was measured in any test")]
    NothingMeasured,
    /// The caller requested a stop.
    #[error("interrupted")]
    Interrupted,
}
