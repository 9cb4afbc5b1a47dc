//! `kalfit fit`.

use std::path::Path;

use kalfit::estimate::{Combination, Criterion, Structure};
use kalfit::infer::StdErrors;
use kalfit::model::Population;
use kalfit::record::Provenance;
use kalfit::{Alpha, FitRecord, Reduction, estimate, infer};
use kalfit_data::Input;
use kalfit_report::summary;
use kalfit_spec::Spec;

use crate::evidence::Given;
use crate::failure::Failure;
use crate::innovations::{self, Kept};
use crate::job::{FitJob, Outcome};
use crate::output::Output;
use crate::progress::Line;
use crate::{dynamic, lost, model, reductions, report, terminal, tests};

pub(crate) fn run(job: &FitJob) -> Result<Outcome, Failure> {
    if job.settings.criterion == Criterion::Reml && job.choices.std_errors != StdErrors::Observed {
        return Err(Failure::RestrictedErrors); // log|ΣB'WB| is no sum over tests
    }
    let mut spec = model::load(&job.model)?;
    refuse_one_phase(job, &spec)?;
    let given = Given::open(&mut spec, &job.data)?;
    let free = model::has_free(spec.model.shared());
    if !free {
        refuse_idle(job)?;
    } else if job.choices.std_errors != StdErrors::Observed {
        return Err(Failure::FreeErrors);
    }
    let output = job.out.as_deref().map(|path| Output::prepare(path, &files(job, &given.inputs))).transpose()?;
    let report = job.report.as_deref().map(|path| Output::prepare(path, &files(job, &given.inputs))).transpose()?;
    report.as_ref().map_or(Ok(()), |report| report.refuse_same(output.as_ref()))?;
    let mut record = if free { dynamic::fit(job, &spec, &given)? } else { fit(job, &spec, &given)? };
    record.notes.splice(0..0, given.notes);
    if let Some(output) = &output {
        output.write(&record)?;
    }
    if let Some(report) = &report {
        report::write(report, &kalfit_report::html(&record))?;
    }
    if !job.quiet {
        terminal::print(&summary(&record, &terminal::style())).map_err(Failure::Stdout)?;
        for output in [&output, &report].into_iter().flatten() {
            terminal::complain(&format!("Wrote {}\n", output.name()));
        }
    }
    Ok(if record.converged { Outcome::Done } else { Outcome::NotCertified })
}

/// Other starts of α have no effect when nothing of it is free. The methods are then one and the same, and any may be named.
pub(crate) fn refuse_idle(job: &FitJob) -> Result<(), Failure> {
    if job.search.starts > 0 { Err(Failure::NoFreeParameter { option: "--starts" }) } else { Ok(()) }
}

/// One phase cannot be put together with others; to name the default is no harm.
fn refuse_one_phase(job: &FitJob, spec: &Spec) -> Result<(), Failure> {
    match (spec.model.is_single(), job.settings.phases) {
        (false, _) | (true, Combination::Chain) => Ok(()),
        (true, Combination::Marginal) => Err(Failure::OnePhase { found: "marginal" }),
        (true, Combination::Stacked) => Err(Failure::OnePhase { found: "stacked" }),
    }
}

/// The method in one place, with known parameters: reduce, estimate, infer, record.
fn fit(job: &FitJob, spec: &Spec, given: &Given) -> Result<FitRecord, Failure> {
    let mut line = Line::new(job.quiet);
    let alpha = model::alpha(spec);
    if !given.is_rows() || lost::filters_rows(&spec.model) {
        let (tests, reading) = tests::read(spec, given, &mut line)?;
        return dynamic::known(job, spec, given, (&alpha, &tests, &reading), &mut line);
    }
    let mut kept = if job.innovations { Kept::of(&given.inputs) } else { Kept::nothing() };
    let reductions = reductions::reduce_keeping(spec, &alpha, given, &mut line, &mut kept)?;
    let (mut record, population) = record(job, spec, given, (&alpha, &reductions), &mut line)?;
    if job.innovations {
        innovations::add(&mut record, kept, (spec, &alpha, &given.inputs), &population, &mut line);
        record.solver.seconds = line.seconds();
    }
    Ok(record)
}

/// Estimate, infer, record; the population too.
pub(crate) fn record(
    job: &FitJob,
    spec: &Spec,
    given: &Given,
    (alpha, reductions): (&Alpha, &[Reduction]),
    line: &mut Line,
) -> Result<(FitRecord, Population), Failure> {
    let structure = Structure::of(&spec.model, alpha);
    let estimate = estimate::fit(reductions, &structure, &job.settings, line).map_err(Failure::Fit)?;
    let inference = infer::infer(&estimate, reductions, job.choices);
    let provenance = Provenance {
        model_digest: Some(spec.digest.clone()),
        model: spec.describe(),
        files: given.names(),
        seconds: line.seconds(),
        of_estimates: given.is_of_estimates(&spec.model),
    };
    let record = FitRecord::new(&spec.model, alpha, reductions, &estimate, &inference, provenance);
    Ok((record, Population::from(&estimate)))
}

fn files<'a>(job: &'a FitJob, inputs: &'a [Input]) -> Vec<&'a Path> {
    let data = inputs.iter().filter_map(|input| match input {
        Input::Path(path) => Some(path.as_path()),
        Input::Stdin => None,
    });
    std::iter::once(job.model.path.as_path()).chain(data).collect()
}
