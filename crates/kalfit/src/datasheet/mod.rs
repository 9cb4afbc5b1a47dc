//! The numbers of a datasheet, computed from a fit: noise, random walks, Gauss-Markov pairs, turn-on spread, Allan
//! deviations.
//!
//! Each number is a number of the model in another unit or another form. The interval is the interval of the parameter
//! that the number depends on, transformed in the same way: an interval of σ gives an interval of σ√δ. The interval of
//! a number that depends on several parameters is not known. Unit labels that datasheets use are converted to the units
//! of datasheets; all other labels are unchanged.

mod curve;
mod figure;
mod noise;
mod start;
#[cfg(test)]
mod tests;
mod units;

use crate::datasheet::curve::{CurveRecords, CurveRequest};
use crate::datasheet::figure::Reader;
use crate::datasheet::noise::EntryCollector;
use kalfit_apply::export::ExportError;
use kalfit_apply::export::bind::{Binder, columns_read};
use kalfit_model::PhasedTest;
use kalfit_model::{Alpha, PhasedModel, Population};
use kalfit_record::{CurveRecord, DATASHEET_SCHEMA, DatasheetRecord, FitRecord};

/// The inputs of a datasheet.
#[derive(Debug)]
pub struct Source<'a> {
    /// Origin of the parameters, as named by the user.
    pub name: String,
    /// Results of the fit that the parameters were taken from, if there was one.
    pub record: Option<&'a FitRecord>,
    /// Time between successive values, for use without data.
    pub step: Option<f64>,
    /// Columns that have one value on all rows, as (name, value).
    pub at: &'a [(String, String)],
    /// Tests whose records are compared with the model.
    pub tests: Option<&'a [PhasedTest]>,
}

/// The datasheet of a model at α, for a population.
///
/// # Errors
/// A population that does not fit the model; columns without effect, or with values that are not numbers; a step that
/// is not positive.
pub fn datasheet(
    model: &PhasedModel,
    alpha: &Alpha,
    population: &Population,
    source: &Source<'_>,
) -> Result<DatasheetRecord, ExportError> {
    population.check(model)?;
    check(model, source)?;
    let request = CurveRequest { model, alpha, population, at: source.at };
    let (mut entries, mut allan) = (Vec::new(), Vec::new());
    for (at, phase) in model.phases.iter().enumerate() {
        let own = &phase.model;
        let read = columns_read(own);
        let fixed: Vec<(String, String)> = source.at.iter().filter(|(name, _)| read.contains(name)).cloned().collect();
        let known = source.record.map_or(&[][..], |record| &record.parameters);
        Binder::new((own, alpha), source.step, &fixed)?; // reports bad values of columns before anything is read
        let reader = Reader { model: own, alpha, at: &fixed, known };
        let mut sheet = EntryCollector { phase: &phase.name, reader, entries: Vec::new() };
        let mut usual_step = None;
        for m in 0..own.measurements.len() {
            let records = source.tests.map(|tests| CurveRecords::of((model, at), m, alpha, tests));
            let given = if own.clock.time.is_some() { source.step } else { Some(1.0) };
            let step = records.as_ref().map_or(given, |records| records.step);
            usual_step = usual_step.or(step);
            sheet.measurement(m, step)?;
            allan.push(request.curve(at, m, step, records.as_ref()));
        }
        (0..own.states.len()).try_for_each(|state| sheet.motion(state, usual_step))?;
        entries.append(&mut sheet.entries);
        entries.append(&mut start::entries(model, at, population, source.record));
    }
    Ok(DatasheetRecord {
        schema: DATASHEET_SCHEMA.to_owned(),
        kalfit_version: env!("CARGO_PKG_VERSION").to_owned(),
        title: model.shared().title.clone(),
        from: source.name.clone(),
        at: source.at.iter().map(|(column, value)| format!("{column}={value}")).collect(),
        time_unit: model.shared().clock.unit.clone(),
        entries,
        notes: notes(&allan),
        allan,
    })
}

/// The Allan deviation of each measurement of each phase, of the records of tests and of the model at α for a
/// population; and notes on these curves, in plain words.
///
/// # Errors
/// A population that does not fit the model.
pub fn allan(
    (model, alpha, population): (&PhasedModel, &Alpha, &Population),
    tests: &[PhasedTest],
) -> Result<(Vec<CurveRecord>, Vec<String>), ExportError> {
    population.check(model)?;
    let request = CurveRequest { model, alpha, population, at: &[] };
    let measured = |at: usize| (0..model.phases[at].model.measurements.len()).map(move |m| (at, m));
    let curve = |(at, m): (usize, usize)| {
        let records = CurveRecords::of((model, at), m, alpha, tests);
        request.curve(at, m, records.step, Some(&records))
    };
    let curves: Vec<CurveRecord> = (0..model.phases.len()).flat_map(measured).map(curve).collect();
    let notes = notes(&curves);
    Ok((curves, notes))
}

fn check(model: &PhasedModel, source: &Source<'_>) -> Result<(), ExportError> {
    if let Some(found) = source.step {
        if !(found.is_finite() && found > 0.0) {
            return Err(ExportError::BadStep { found });
        }
        if model.shared().clock.time.is_none() {
            return Err(ExportError::StepWithoutTime { found });
        }
    }
    let mut columns: Vec<String> = Vec::new();
    for column in model.phases.iter().flat_map(|phase| columns_read(&phase.model)) {
        if !columns.contains(&column) {
            columns.push(column);
        }
    }
    match source.at.iter().find(|(name, _)| !columns.contains(name)) {
        Some((column, _)) => Err(ExportError::NoEffect { column: column.clone(), columns }),
        None => Ok(()),
    }
}

fn notes(curves: &[CurveRecord]) -> Vec<String> {
    let mut notes = Vec::new();
    if curves.iter().any(|curve| curve.points.iter().any(|point| point.model.is_some())) {
        notes.push("the curve of the model is that of a new test from its start, with all inputs zero".to_owned());
    }
    let mut zero: Vec<String> = curves.iter().flat_map(|curve| &curve.zero).map(|name| format!("`{name}`")).collect();
    zero.sort();
    zero.dedup();
    let has_records = curves.iter().any(|curve| curve.tests.is_some());
    if !zero.is_empty() {
        notes.push(format!(
            "taken as zero for the curve of the model: {}; `--at COLUMN=VALUE` gives them another value",
            zero.join(", ")
        ));
        if has_records {
            notes.push("the records contain what these columns add through states: where a column varies within a test, the records lie above the curve of the model".to_owned());
        }
    }
    if has_records {
        notes.push("the curve of the records uses measured values minus known inputs, and all pairs of adjacent spans without a gap in all tests; its interval follows from the number of independent spans".to_owned());
    }
    notes
}
