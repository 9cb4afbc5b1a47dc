//! `kalfit fit`.

use kalfit::estimate::Criterion;
use kalfit::infer::misfit::FittedEnsemble;
use kalfit::infer::{DfChoice, StdErrors, TestsChoice};
use kalfit::record::{ParameterRecord, TestGroups};
use kalfit::{Alpha, FitRecord, PhasedTest};
use kalfit_spec::Spec;

use crate::along::HeldTests;
use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::fitted::{FitFiles, WrittenFiles};
use crate::idle::{refuse_idle, refuse_one_phase};
use crate::inferred::{TestSorting, beside, record};
use crate::innovations::{self, KeptData};
use crate::job::{FitJob, JobDone, files};
use crate::offset::Multipliers;
use crate::survey::DataSurvey;
use crate::work::{JobWatch, JobWork};
use crate::{dynamic, groups, lost, memory, model, reductions, tests};

/// Said of a search that had converged when nobody waited any longer.
const CUT_SHORT: &str = "it was interrupted after it had converged: other starts, methods, intervals and fits without each test that were asked for may be \
     missing";

/// Said where the list of tests is empty.
const NO_TESTS: &str = "what each test says was not asked for";

/// Refuses what needs independent tests where groups of tests cross.
fn refuse_with_factors(job: &FitJob, spec: &Spec) -> Result<(), Failure> {
    let refuse = |what, hint| model::refuse_crossed(spec, what, hint);
    if job.choices.std_errors == StdErrors::Sandwich {
        refuse(
            "sandwich standard errors are not computed",
            "they take scores of independent tests; leave the option out",
        )?;
    }
    if job.tables.rows.is_some() {
        refuse("single measurements are not judged", "leave `--rows` out; `--innovations on` judges tests")?;
    }
    Ok(())
}

/// Fits a model to data. A search that is [stopped](JobWatch::stops) ends with the best that it found, and a record that says so,
/// and writes no file unless the job [keeps](FitJob::keeps_stopped) it.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`] before the search began.
pub fn fit(job: &FitJob, watch: &mut dyn JobWatch) -> Result<JobDone<FitRecord>, Failure> {
    if job.settings.criterion == Criterion::Reml && job.choices.std_errors != StdErrors::Observed {
        return Err(Failure::RestrictedErrors); // log|ΣB'WB| is no sum over tests
    }
    if job.settings.criterion == Criterion::Ml
        && matches!(job.choices.df, DfChoice::KenwardRoger | DfChoice::Satterthwaite)
    {
        return Err(Failure::UnrestrictedDf);
    }
    let mut spec = model::load(&job.model, &job.data)?;
    memory::suffices(&spec)?;
    refuse_one_phase(job, &spec)?;
    refuse_with_factors(job, &spec)?;
    let given = CommandInputs::open(&mut spec, &job.data)?;
    groups::refuse(job, &spec.model, &given)?;
    let free = model::has_free(spec.model.shared());
    if !free {
        refuse_idle(job)?;
    }
    let read = files(&[&job.model.document], &given.inputs);
    let files = FitFiles::prepare(job, &read)?;
    let mut work = JobWork::new(watch);
    let mut survey = DataSurvey::of(&spec.model);
    let (mut record, held) = if free {
        dynamic::fit(job, &spec, &given, &mut work)?
    } else {
        known(job, (&spec, &mut survey), &given, &mut work)?
    };
    if let HeldTests::Tests(tests, _) = &held
        && survey.is_empty()
    {
        survey = DataSurvey::among(&spec.model, tests);
    }
    if let HeldTests::Tests(tests, _) = &held
        && is_in_doubt(&record)
    {
        record.notes.extend(Multipliers::among(&spec.model, tests).notes());
    }
    record.add_by_group();
    record.add_model_check();
    record.notes.splice(0..0, spec.questions().into_iter().chain(survey.notes()).chain(given.notes));
    if job.choices.tests == TestsChoice::None {
        record.notes.push(NO_TESTS.to_owned());
    }
    if work.is_stopped() && record.converged {
        record.notes.push(CUT_SHORT.to_owned());
    }
    let WrittenFiles { names, failed } = files.write(&mut record, held, &spec.model, &mut work)?;
    let unwritten = failed.iter().map(Failure::to_string).collect();
    Ok(JobDone { unwritten, ..JobDone::new(record, Vec::new(), names) })
}

