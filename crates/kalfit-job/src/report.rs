//! `kalfit report`: the report of a fit from its results alone, and the page that `kalfit fit --report` writes.

use std::path::Path;

use kalfit::FitRecord;
use kalfit::record::{FIT_SCHEMA, RatioRecord};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::document::Document;
use crate::failure::Failure;
use crate::job::{Done, ReportJob};
use crate::output::{Contents, Output, OutputError};

/// Larger result files are not read.
const MAX_BYTES: u64 = 1 << 30;
/// The schema of a test of a hypothesis.
const TEST_SCHEMA: &str = "kalfit-test/1";

/// Why results cannot be reported.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The file cannot be read.
    #[error("cannot read `{path}`: {reason}")]
    Unreadable {
        /// The file.
        path: String,
        /// What was found.
        reason: String,
    },
    /// The file is too large.
    #[error("`{path}` has more than {limit} bytes")]
    TooLarge {
        /// The file.
        path: String,
        /// The most that is read.
        limit: u64,
    },
    /// The file has other things in it.
    #[error("`{path}` is not a result of `kalfit {command}`: {reason}")]
    NotARecord {
        /// The file.
        path: String,
        /// The command that makes such results.
        command: &'static str,
        /// What was found.
        reason: String,
    },
    /// The results are of another kind.
    #[error("`{path}`: the schema is `{found}`, expected `{expected}`")]
    Schema {
        /// The file.
        path: String,
        /// The schema that was found.
        found: String,
        /// The schema that was expected.
        expected: &'static str,
    },
}

impl ReportError {
    pub(crate) fn hint(&self) -> Option<&'static str> {
        match self {
            ReportError::NotARecord { command: "fit", .. } | ReportError::Schema { expected: FIT_SCHEMA, .. } => {
                Some("`kalfit report` takes what `kalfit fit --out` writes")
            }
            ReportError::NotARecord { .. } | ReportError::Schema { .. } => {
                Some("`--test` takes what `kalfit test --out` writes")
            }
            ReportError::Unreadable { .. } | ReportError::TooLarge { .. } => None,
        }
    }
}

/// Makes the page of a fit from its results: the same as that of the fit itself. It is handed back when no file is named.
///
/// # Errors
/// Files that cannot be read, or have no such results in them, or cannot be written.
pub fn report(job: &ReportJob) -> Result<Done<String>, Failure> {
    let read: Vec<&Path> = std::iter::once(&job.fit).chain(&job.test).filter_map(Document::path).collect();
    let output = Output::prepare_for(("--out", Contents::Page), job.out.as_deref(), &read)?;
    let record: FitRecord = results(&job.fit, FIT_SCHEMA, "fit")?;
    let page = match &job.test {
        None => kalfit_report::html(&record),
        Some(test) => {
            let test: RatioRecord = results(test, TEST_SCHEMA, "test")?;
            kalfit_report::html_with_test(&record, &test)
        }
    };
    if let Some(output) = &output {
        write(output, &page)?;
    }
    Ok(Done { record: page, notes: Vec::new(), written: output.iter().map(Output::name).collect() })
}

/// Writes a page, whole or not at all.
pub(crate) fn write(output: &Output, page: &str) -> Result<(), OutputError> {
    output.write_bytes(page.as_bytes())
}

fn results<T: DeserializeOwned>(from: &Document, schema: &'static str, command: &'static str) -> Result<T, Failure> {
    read(from, schema, command).map_err(|error| Failure::Report(Box::new(error)))
}

fn read<T: DeserializeOwned>(from: &Document, schema: &'static str, command: &'static str) -> Result<T, ReportError> {
    #[derive(Deserialize)]
    struct Head {
        schema: Option<String>,
    }
    let name = from.name();
    let (bytes, found) = from
        .bytes(MAX_BYTES + 1)
        .map_err(|error| ReportError::Unreadable { path: name.clone(), reason: error.to_string() })?;
    if found > MAX_BYTES {
        return Err(ReportError::TooLarge { path: name, limit: MAX_BYTES });
    }
    let refused = |reason: String| ReportError::NotARecord { path: name.clone(), command, reason };
    let head: Head = serde_json::from_slice(&bytes).map_err(|error| refused(error.to_string()))?;
    match head.schema {
        None => Err(refused("it has no `schema`".to_owned())),
        Some(found) if found != schema => Err(ReportError::Schema { path: name, found, expected: schema }),
        Some(_) => serde_json::from_slice(&bytes).map_err(|error| refused(error.to_string())),
    }
}
