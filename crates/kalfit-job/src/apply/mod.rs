//! Applying a fitted model to tests: `kalfit apply`.

mod tables;

use kalfit::apply::{Applied, ApplyError};
use kalfit::record::{AppliedRecord, AppliedSource};
use kalfit::reduce::grouping;
use kalfit_data::Reading;

use self::tables::Task;
use crate::evidence::Given;
use crate::failure::Failure;
use crate::job::{AppliedModel, ApplyJob, Done, files};
use crate::output::{Pending, Target};
use crate::table::Table;
use crate::work::{Watch, Work};
use crate::{tests, truth};

/// Applies a fitted model to tests.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn apply(job: &ApplyJob, watch: &mut dyn Watch) -> Result<Done<AppliedModel>, Failure> {
    let (mut spec, truth) = truth::load(&job.model, &job.from)?;
    let given = Given::open(&mut spec, &job.data)?;
    let used = files(&[&job.model.document, &job.from], &given.inputs);
    let [out, along] = [&job.tests, &job.states].map(|to| Table::prepare(to, &used));
    let (out, along) = (out?, along?);
    if let (Some(out), Some(Table { target: Target::Named(along), .. })) = (&out, &along) {
        out.target.refuse_same(Some(along))?;
    }
    let mut work = Work::new(watch);
    let (tests, reading) = tests::read(&spec, &given, &mut work)?;
    let refused = |error| refused(error, &reading);
    work.say(|| "running the filters".to_owned());
    let applied = Applied::new(&spec.model, &truth.alpha, &truth.population, &tests).map_err(refused)?;
    work.go_on()?;
    let said = applied.said().map_err(refused)?;
    work.go_on()?;
    if along.is_some() {
        applied.check_states().map_err(refused)?;
    }
    let source = AppliedSource { name: job.from.name(), fitted: truth.fitted, changed: truth.changed };
    let grouping = grouping(&spec.model, &tests).map_err(|error| refused(error.into()))?;
    let groups = grouping.as_ref().map(|grouping| (grouping, &reading.labels));
    let record = AppliedRecord::new(&spec.model, source, (&tests, groups), &said);
    let task = Task { spec: &spec, applied: &applied, tests: &tests, reading: &reading };
    // neither is in place before both are whole
    let of_tests = out.as_ref().map(|table| task.tests(table, &said)).transpose()?;
    let states = along.as_ref().map(|table| task.states(table, job.kind, &mut work)).transpose()?;
    let of_tests = of_tests.map_or(Ok(None), Pending::finish)?;
    let states = states.map_or(Ok(None), Pending::finish)?;
    let written = [out, along].into_iter().flatten().filter_map(|table| table.target.name()).collect();
    let notes = given.notes.into_iter().chain(truth.warnings).collect();
    Ok(Done::new(AppliedModel { record, tests: of_tests, states }, notes, written))
}

pub(crate) fn refused(error: ApplyError, reading: &Reading) -> Failure {
    match error {
        ApplyError::Reduce(error) => Failure::Reduce { error: *error, reading: Some(Box::new(reading.clone())) },
        ApplyError::Fit(error) => Failure::Fit(error),
        error => Failure::Apply(Box::new(error)),
    }
}
