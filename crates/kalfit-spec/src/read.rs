//! Model files, read.

use std::io::Read;
use std::path::Path;

use crate::build;
use crate::error::{SpecError, SpecProblem};
use crate::spec::Spec;

impl Spec {
    /// Reads a model from text; `name` is for messages.
    ///
    /// # Errors
    /// Whatever is wrong with the text, one problem at a time.
    pub fn parse(name: &str, text: &str) -> Result<Spec, SpecError> {
        build::spec(name, text)
    }

    /// Reads a model file.
    ///
    /// # Errors
    /// As [`Spec::read_text`] and [`Spec::parse`].
    pub fn load(path: &Path) -> Result<Spec, SpecError> {
        Spec::parse(&path.display().to_string(), &Spec::read_text(path)?)
    }

    /// The text of a model file, for [`Spec::parse`] and for showing the place of an error.
    ///
    /// # Errors
    /// The file cannot be read, has more than 4 MiB, or is not UTF-8 text.
    pub fn read_text(path: &Path) -> Result<String, SpecError> {
        let unreadable = |error: std::io::Error| {
            SpecError::new(SpecProblem::Unreadable { path: path.display().to_string(), reason: error.to_string() })
        };
        let file = std::fs::File::open(path).map_err(unreadable)?;
        let size = file.metadata().map_err(unreadable)?.len();
        let mut bytes = Vec::new();
        // The size of a pipe is not known before it is read, so the limit holds while reading too.
        file.take(build::MAX_BYTES + 1).read_to_end(&mut bytes).map_err(unreadable)?;
        let found = size.max(bytes.len() as u64);
        if found > build::MAX_BYTES {
            return Err(SpecError::new(SpecProblem::TooLarge { found, limit: build::MAX_BYTES }));
        }
        String::from_utf8(bytes).map_err(|error| {
            SpecError::new(SpecProblem::NotText { offset: error.utf8_error().valid_up_to() })
                .hint("save the file as UTF-8 text")
        })
    }
}