/// It has no maximum, or not one that determines all.
fn is_in_doubt(record: &FitRecord) -> bool {
    let is_open = |parameter: &ParameterRecord| parameter.standing.as_deref() == Some("unidentified");
    !record.converged
        || record.phases.iter().any(|phase| !phase.unidentified.is_empty())
        || record.parameters.iter().any(is_open)
}

/// The method in one place, with known parameters: reduce, estimate, infer, record.
fn known<'m>(
    job: &FitJob,
    (spec, survey): (&'m Spec, &mut DataSurvey<'m>),
    given: &CommandInputs,
    work: &mut JobWork<'_>,
) -> Result<(FitRecord, HeldTests), Failure> {
    let alpha = model::alpha(spec);
    if given.is_reductions() && spec.model.is_single() && spec.model.levels.is_empty() {
        return Ok((reduced(job, spec, given, &alpha, work)?, HeldTests::Nothing));
    }
    if !given.is_rows() || lost::filters_rows(&spec.model) || !spec.model.levels.is_empty() {
        let (tests, reading) = tests::read(spec, given, work)?;
        let record = dynamic::known(job, spec, given, (&alpha, &tests, &reading), work)?;
        return Ok((record, HeldTests::Tests(tests, alpha)));
    }
    let looks_again = job.innovations || job.report.is_some();
    let mut kept = if looks_again { KeptData::of(&given.inputs) } else { KeptData::nothing() };
    kept.groups = TestGroups::new(spec.model.shared());
    let mut counted = |test: Option<&PhasedTest>| match test {
        Some(test) => survey.add(test),
        None => *survey = DataSurvey::of(&spec.model),
    };
    let reductions = reductions::reduce_keeping(spec, &alpha, given, (work, &mut counted), &mut kept)?;
    memory::suffices_for(reductions.len(), spec, job.choices.tests)?;
    let (mut record, population) = record(
        job,
        spec,
        given,
        (&alpha, &reductions, TestSorting { by: kept.groups.as_ref(), ..TestSorting::default() }),
        work,
    )?;
    beside(reductions); // what comes next can have their memory
    if job.innovations {
        innovations::add(&mut record, &mut kept, (spec, &alpha, &given.inputs), &population, work);
        if let Some(tests) = kept.tests.known() {
            let model = &spec.model;
            let of = FittedEnsemble { model, alpha: &alpha, population: &population, tests, grouping: None };
            innovations::add_misfit(&mut record, &of, work);
        } else {
            let note =
                "misfit that tests have in common was not looked for: the data are too large to be kept in memory";
            record.notes.push(note.to_owned());
        }
        record.solver.seconds = work.seconds();
    }
    Ok((record, HeldTests::kept(kept.tests.all(), alpha)))
}

/// The filters have run: estimate, infer, record.
fn reduced(
    job: &FitJob,
    spec: &Spec,
    given: &CommandInputs,
    alpha: &Alpha,
    work: &mut JobWork<'_>,
) -> Result<FitRecord, Failure> {
    refuse_idle(job)?;
    let reductions = given.reduced(spec, work)?;
    let (mut record, population) = record(job, spec, given, (alpha, &reductions, TestSorting::default()), work)?;
    if job.innovations {
        innovations::add_none(&mut record, (&spec.model, alpha, &population), reductions.len(), work);
        record.solver.seconds = work.seconds();
    }
    beside(reductions);
    Ok(record)
}
