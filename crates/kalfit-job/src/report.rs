//! `kalfit report`: the report of a fit from its results alone, and the page that `kalfit fit --report` writes.

use std::path::Path;

use kalfit::FitRecord;
use kalfit::record::RatioRecord;

use crate::document::Document;
use crate::failure::Failure;
use crate::job::{JobDone, ReportJob};
use crate::output::{FileContents, OutputError, OutputFile};
use crate::results::{FIT, ResultError, TEST, read};

/// Makes the page of a fit from its results: the same as that of the fit itself. It is handed back when no file is named.
///
/// # Errors
/// Files that cannot be read, or have no such results in them, or cannot be written.
pub fn report(job: &ReportJob) -> Result<JobDone<String>, Failure> {
    let named: Vec<&Path> = std::iter::once(&job.fit).chain(&job.test).filter_map(Document::path).collect();
    let output = OutputFile::prepare_for(("--out", FileContents::Page), job.out.as_deref(), &named)?;
    let record: FitRecord = read(&job.fit, FIT).map_err(failure)?;
    let page = match &job.test {
        None => kalfit_report::html(&record),
        Some(test) => {
            let test: RatioRecord = read(test, TEST).map_err(failure)?;
            kalfit_report::html_with_test(&record, &test)
        }
    };
    if let Some(output) = &output {
        write(output, &page)?;
    }
    Ok(JobDone::new(page, Vec::new(), output.iter().map(OutputFile::name).collect()))
}

/// Writes a page, whole or not at all.
pub(crate) fn write(output: &OutputFile, page: &str) -> Result<(), OutputError> {
    output.write_bytes(page.as_bytes())
}

fn failure(error: ResultError) -> Failure {
    Failure::Report(Box::new(error))
}
