//! `kalfit test`: a hypothesis within a model.

use kalfit::Alpha;
use kalfit::model::{Level, Parameter};
use kalfit::record::{RatioProvenance, RatioRecord};
use kalfit_spec::{BesideError, Hypothesis, Spec};

use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::{JobDone, TestJob, files};
use crate::output::OutputFile;
use crate::work::{JobWatch, JobWork};
use crate::{known, memory, model, ratio, reductions};

/// Tests a hypothesis within a model.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn test(job: &TestJob, watch: &mut dyn JobWatch) -> Result<JobDone<RatioRecord>, Failure> {
    let mut work = JobWork::new(watch);
    let mut spec = model::load(&job.model, &job.data)?;
    memory::suffices(&spec)?;
    let given = CommandInputs::open(&mut spec, &job.data)?;
    let hypothesis = hypothesis(&spec, job)?;
    let read = files(&[&job.model.document, &job.null], &given.inputs);
    let output = OutputFile::results(job.out.as_deref(), &read)?;
    let record = read_and_test(job, &spec, &hypothesis, &given, &mut work)?;
    work.go_on()?;
    JobDone::in_json(record, given.notes, output.as_ref())
}

fn hypothesis(spec: &Spec, job: &TestJob) -> Result<Hypothesis, Failure> {
    let text = model::text(&job.null)?;
    spec.under(&text).map_err(|error| match error {
        BesideError::File(error) => Failure::model(error, &job.null.name(), Some(text)),
        BesideError::Model(error) => Failure::model(error, &spec.name, Some(spec.text.clone())),
    })
}

/// Which way it goes: with known parameters tests are forgotten once they are reduced.
fn read_and_test(
    job: &TestJob,
    spec: &Spec,
    hypothesis: &Hypothesis,
    given: &CommandInputs,
    work: &mut JobWork<'_>,
) -> Result<RatioRecord, Failure> {
    let provenance = RatioProvenance {
        title: spec.model.shared().title.clone(),
        hypothesis: hypothesis.title.clone().unwrap_or_else(|| job.null.name()),
        model_digest: Some(spec.digest.clone()),
        null_digest: Some(hypothesis.digest.clone()),
        files: given.names(),
    };
    if model::has_free(spec.model.shared()) || !spec.model.levels.is_empty() {
        return ratio::test(job, (spec, hypothesis), given, provenance, work);
    }
    let alpha = model::alpha(spec);
    same_parameters(hypothesis, &alpha)?;
    let reductions = reductions::reduce(spec, &alpha, given, work, &mut |_| ())?;
    known::test(job, (spec, hypothesis), (&alpha, &reductions, None), provenance, work)
}

/// Parameters of a model without free ones must be the same on both sides.
fn same_parameters(hypothesis: &Hypothesis, alpha: &Alpha) -> Result<(), Failure> {
    let alone = |parameter: &Parameter| Alpha::fixed(std::slice::from_ref(parameter)).ok();
    let same = |parameter: &Parameter, known: &Level| alone(parameter).is_some_and(|null| null.values[0] == *known);
    match hypothesis
        .model
        .shared()
        .parameters
        .iter()
        .zip(&alpha.values)
        .find(|(parameter, known)| !same(parameter, known))
    {
        None => Ok(()),
        Some((parameter, _)) => Err(Failure::HypothesisParameter { name: parameter.name.clone() }),
    }
}
