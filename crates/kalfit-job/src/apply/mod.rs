//! Applying a fitted model to tests: `kalfit apply`.

mod tables;

use kalfit::PhasedTest;
use kalfit::apply::{Applied, ApplyError, Laws, Said, Trust};
use kalfit::record::{AppliedRecord, AppliedSource, Basis};
use kalfit::reduce::{Evidence, grouping};
use kalfit_spec::Spec;

use self::tables::AppliedTests;
use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::{AppliedModel, ApplyJob, JobDone, files};
use crate::output::{OutputTarget, finish_together};
use crate::refused::by_apply;
use crate::table::OutputTable;
use crate::truth::Truth;
use crate::work::{JobWatch, JobWork};
use crate::{tests, truth};

/// Applies a fitted model to tests.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn apply(job: &ApplyJob, watch: &mut dyn JobWatch) -> Result<JobDone<AppliedModel>, Failure> {
    let (mut spec, truth) = truth::load(&job.model, &job.from)?;
    let given = CommandInputs::open(&mut spec, &job.data)?;
    let used = files(&[&job.model.document, &job.from], &given.inputs);
    let [out, along] = [&job.tests, &job.states].map(|to| OutputTable::prepare(to, &used));
    let (out, along) = (out?, along?);
    if let (Some(out), Some(OutputTable { target: OutputTarget::Named(along), .. })) = (&out, &along) {
        out.target.refuse_same(Some(along))?;
    }
    let mut work = JobWork::new(watch);
    let (tests, reading) = tests::read(&spec, &given, &mut work)?;
    let refused = |error| by_apply(error, &reading);
    work.say(|| "running the filters".to_owned());
    let applied = Applied::new(&spec.model, &truth.alpha, &truth.population, &tests).map_err(refused)?;
    work.go_on()?;
    let said = applied.said().map_err(refused)?;
    work.go_on()?;
    if along.is_some() {
        applied.check_states().map_err(refused)?;
    }
    work.say(|| "comparing with the population".to_owned());
    let (laws, source) = judged(&spec, &truth, (&applied, &tests), &said, &job.from.name()).map_err(refused)?;
    work.go_on()?;
    let grouping = grouping(&spec.model, &tests).map_err(|error| refused(error.into()))?;
    let groups = grouping.as_ref().map(|grouping| (grouping, &reading.labels));
    let record = AppliedRecord::new(&spec.model, source, (&tests, groups), (&said, &laws));
    let task = AppliedTests { spec: &spec, applied: &applied, tests: &tests, reading: &reading };
    // neither is in place before both are whole
    let of_tests = out.as_ref().map(|table| task.tests(table, (&said, &laws))).transpose()?;
    let states = along.as_ref().map(|table| task.states(table, job.kind, &mut work)).transpose()?;
    let [of_tests, states] = finish_together([of_tests, states])?;
    let written = [out, along].into_iter().flatten().filter_map(|table| table.target.name()).collect();
    let notes = given.notes.into_iter().chain(truth.warnings).collect();
    Ok(JobDone::new(AppliedModel { record, tests: of_tests, states }, notes, written))
}

/// The laws that tests are judged by, and what they allow for.
fn judged(
    spec: &Spec,
    truth: &Truth,
    (applied, tests): (&Applied<'_>, &[PhasedTest]),
    said: &Said,
    name: &str,
) -> Result<(Laws, AppliedSource), ApplyError> {
    let knowledge = truth.knowledge(spec);
    let own = truth.record.as_ref().map_or(0, |record| record.own_tests(tests, said));
    let is_reduced = tests.iter().flat_map(|test| &test.phases).any(|own| !matches!(own, Evidence::Rows(_)));
    let (basis, laws) = match (&knowledge, truth.fitted) {
        _ if own == tests.len() => (Basis::OwnTests, Laws::known(said)),
        (_, Some(_)) if !spec.model.factors().is_empty() => (Basis::Crossed, Laws::known(said)),
        (None, Some(fitted)) => (Basis::Tests, applied.laws(said, &Trust::Tests(fitted))?),
        (_, None) => (Basis::Given, Laws::known(said)),
        (Some(known), Some(_)) => {
            let basis = if is_reduced { Basis::Population } else { Basis::Estimates };
            (basis, applied.laws(said, &Trust::Estimates(known))?)
        }
    };
    let at_zero = truth.record.as_ref().and_then(|record| record.estimates.as_ref());
    let source = AppliedSource {
        name: name.to_owned(),
        fitted: truth.fitted,
        changed: truth.changed.clone(),
        basis,
        own,
        at_zero: at_zero.map_or_else(Vec::new, |estimates| estimates.exact_zeros()),
    };
    Ok((laws, source))
}
