//! Fits of the same data side by side: `kalfit compare`.

use std::path::Path;

use kalfit::FitRecord;
use kalfit::compare::{CompareError, ComparedRecord, compare as side_by_side};

use crate::document::Document;
use crate::failure::Failure;
use crate::job::{CompareJob, Done};
use crate::output::Output;
use crate::results::{FIT, read};

/// Puts the results of fits side by side.
///
/// # Errors
/// Files that cannot be read, or have no such results in them; fits of other data.
pub fn compare(job: &CompareJob) -> Result<Done<ComparedRecord>, Failure> {
    let named: Vec<&Path> = job.fits.iter().filter_map(Document::path).collect();
    let output = Output::results(job.out.as_deref(), &named)?;
    let real: Vec<_> = named.iter().map(|path| path.canonicalize().ok()).collect();
    for (k, path) in real.iter().enumerate().filter(|(_, path)| path.is_some()) {
        if real[..k].contains(path) {
            return Err(Failure::Compare(CompareError::Twice { name: named[k].display().to_string() }));
        }
    }
    let fits = job.fits.iter().map(|fit| {
        let record: FitRecord = read(fit, FIT).map_err(|error| Failure::Compared(Box::new(error)))?;
        Ok((fit.name(), record))
    });
    let fits = fits.collect::<Result<Vec<_>, Failure>>()?;
    let record = side_by_side(&fits).map_err(Failure::Compare)?;
    Done::in_json(record, Vec::new(), output.as_ref())
}
