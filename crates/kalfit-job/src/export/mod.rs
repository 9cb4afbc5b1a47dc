//! The filter that follows from a fit: `kalfit export`.

mod c;
mod fields;
pub(crate) mod format;
mod mat;
mod npz;
mod python;
mod zip;

use kalfit::export::{ExportError, Wanted, export as matrices};
use kalfit::record::{ExportRecord, ExportSource};

pub use self::format::ExportFormat;
use crate::failure::Failure;
use crate::job::{ExportJob, JobDone, files};
use crate::output::{OutputError, OutputFile};
use crate::truth;

/// Makes the filter, and writes it where a file is named.
///
/// # Errors
/// Bad input: among it a model whose matrices differ from row to row.
pub fn export(job: &ExportJob) -> Result<JobDone<ExportRecord>, Failure> {
    let (spec, truth) = truth::load(&job.model, &job.from)?;
    let at = job.at.iter().map(|assignment| column_value(assignment)).collect::<Result<Vec<_>, Failure>>()?;
    let output = match &job.out {
        None => None,
        Some(path) => {
            let format = job.format.map_or_else(|| ExportFormat::of(path), Ok)?;
            let used = files(&[&job.model.document, &job.from], &[]);
            let output = OutputFile::prepare_for(("--as", format.contents()), Some(path), &used)?;
            output.map(|output| (output, format))
        }
    };
    let wanted = Wanted { phase: job.phase.clone(), step: job.step, at };
    let found = matrices(&spec.model, &truth.alpha, &truth.population, &wanted).map_err(refused)?;
    let words = spec.words(found.phase);
    let source = ExportSource { from: job.from.name(), changed: truth.changed, at: &wanted.at, words: &words };
    let record = ExportRecord::new(&spec.model, &found, &source);
    if let Some((output, format)) = &output {
        write(output, *format, &record)?;
    }
    let written = output.iter().map(|(output, _)| output.name()).collect();
    Ok(JobDone::new(record, truth.warnings, written))
}

/// Where the parameters of a filter are from.
fn origin(record: &ExportRecord) -> String {
    match record.changed.is_empty() {
        true => record.from.clone(),
        false => format!("{} but {}", record.from, record.changed.join(", ")),
    }
}

fn write(output: &OutputFile, format: ExportFormat, record: &ExportRecord) -> Result<(), OutputError> {
    match format {
        ExportFormat::Json => output.write(record),
        ExportFormat::Npz => output.write_bytes(&npz::file(record)),
        ExportFormat::Mat => output.write_bytes(&mat::file(record)),
        ExportFormat::C => output.write_bytes(c::header(record, &output.stem()).as_bytes()),
        ExportFormat::Python => output.write_bytes(python::module(record).as_bytes()),
    }
}

/// `column=value`; the name of a column may hold a `=`, its value here cannot.
pub(crate) fn column_value(assignment: &str) -> Result<(String, String), Failure> {
    match assignment.rsplit_once('=') {
        Some((column, value)) if !column.trim().is_empty() && !value.trim().is_empty() => {
            Ok((column.trim().to_owned(), value.trim().to_owned()))
        }
        _ => Err(Failure::NoColumnValue { found: assignment.to_owned() }),
    }
}

pub(crate) fn refused(error: ExportError) -> Failure {
    match error {
        ExportError::Reduce(error) => Failure::Reduce { error: *error, reading: None },
        error => Failure::Export(Box::new(error)),
    }
}
