//! The numbers of a datasheet: `kalfit datasheet`.

use kalfit::datasheet::{Source, datasheet as sheet};
use kalfit::record::DatasheetRecord;

use crate::evidence::CommandInputs;
use crate::export::{column_value, refused};
use crate::failure::Failure;
use crate::job::{DatasheetJob, JobDone, files};
use crate::output::OutputFile;
use crate::work::{JobWatch, JobWork};
use crate::{tests, truth};

/// Makes the numbers of a datasheet of a fit, with data the Allan deviations of their records beside those of the model.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn datasheet(job: &DatasheetJob, watch: &mut dyn JobWatch) -> Result<JobDone<DatasheetRecord>, Failure> {
    if job.step.is_some() && !job.data.is_empty() {
        return Err(Failure::StepBesideData);
    }
    let (mut spec, truth) = truth::load(&job.model, &job.from)?;
    let at = job.at.iter().map(|assignment| column_value(assignment)).collect::<Result<Vec<_>, Failure>>()?;
    let given = match job.data.is_empty() {
        true => None,
        false => Some(CommandInputs::open(&mut spec, &job.data)?),
    };
    let inputs = given.as_ref().map_or(&[][..], |given| &given.inputs);
    let used = files(&[&job.model.document, &job.from], inputs);
    let output = OutputFile::results(job.out.as_deref(), &used)?;
    let mut notes = truth.warnings;
    let tests = match given {
        None => None,
        Some(given) => {
            let (tests, _) = tests::read(&spec, &given, &mut JobWork::new(watch))?;
            notes.extend(given.notes);
            Some(tests)
        }
    };
    let source = Source {
        name: job.from.name(),
        record: truth.record.as_deref(),
        step: job.step,
        at: &at,
        tests: tests.as_deref(),
    };
    let record = sheet(&spec.model, &truth.alpha, &truth.population, &source).map_err(refused)?;
    JobDone::in_json(record, notes, output.as_ref())
}
