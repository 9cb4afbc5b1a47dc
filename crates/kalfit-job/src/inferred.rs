//! From reductions to a record: estimate, infer, record.

use std::sync::Arc;

use kalfit::estimate::Structure;
use kalfit::infer::{Choices, DeletionChoice, IntervalKind};
use kalfit::model::Population;
use kalfit::record::TestGroups;
use kalfit::{Alpha, FitRecord, Grouping, Labels, Reductions, estimate, infer};
use kalfit_spec::Spec;

use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::groups;
use crate::job::FitJob;
use crate::work::JobWork;

/// How tests are sorted.
#[derive(Clone, Copy, Default)]
pub(crate) struct TestSorting<'a> {
    /// By a column, for reports.
    pub(crate) by: Option<&'a TestGroups>,
    /// Into the groups of the model's levels, whose names are among the labels.
    pub(crate) levels: Option<(&'a Arc<Grouping>, &'a Labels)>,
}

/// Estimate, infer, record; the population of tests and levels too.
pub(crate) fn record(
    job: &FitJob,
    spec: &Spec,
    given: &CommandInputs,
    (alpha, reductions, sorted): (&Alpha, &Reductions, TestSorting<'_>),
    work: &mut JobWork<'_>,
) -> Result<(FitRecord, Population), Failure> {
    let structure = Structure::of(&spec.model, alpha, sorted.levels.map(|(grouping, _)| grouping));
    let estimate = estimate::fit(reductions, &structure, &job.settings, work).map_err(Failure::Fit)?;
    let choices = patience(job.choices, work);
    let inference = infer::infer_while(&spec.model, (&estimate, reductions), choices, work);
    let provenance = given.provenance(spec, work.seconds());
    let mut record = FitRecord::new(&spec.model, alpha, reductions, &estimate, &inference, provenance);
    if let Some((grouping, labels)) = sorted.levels {
        record.add_levels((&spec.model, labels), (Some(grouping), reductions), &inference);
    }
    if let Some(groups) = sorted.by {
        groups::add(job, &mut record, groups, (&spec.model, alpha, &estimate, reductions), work)?;
    }
    beside(inference);
    let population = Population::from(&estimate);
    beside(estimate);
    Ok((record, population))
}

/// What is asked of the inference: the least of it once nobody waits.
pub(crate) fn patience(choices: Choices, work: &JobWork<'_>) -> Choices {
    if work.is_stopped() {
        return Choices { intervals: IntervalKind::Wald, deletion: DeletionChoice::None, ..choices };
    }
    choices
}

/// Frees what takes long to free while other work goes on.
pub(crate) fn beside<T: Send + 'static>(done: T) {
    rayon::spawn(move || drop(done));
}
