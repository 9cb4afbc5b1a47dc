//! Exceptions, with the same words as the command's messages.

use kalfit_data::DataError as Data;
use kalfit_job::{Failure, TruthError};
use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt};

create_exception!(kalfit, Error, PyException, "What kalfit refuses, or cannot do.");
create_exception!(kalfit, ModelError, Error, "Something is wrong with a model or a hypothesis.");
create_exception!(kalfit, DataError, Error, "Something is wrong with the data.");
create_exception!(kalfit, FitError, Error, "The model does not work on the data, or an option does not go with them.");

/// A failure as an exception.
pub(crate) fn exception(failure: &Failure) -> PyErr {
    let text = kalfit_job::render(failure, false);
    let text = text.strip_prefix("error: ").unwrap_or(&text).trim_end().to_owned();
    match failure {
        Failure::Interrupted => PyKeyboardInterrupt::new_err(()),
        Failure::Model { .. }
        | Failure::Set { .. }
        | Failure::NotNested(_)
        | Failure::DynamicRatio(_)
        | Failure::HypothesisParameter { .. } => ModelError::new_err(text),
        Failure::Data { .. }
        | Failure::Split { .. }
        | Failure::Reduce { .. }
        | Failure::NoFilter { .. }
        | Failure::NotEstimates { .. } => DataError::new_err(text),
        Failure::Truth(error) => match **error {
            TruthError::NoParameter { .. } | TruthError::Value { .. } => ModelError::new_err(text),
            _ => DataError::new_err(text),
        },
        Failure::Output(_) | Failure::Write { .. } | Failure::NotParquet { .. } | Failure::Threads { .. } => {
            Error::new_err(text)
        }
        _ => FitError::new_err(text),
    }
}

/// Wrong data that are in memory.
pub(crate) fn data_exception(error: &Data) -> PyErr {
    DataError::new_err(error.to_string())
}
