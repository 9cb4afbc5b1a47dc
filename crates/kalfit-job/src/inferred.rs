//! From reductions to a record: estimate, infer, record.

use kalfit::estimate::Structure;
use kalfit::infer::{Choices, DeletionChoice, IntervalKind};
use kalfit::model::Population;
use kalfit::record::{Provenance, TestGroups};
use kalfit::{Alpha, FitRecord, Reductions, estimate, infer};
use kalfit_spec::Spec;

use crate::evidence::Given;
use crate::failure::Failure;
use crate::groups;
use crate::job::FitJob;
use crate::work::Work;

/// Estimate, infer, record; the population too.
pub(crate) fn record(
    job: &FitJob,
    spec: &Spec,
    given: &Given,
    (alpha, reductions, groups): (&Alpha, &Reductions, Option<&TestGroups>),
    work: &mut Work<'_>,
) -> Result<(FitRecord, Population), Failure> {
    let structure = Structure::of(&spec.model, alpha, None);
    let estimate = estimate::fit(reductions, &structure, &job.settings, work).map_err(Failure::Fit)?;
    let inference = infer::infer(&estimate, reductions, patience(job.choices, work));
    let provenance = Provenance {
        model_digest: Some(spec.digest.clone()),
        model: spec.describe(),
        files: given.names(),
        seconds: work.seconds(),
        of_estimates: given.is_of_estimates(&spec.model),
    };
    let mut record = FitRecord::new(&spec.model, alpha, reductions, &estimate, &inference, provenance);
    if let Some(groups) = groups {
        groups::add(job, &mut record, groups, (&spec.model, alpha, &estimate, reductions), work)?;
    }
    beside(inference);
    let population = Population::from(&estimate);
    beside(estimate);
    Ok((record, population))
}

/// What is asked of the inference: the least of it once nobody waits.
pub(crate) fn patience(choices: Choices, work: &Work<'_>) -> Choices {
    if work.is_stopped() {
        return Choices { intervals: IntervalKind::Wald, deletion: DeletionChoice::None, ..choices };
    }
    choices
}

/// Frees what takes long to free while other work goes on.
pub(crate) fn beside<T: Send + 'static>(done: T) {
    rayon::spawn(move || drop(done));
}
