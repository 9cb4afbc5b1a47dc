//! What a job reads beside data: a model, a hypothesis, the results of a fit.

use std::io::Read;
use std::path::{Path, PathBuf};

/// A text in a file or in memory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Document {
    /// A file.
    File(PathBuf),
    /// A text, and what messages call it.
    Text {
        /// What messages call it.
        name: String,
        /// The text.
        text: String,
        /// The file that it was read from, if any: no output may replace it.
        file: Option<PathBuf>,
    },
}

impl From<PathBuf> for Document {
    fn from(path: PathBuf) -> Document {
        Document::File(path)
    }
}

impl Document {
    /// What messages call it.
    pub fn name(&self) -> String {
        match self {
            Document::File(path) => path.display().to_string(),
            Document::Text { name, .. } => name.clone(),
        }
    }

    /// The file, when it is one.
    pub fn path(&self) -> Option<&Path> {
        match self {
            Document::File(path) => Some(path),
            Document::Text { file, .. } => file.as_deref(),
        }
    }

    /// Up to `most` of its bytes, and how many there are or more than `most`.
    pub(crate) fn bytes(&self, most: u64) -> std::io::Result<(Vec<u8>, u64)> {
        match self {
            Document::Text { text, .. } => {
                let all = text.as_bytes();
                Ok((all[..all.len().min(most as usize)].to_vec(), all.len() as u64))
            }
            Document::File(path) => {
                let file = std::fs::File::open(path)?;
                let size = file.metadata()?.len();
                let mut bytes = Vec::new();
                // The size of a pipe is not known before it is read.
                file.take(most).read_to_end(&mut bytes)?;
                let found = size.max(bytes.len() as u64);
                Ok((bytes, found))
            }
        }
    }
}
