//! What files are written as.

use std::path::Path;

use super::error::WriteError;

/// What a file is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Text, with commas.
    Csv,
    /// Text, with tabs.
    Tsv,
    /// Parquet, compressed by Snappy.
    Parquet,
    /// Arrow IPC, file format.
    Arrow,
}

impl Format {
    /// The format that the extension of a file names, which is the one it will be read as.
    ///
    /// # Errors
    /// Another extension, or none.
    pub fn of(path: &Path) -> Result<Format, WriteError> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("csv" | "txt") => Ok(Format::Csv),
            Some("tsv") => Ok(Format::Tsv),
            Some("parquet" | "pq") => Ok(Format::Parquet),
            Some("arrow" | "ipc" | "feather") => Ok(Format::Arrow),
            _ => Err(WriteError::Format { path: path.display().to_string(), extension }),
        }
    }
}
