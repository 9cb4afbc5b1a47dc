//! A second file that is read together with a model: a hypothesis, outputs. Its places are counted from the end of the model's text.

use toml::de::DeTable;

use crate::build::{MAX_BYTES, not_toml};
use crate::error::{Result, SpecError, SpecProblem};
use crate::merge::shifted_table;

/// What is wrong with two files that are read together, and which of them the place is in.
#[derive(Debug, Clone, PartialEq)]
pub enum BesideError {
    /// In the file that is read beside the model.
    File(SpecError),
    /// In the model: something that the other file does not go with.
    Model(SpecError),
}

/// Which file the place of an error is in; the second begins at `offset`.
fn located(mut error: SpecError, offset: usize) -> BesideError {
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

/// Reads a second file after the text of a model; `read` is given both as one text, and where the second begins.
pub(crate) fn read<T>(
    model: &str,
    second: &str,
    read: impl FnOnce(&str, usize) -> Result<T>,
) -> std::result::Result<T, BesideError> {
    let found = second.len() as u64;
    if found > MAX_BYTES {
        return Err(BesideError::File(SpecError::new(SpecProblem::TooLarge { found, limit: MAX_BYTES })));
    }
    let (text, offset) = (format!("{model}\n{second}"), model.len() + 1);
    read(&text, offset).map_err(|error| located(error, offset))
}

/// The tables of the model and of the second file, with their places in the whole text.
pub(crate) fn tables(text: &str, offset: usize) -> Result<[DeTable<'_>; 2]> {
    let (first, second) = (&text[..offset - 1], &text[offset..]);
    let second = DeTable::parse(second).map_err(|error| {
        let mut error = not_toml(&error, second);
        error.span = error.span.map(|span| span.start + offset..span.end + offset);
        error
    })?;
    let first = DeTable::parse(first).map_err(|error| not_toml(&error, first))?;
    Ok([first.into_inner(), shifted_table(second.into_inner(), offset)])
}
