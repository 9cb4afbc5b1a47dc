//! `kalfit fit` where dynamic parameters are free: the tests are kept, since the filters run again whenever α moves.

use std::sync::Arc;

use kalfit::dynamic::{self, DynamicError, DynamicFit, Method, Settings, accepts_intervals};
use kalfit::infer::misfit::FittedEnsemble;
use kalfit::model::{Population, Slots};
use kalfit::record::{DynamicParts, LevelCounts, MethodRecord, level_notes};
use kalfit::reduce::grouping;
use kalfit::{Alpha, FitRecord, Labels, PhasedModel, PhasedTest};
use kalfit_data::DataReading;
use kalfit_spec::Spec;

use crate::along::HeldTests;
use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::forecast::SearchForecast;
use crate::idle::refuse_idle;
use crate::inferred::{TestSorting, patience, record};
use crate::innovations;
use crate::job::{FitJob, MethodChoice};
use crate::work::JobWork;
use crate::{groups, lost, memory, reductions, tests};

/// Every method, the one that the results are of first.
const ALL: [Method; 3] = [Method::Hybrid, Method::Innovations, Method::Em];

/// The method in one place: read, fit, infer, record.
pub(crate) fn fit(
    job: &FitJob,
    spec: &Spec,
    given: &CommandInputs,
    work: &mut JobWork<'_>,
) -> Result<(FitRecord, HeldTests), Failure> {
    let (model, shared) = (&spec.model, spec.model.shared());
    let (tests, reading) = tests::read(spec, given, work)?;
    memory::suffices_for(tests.len(), spec, job.choices.tests)?;
    let rows = tests.iter().map(PhasedTest::row_count).sum();
    work.forecasts(SearchForecast::new(tests.len(), rows, model.dimension()));
    let slots = Slots::in_phases(model, &reading.labels, &tests);
    let notes = level_notes(shared, &LevelCounts::all(shared, &reading.labels, &tests));
    if slots.is_empty() {
        let alpha = slots.alpha(shared, &[]);
        let mut record = known(job, spec, given, (&alpha, &tests, &reading), work)?;
        record.notes.extend(notes);
        return Ok((record, HeldTests::Tests(tests, alpha)));
    }
    accepts_intervals(job.choices, model, &slots).map_err(|error| failure(error, &reading))?;
    let groups = groups::of(model, &tests, &reading.labels)?;
    let data = SearchData { model, tests: &tests, reading: &reading };
    let methods = match job.method {
        MethodChoice::By(method) => vec![method],
        MethodChoice::All => ALL.to_vec(),
    };
    let mut ends = Vec::new();
    let mut first = None;
    for method in methods {
        if work.is_stopped() && first.is_some() {
            break;
        }
        let began = work.seconds();
        let fit = data.fit(&Settings { method, ..job.search.clone() }, work)?;
        ends.push(MethodRecord::new(&fit, work.seconds() - began));
        first = first.or(Some(fit));
    }
    let fit = first.expect("there is at least one method");
    work.say(|| "standard errors and intervals".to_owned());
    let choices = patience(job.choices, work);
    let found = dynamic::infer(model, (&reading.labels, &tests), &fit, choices, work);
    let (inference, parameters) = found.map_err(|error| failure(error, &reading))?;
    let parts =
        DynamicParts { model, labels: &reading.labels, fit: &fit, inference: &inference, parameters: &parameters };
    let mut record = FitRecord::dynamic(&parts, given.provenance(spec, work.seconds()));
    record.notes.extend(notes);
    if let Some(groups) = groups {
        groups::add(job, &mut record, &groups, (model, &fit.alpha, &fit.estimate, &fit.reductions), work)?;
    }
    let grouping = fit.estimate.grouping().map(|grouping| &**grouping);
    record.add_levels((model, &reading.labels), (grouping, &fit.reductions), &inference);
    let population = Population::from(&fit.estimate).together(model.dimension(), &model.slots());
    lost::add(&mut record, (model, &fit.alpha, &population), &fit.reductions, (&tests, &reading));
    if ends.len() > 1 {
        record.add_methods(ends);
    }
    if job.innovations {
        let at = (model, &fit.alpha, &population);
        innovations::add_of(&mut record, at, &tests, work);
        let grouping = fit.estimate.grouping().map(|grouping| &**grouping);
        let population = Population::from(&fit.estimate);
        let of = FittedEnsemble { model, alpha: &fit.alpha, population: &population, tests: &tests, grouping };
        innovations::add_misfit(&mut record, &of, work);
        record.solver.seconds = work.seconds();
    }
    Ok((record, HeldTests::Tests(tests, fit.alpha)))
}

/// With known parameters, of tests that are kept.
pub(crate) fn known(
    job: &FitJob,
    spec: &Spec,
    given: &CommandInputs,
    (alpha, tests, reading): (&Alpha, &[PhasedTest], &DataReading),
    work: &mut JobWork<'_>,
) -> Result<FitRecord, Failure> {
    refuse_idle(job)?;
    let groups = groups::of(&spec.model, tests, &reading.labels)?;
    let grouping = grouping(&spec.model, tests).map_err(|error| failure(error.into(), reading))?.map(Arc::new);
    let sorted =
        TestSorting { by: groups.as_ref(), levels: grouping.as_ref().map(|grouping| (grouping, &reading.labels)) };
    let reductions = reductions::of_all(&spec.model, alpha, (tests, reading), work)?;
    let (mut record, population) = record(job, spec, given, (alpha, &reductions, sorted), work)?;
    let together = population.together(spec.model.dimension(), &spec.model.slots());
    lost::add(&mut record, (&spec.model, alpha, &together), &reductions, (tests, reading));
    if job.innovations {
        innovations::add_of(&mut record, (&spec.model, alpha, &together), tests, work);
        let of =
            FittedEnsemble { model: &spec.model, alpha, population: &population, tests, grouping: grouping.as_deref() };
        innovations::add_misfit(&mut record, &of, work);
        record.solver.seconds = work.seconds();
    }
    Ok(record)
}

/// What a search for α is made in.
pub(crate) struct SearchData<'a> {
    pub(crate) model: &'a PhasedModel,
    pub(crate) tests: &'a [PhasedTest],
    pub(crate) reading: &'a DataReading,
}

impl SearchData<'_> {
    pub(crate) fn labels(&self) -> &Labels {
        &self.reading.labels
    }

    pub(crate) fn fit(&self, settings: &Settings, work: &mut JobWork<'_>) -> Result<DynamicFit, Failure> {
        dynamic::fit(self.model, self.labels(), self.tests, settings, work)
            .map_err(|error| failure(error, self.reading))
    }
}

/// What the core says, with the files and texts of the data.
pub(crate) fn failure(error: DynamicError, reading: &DataReading) -> Failure {
    match error {
        DynamicError::Reduce(error) => Failure::Reduce { error: *error, reading: Some(Box::new(reading.clone())) },
        DynamicError::Fit(error) => Failure::Fit(error),
        DynamicError::Interrupted => Failure::Interrupted,
        error @ (DynamicError::Grouping(_)
        | DynamicError::Bootstrap { .. }
        | DynamicError::Marginal { .. }
        | DynamicError::Expected { .. }
        | DynamicError::FixedReduction { .. }) => Failure::Dynamic(Box::new(error)),
    }
}
