//! What kind of file a filter is written to.

use std::path::Path;

use crate::failure::Failure;
use crate::output::Contents;

/// What kind of file a filter is written to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
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

impl Form {
    /// The one that the ending of a name says.
    pub(super) fn of(path: &Path) -> Result<Form, Failure> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        match ending.as_deref() {
            Some("json") => Ok(Form::Json),
            Some("npz") => Ok(Form::Npz),
            Some("mat") => Ok(Form::Mat),
            Some("h" | "hh" | "hpp") => Ok(Form::C),
            Some("py") => Ok(Form::Python),
            _ => Err(Failure::NoForm { path: path.display().to_string() }),
        }
    }

    pub(super) fn contents(self) -> Contents {
        match self {
            Form::Json => Contents::Json,
            Form::Npz => Contents::Npz,
            Form::Mat => Contents::Mat,
            Form::C => Contents::Header,
            Form::Python => Contents::Module,
        }
    }
}
