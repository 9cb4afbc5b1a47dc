//! `kalfit report`: the report of a fit from its results alone, and the page that `kalfit fit --report` writes.

use std::io::Read;
use std::path::{Path, PathBuf};

use kalfit::FitRecord;
use kalfit::record::{FIT_SCHEMA, RatioRecord};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::failure::Failure;
use crate::job::Outcome;
use crate::output::{Output, OutputError};
use crate::terminal;

/// Larger result files are not read.
const MAX_BYTES: u64 = 1 << 30;
/// The schema of a test of a hypothesis.
const TEST_SCHEMA: &str = "kalfit-test/1";

/// From results to a page.
#[derive(Debug)]
pub(crate) struct ReportJob {
    /// Results of a fit.
    pub(crate) fit: PathBuf,
    /// Results of a test of a hypothesis within the same model.
    pub(crate) test: Option<PathBuf>,
    pub(crate) out: PathBuf,
    pub(crate) quiet: bool,
}

/// Why results cannot be reported.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ReportError {
    #[error("cannot read `{path}`: {reason}")]
    Unreadable { path: String, reason: String },
    #[error("`{path}` has more than {limit} bytes")]
    TooLarge { path: String, limit: u64 },
    #[error("`{path}` is not a result of `kalfit {command}`: {reason}")]
    NotARecord { path: String, command: &'static str, reason: String },
    #[error("`{path}`: the schema is `{found}`, expected `{expected}`")]
    Schema { path: String, found: String, expected: &'static str },
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

/// Exit status 0 says that the report was made; what it says of the fit is in it.
pub(crate) fn run(job: &ReportJob) -> Result<Outcome, Failure> {
    let inputs: Vec<&Path> = std::iter::once(job.fit.as_path()).chain(job.test.as_deref()).collect();
    let output = Output::prepare(&job.out, &inputs)?;
    let record: FitRecord = read(&job.fit, FIT_SCHEMA, "fit")?;
    let page = match &job.test {
        None => kalfit_report::html(&record),
        Some(path) => {
            let test: RatioRecord = read(path, TEST_SCHEMA, "test")?;
            kalfit_report::html_with_test(&record, &test)
        }
    };
    write(&output, &page)?;
    if !job.quiet {
        terminal::complain(&format!("Wrote {}\n", output.name()));
    }
    Ok(Outcome::Done)
}

/// Writes a page, whole or not at all.
pub(crate) fn write(output: &Output, page: &str) -> Result<(), OutputError> {
    output.write_bytes(page.as_bytes())
}

fn read<T: DeserializeOwned>(path: &Path, schema: &'static str, command: &'static str) -> Result<T, Failure> {
    read_record(path, schema, command).map_err(|error| Failure::Report(Box::new(error)))
}

fn read_record<T: DeserializeOwned>(
    path: &Path,
    schema: &'static str,
    command: &'static str,
) -> Result<T, ReportError> {
    #[derive(Deserialize)]
    struct Head {
        schema: Option<String>,
    }
    let name = path.display().to_string();
    let unreadable = |error: std::io::Error| ReportError::Unreadable { path: name.clone(), reason: error.to_string() };
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(unreadable)?;
    file.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > MAX_BYTES {
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
