//! What kind of file a filter is written to.

use std::path::Path;

use crate::failure::Failure;
use crate::output::FileContents;

/// What kind of file a filter is written to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExportFormat {
    /// Text for any program.
    Json,
    /// Arrays of numpy.
    Npz,
    /// Variables of Matlab and Octave.
    Mat,
    /// A header for C and C++.
    C,
    /// A module of Python that needs numpy alone.
    Python,
}

impl ExportFormat {
    /// The one that the ending of a name says.
    pub(super) fn of(path: &Path) -> Result<ExportFormat, Failure> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        match ending.as_deref() {
            Some("json") => Ok(ExportFormat::Json),
            Some("npz") => Ok(ExportFormat::Npz),
            Some("mat") => Ok(ExportFormat::Mat),
            Some("h" | "hh" | "hpp") => Ok(ExportFormat::C),
            Some("py") => Ok(ExportFormat::Python),
            _ => Err(Failure::NoExportFormat { path: path.display().to_string() }),
        }
    }

    pub(super) fn contents(self) -> FileContents {
        match self {
            ExportFormat::Json => FileContents::Json,
            ExportFormat::Npz => FileContents::Npz,
            ExportFormat::Mat => FileContents::Mat,
            ExportFormat::C => FileContents::Header,
            ExportFormat::Python => FileContents::Module,
        }
    }
}
