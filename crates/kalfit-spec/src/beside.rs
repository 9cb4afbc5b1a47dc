//! A second file that is read together with a model: a hypothesis, outputs. Its places are counted from the end of the model's text.

use crate::error::SpecError;

/// What is wrong with two files that are read together, and which of them the place is in.
#[derive(Debug, Clone, PartialEq)]
pub enum BesideError {
    /// In the file that is read beside the model.
    File(SpecError),
    /// In the model: something that the other file does not go with.
    Model(SpecError),
}

/// Which file the place of an error is in; the second begins at `offset`.
pub(crate) fn located(mut error: SpecError, offset: usize) -> BesideError {
    match error.span.take() {
        Some(span) if span.start >= offset => {
            error.span = Some(span.start - offset..span.end - offset);
            BesideError::File(error)
        }
        Some(span) => {
            error.span = Some(span);
            BesideError::Model(error)
        }
        None => BesideError::File(error),
    }
}

/// The error with its place moved.
pub(crate) fn moved(mut error: SpecError, offset: usize) -> SpecError {
    error.span = error.span.map(|span| span.start + offset..span.end + offset);
    error
}
