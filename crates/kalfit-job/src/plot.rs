//! `kalfit plot`: one figure of a fit or a plan, as SVG, PDF or PNG.

use std::path::Path;

use kalfit::FitRecord;
use kalfit::along::along;
use kalfit::record::AlongRecord;
use kalfit_report::{PlotFormat, PlotKind};

use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::{JobDone, PlotJob, files};
use crate::output::{FileContents, OutputError, OutputFile};
use crate::results::{FIT, PLAN, read};
use crate::work::{JobWatch, JobWork};
use crate::{tests, truth};

/// Draws a figure of a fit or a plan from its results; figures of data with the model and the data, too.
///
/// # Errors
/// Bad input, or nothing to draw.
pub fn plot(job: &PlotJob, watch: &mut dyn JobWatch) -> Result<JobDone<()>, Failure> {
    let (output, format) = prepared(job, &files(&[&job.fit], &[]))?;
    let shown = |record: &FitRecord, along: Option<&AlongRecord>| {
        let chosen = (along, job.test.as_deref());
        kalfit_report::plot(record, job.what, chosen, (format, job.width)).map_err(Failure::Plot)
    };
    let (figure, notes) = match (job.what, &job.model) {
        (what, Some(model)) if what.is_of_data() => {
            let (mut spec, truth) = truth::load(model, &job.fit)?;
            let given = CommandInputs::open(&mut spec, &job.data)?;
            prepared(job, &files(&[&model.document, &job.fit], &given.inputs))?;
            let record = truth.record.ok_or(Failure::PlotOfModel)?;
            let mut work = JobWork::new(watch);
            let (read, _) = tests::read(&spec, &given, &mut work)?;
            let known = spec.model.shared().clock.time.is_some().then(|| {
                along((&spec.model, &truth.alpha, &truth.population), &read, &record, &mut |_| !work.is_stopped())
            });
            work.go_on()?;
            (shown(&record, known.as_ref())?, [truth.warnings, given.notes].concat())
        }
        (what, None) if what.is_of_data() => return Err(Failure::RecordsWithoutData),
        _ if job.model.is_some() || !job.data.is_empty() || job.test.is_some() => return Err(Failure::IdlePlotData),
        (PlotKind::Sensitivities, _) => {
            let record = read(&job.fit, PLAN).map_err(|error| Failure::Report(Box::new(error)))?;
            (kalfit_report::plot_plan(&record, (format, job.width)).map_err(Failure::Plot)?, Vec::new())
        }
        _ => (shown(&read(&job.fit, FIT).map_err(|error| Failure::Report(Box::new(error)))?, None)?, Vec::new()),
    };
    output.write_bytes(&figure)?;
    Ok(JobDone::new((), notes, vec![output.name()]))
}

/// The file, and its format, which its ending says.
fn prepared(job: &PlotJob, inputs: &[&Path]) -> Result<(OutputFile, PlotFormat), Failure> {
    let ending = job.out.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    let format = match ending.as_deref() {
        Some("svg") => PlotFormat::Svg,
        Some("png") => PlotFormat::Png,
        Some("pdf") => PlotFormat::Pdf,
        _ => {
            let (path, option) = (job.out.clone(), "--out");
            return Err(OutputError::Ending { path, contents: FileContents::Figure, option }.into());
        }
    };
    Ok((OutputFile::prepare(&job.out, inputs)?, format))
}
