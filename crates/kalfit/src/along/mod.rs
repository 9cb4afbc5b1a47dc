//! Estimates along the records of the tests of a fit: for charts. Their number is bounded for ensembles of any size.
//!
//! ```text
//! fit + its tests ──> Allan deviations of all records, together with those of the model
//!                └──> the least probable tests: record and predictions, innovations, smoothed states
//! ```
//!
//! All estimates are computed by [`datasheet`](crate::datasheet), [`apply`](crate::apply) and
//! [`innovations`](crate::innovations); of long records only some values are included.

#[cfg(test)]
mod tests;
mod thin;
mod walk;

use crate::along::walk::RecordEvaluator;
use crate::datasheet::allan;
use kalfit_apply::apply::{Applied, ApplyError};
use kalfit_filter::innovations::InnovationFilter;
use kalfit_model::{Alpha, PhasedModel, Population};
use kalfit_model::{Evidence, PhasedTest};
use kalfit_record::{AlongRecord, FitRecord, TestRecord};

/// Largest number of tests that are shown one by one.
const MAX_TESTS: usize = 20;
/// Largest number of values of a series.
const MAX_VALUES: usize = 400;
/// Smallest number of values that a series of a longer record is thinned to.
const MIN_VALUES: usize = 100;
/// Approximate largest number of values in all series together.
const MAX_NUMBERS: usize = 240_000;
/// Largest number of innovations in a quantile plot.
const MAX_QUANTILES: usize = 120;

/// Estimates along the records of the tests of a fit. `goes_on` is given the number of tests done, and returns false to
/// stop.
///
/// Where tests are in groups, `tests` must be all tests of the fit: the estimates of a test depend on the group of the
/// test. A model without times has no records over time, and gives an empty answer.
pub fn along(
    (model, alpha, population): (&PhasedModel, &Alpha, &Population),
    tests: &[PhasedTest],
    fit: &FitRecord,
    goes_on: &mut dyn FnMut(usize) -> bool,
) -> AlongRecord {
    let clock = &model.shared().clock;
    let mut record = AlongRecord { time_unit: clock.unit.clone(), of: tests.len(), ..AlongRecord::default() };
    if clock.time.is_none() || tests.is_empty() {
        return record;
    }
    match allan((model, alpha, population), tests) {
        Ok((curves, notes)) => (record.allan, record.allan_notes) = (curves, notes),
        Err(error) => record.notes.push(format!("there are no Allan deviations: {error}")),
    }
    if let Err(error) = add_tests((model, alpha, population), tests, fit, (&mut record, goes_on)) {
        record.notes.push(format!("records are not shown test by test: {error}"));
    }
    record
}

/// Adds the estimates along the least probable tests to the record.
fn add_tests(
    (model, alpha, population): (&PhasedModel, &Alpha, &Population),
    tests: &[PhasedTest],
    fit: &FitRecord,
    (record, goes_on): (&mut AlongRecord, &mut dyn FnMut(usize) -> bool),
) -> Result<(), ApplyError> {
    let (most, values) = bounds(model);
    let mut tests_by_p_value = tests_by_p_value(tests, fit);
    if tests_by_p_value.is_empty() {
        record.notes.push("records are not shown test by test: no test has rows of data".to_owned());
        return Ok(());
    }
    tests_by_p_value.truncate(most);
    // the estimates of a test in groups depend on all tests
    let copies: Vec<PhasedTest>;
    let (own, places): (&[PhasedTest], Vec<usize>) = if model.levels.is_empty() {
        copies = tests_by_p_value.iter().map(|&test| tests[test].clone()).collect();
        (&copies, (0..tests_by_p_value.len()).collect())
    } else {
        (tests, tests_by_p_value)
    };
    let applied = Applied::new(model, alpha, population, own)?;
    let filter = InnovationFilter::new(model, alpha, &population.together(model.dimension(), &model.slots()))?;
    for (done, &place) in places.iter().enumerate() {
        if !goes_on(done) {
            record.notes.push(format!("{} of the records are shown: the fit was interrupted", record.tests.len()));
            return Ok(());
        }
        let walk = RecordEvaluator { model, applied: &applied, filter: &filter, values };
        record.tests.push(walk.test(&own[place], place)?);
    }
    Ok(())
}

/// Number of tests that are shown for a model, and number of values of each series.
fn bounds(model: &PhasedModel) -> (usize, usize) {
    let of = |phase: &kalfit_model::Phase| 1 + 2 * phase.model.states.len() + 6 * phase.model.measurements.len();
    let numbers = model.phases.iter().map(of).sum::<usize>().max(1);
    let tests = (MAX_NUMBERS / (numbers * MIN_VALUES)).clamp(1, MAX_TESTS);
    (tests, (MAX_NUMBERS / (numbers * tests)).clamp(MIN_VALUES, MAX_VALUES))
}

/// Indices of the tests that are given by rows, by ascending p-value, then by id.
fn tests_by_p_value(tests: &[PhasedTest], fit: &FitRecord) -> Vec<usize> {
    let of: std::collections::HashMap<&str, f64> =
        fit.tests.iter().map(|test| (test.id, smallest_p_value(test))).collect();
    let p_value = |test: usize| of.get(tests[test].id.as_str()).copied().unwrap_or(2.0);
    let all_rows = |test: &PhasedTest| {
        let mut phases = test.phases.iter();
        phases.all(|evidence| matches!(evidence, Evidence::Rows(_)))
    };
    let mut tests_by_p_value: Vec<usize> = (0..tests.len()).filter(|&test| all_rows(&tests[test])).collect();
    tests_by_p_value.sort_by(|&a, &b| p_value(a).total_cmp(&p_value(b)).then_with(|| tests[a].id.cmp(&tests[b].id)));
    tests_by_p_value
}

/// Smallest of the p-values of a test for the distance, for the size of the innovations, and for the whiteness of the
/// innovations; 2 where the test has no p-value.
fn smallest_p_value(test: TestRecord<'_>) -> f64 {
    let seen = test.innovations;
    let white = seen.and_then(|own| own.whiteness.as_ref()).map(|own| own.p_value);
    let all = [test.p_value, seen.and_then(|own| own.nis_p_value), white];
    all.into_iter().flatten().filter(|p| p.is_finite()).fold(2.0, f64::min)
}
