//! A wall between us and libraries that panic on broken files.

use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::error::DataError;

/// Runs what reads untrusted bytes; a panic becomes an error. Whatever it touched must not be used again after one.
pub(crate) fn guarded<T>(
    file: &str,
    format: &'static str,
    read: impl FnOnce() -> Result<T, DataError>,
) -> Result<T, DataError> {
    catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(|_| Err(DataError::Crashed { file: file.to_owned(), format }))
}
