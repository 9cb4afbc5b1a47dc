//! Fits of the same data, and predictions of it, side by side: `kalfit compare`.

use std::path::Path;

use kalfit::compare::{CompareError, ComparedRecord, compare_with};

use crate::document::Document;
use crate::failure::Failure;
use crate::job::{CompareJob, JobDone};
use crate::output::OutputFile;
use crate::results::{EitherResult, FIT, VALIDATED, read_either};

/// Puts the results of fits side by side.
///
/// # Errors
/// Files that cannot be read, or have no such results in them; fits of other data.
pub fn compare(job: &CompareJob) -> Result<JobDone<ComparedRecord>, Failure> {
    let named: Vec<&Path> = job.fits.iter().filter_map(Document::path).collect();
    let output = OutputFile::results(job.out.as_deref(), &named)?;
    let real: Vec<_> = named.iter().map(|path| path.canonicalize().ok()).collect();
    for (k, path) in real.iter().enumerate().filter(|(_, path)| path.is_some()) {
        if real[..k].contains(path) {
            return Err(Failure::Compare(CompareError::Twice { name: named[k].display().to_string() }));
        }
    }
    let (mut fits, mut validated) = (Vec::new(), Vec::new());
    for from in &job.fits {
        match read_either(from, VALIDATED, FIT).map_err(|error| Failure::Compared(Box::new(error)))? {
            EitherResult::First(record) => validated.push((from.name(), record)),
            EitherResult::Second(record) => fits.push((from.name(), record)),
        }
    }
    let record = compare_with(&fits, &validated).map_err(Failure::Compare)?;
    JobDone::in_json(record, Vec::new(), output.as_ref())
}
