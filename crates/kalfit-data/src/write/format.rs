//! What files are written as.

use std::path::Path;

use super::error::WriteError;

/// What a file is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TableFormat {
    /// Text, with commas.
    Csv,
    /// Text, with tabs.
    Tsv,
    /// Parquet, compressed by Snappy.
    Parquet,
    /// Arrow IPC, file format.
    Arrow,
}

impl TableFormat {
    /// The format that the extension of a file names, which is the one it will be read as.
    ///
    /// # Errors
    /// Another extension, or none.
    pub fn of(path: &Path) -> Result<TableFormat, WriteError> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("csv" | "txt") => Ok(TableFormat::Csv),
            Some("tsv") => Ok(TableFormat::Tsv),
            Some("parquet" | "pq") => Ok(TableFormat::Parquet),
            Some("arrow" | "ipc" | "feather") => Ok(TableFormat::Arrow),
            _ => Err(WriteError::Format { path: path.display().to_string(), extension }),
        }
    }
}
