//! Allan deviations of a measurement: computed from the model, and estimated from the records.

use crate::datasheet::noise::measured_unit;
use crate::datasheet::units::ShownUnit;
use kalfit_apply::allan::{Estimate, estimate, median_step, spans, stretches, variance};
use kalfit_apply::export::bind::columns_read;
use kalfit_apply::export::{ExportError, Exported, Wanted, export};
use kalfit_model::Test;
use kalfit_model::{Alpha, Expression, Model, PhasedModel, Population, Scope, Site};
use kalfit_model::{Evidence, PhasedTest};
use kalfit_record::{AllanPoint, CurveRecord};

/// Largest number of values in a span.
const MOST_SPAN_VALUES: usize = 100_000;

/// The records of one measurement.
#[derive(Debug)]
pub(super) struct CurveRecords {
    /// Records of each test, as (time, value).
    pub(super) own: Vec<Vec<(f64, f64)>>,
    /// Usual step of the records; `None` where the records have no regular step.
    pub(super) step: Option<f64>,
}

impl CurveRecords {
    /// The records of a measurement of a phase: measured values minus the part of the equation that has no state.
    pub(super) fn of(
        (model, at): (&PhasedModel, usize),
        m: usize,
        alpha: &Alpha,
        tests: &[PhasedTest],
    ) -> CurveRecords {
        let model = &model.phases[at].model;
        let rows = tests.iter().filter_map(|test| match test.phases.get(at)? {
            Evidence::Rows(rows) => Some(record(model, m, alpha, rows)),
            _ => None,
        });
        let own: Vec<Vec<(f64, f64)>> = rows.collect();
        let step = median_step(&own);
        CurveRecords { own, step }
    }
}

fn record(model: &Model, m: usize, alpha: &Alpha, rows: &Test) -> Vec<(f64, f64)> {
    let measurement = &model.measurements[m];
    let value = |row: usize| {
        let scope = Scope { numbers: rows.numbers(row), texts: rows.texts(row), step: f64::NAN, alpha };
        let found = rows.numbers(row)[measurement.column];
        let read = measurement.filter.as_ref().is_none_or(|filter| filter.evaluate(&scope).is_ok_and(|x| x != 0.0));
        let time = model.clock.time.map_or(row as f64, |column| rows.numbers(row)[column]);
        let known = measurement.equation.constant.evaluate(&scope).ok()?;
        (read && found.is_finite() && time.is_finite()).then_some((time, found - known))
    };
    (0..rows.rows()).filter_map(value).collect()
}

/// The reason why there is no curve, where no step is known.
fn why_no_step(records: Option<&CurveRecords>) -> &'static str {
    match records {
        None => "there is no curve without a step: give data or `--step`",
        Some(records) if records.own.iter().all(Vec::is_empty) => "no curve: the data have no records of it",
        Some(_) => {
            "its records have no regular step: fewer than half of their steps are within 10 % of the median; `--step` in place of data draws the curve of the model alone"
        }
    }
}

/// Model and values that curves are drawn for.
#[derive(Debug)]
pub(super) struct CurveRequest<'a> {
    pub(super) model: &'a PhasedModel,
    pub(super) alpha: &'a Alpha,
    pub(super) population: &'a Population,
    pub(super) at: &'a [(String, String)],
}

impl CurveRequest<'_> {
    /// The curve of measurement `m` of a phase; `step`: time between successive values.
    pub(super) fn curve(
        &self,
        phase: usize,
        m: usize,
        step: Option<f64>,
        records: Option<&CurveRecords>,
    ) -> CurveRecord {
        let own = &self.model.phases[phase];
        let measurement = &own.model.measurements[m];
        let unit = ShownUnit::shown(measured_unit(&own.model, m).as_deref());
        let mut curve = CurveRecord {
            measurement: measurement.name.clone(),
            column: own.model.columns[measurement.column].name.clone(),
            phase: own.name.clone(),
            unit: unit.label.clone(),
            step,
            zero: Vec::new(),
            tests: None,
            points: Vec::new(),
            notes: Vec::new(),
        };
        let Some(length) = step else {
            curve.notes.push(why_no_step(records).to_owned());
            return curve;
        };
        let pieces: Option<Vec<Vec<Vec<f64>>>> =
            records.map(|records| records.own.iter().map(|record| stretches(record, length)).collect());
        let longest = |pieces: &Vec<Vec<Vec<f64>>>| pieces.iter().flatten().map(Vec::len).max().unwrap_or(0);
        let max_span = pieces.as_ref().map_or(MOST_SPAN_VALUES, |pieces| (longest(pieces) / 2).min(MOST_SPAN_VALUES));
        curve.tests = pieces.as_ref().map(|own| own.iter().filter(|test| test.iter().any(|one| one.len() > 1)).count());
        let pieces: Option<Vec<Vec<f64>>> = pieces.map(|pieces| pieces.into_iter().flatten().collect());
        let filter = match self.filter(phase, step, &mut curve.zero) {
            Ok(filter) => Some(filter),
            Err(error) => {
                let hint = error.hint().map_or(String::new(), |hint| format!("; {hint}"));
                curve.notes.push(format!("the model has no curve: {error}{hint}"));
                None
            }
        };
        let place = filter.as_ref().and_then(|filter| filter.measurements.iter().position(|own| *own == m));
        if filter.as_ref().is_some_and(|filter| filter.start.is_none()) {
            curve.notes.push("the model has no curve: its phase inherits its start from the phase before".to_owned());
        }
        for values in spans(max_span) {
            let of_model = filter.as_ref().zip(place).and_then(|(filter, place)| variance(filter, place, values));
            let of_data = pieces.as_ref().and_then(|pieces| estimate(pieces, values));
            let root = |variance: f64| unit.factor * variance.sqrt();
            curve.points.push(AllanPoint {
                time: length * values as f64,
                values,
                model: of_model.map(root),
                data: of_data.map(|own| root(own.variance)),
                interval95: of_data.and_then(|own| own.interval95()).map(|ends| ends.map(|end| Some(root(end)))),
                degrees_of_freedom: of_data.map(|Estimate { degrees_of_freedom, .. }| degrees_of_freedom),
            });
        }
        curve
    }

    /// Constant matrices of a phase. Columns that are only inputs are set to zero, and the names of these columns are
    /// added to `zero`.
    fn filter(&self, phase: usize, step: Option<f64>, zero: &mut Vec<String>) -> Result<Exported, ExportError> {
        let own = &self.model.phases[phase];
        let timed = own.model.clock.time.is_some();
        let read = columns_read(&own.model);
        let mut at: Vec<(String, String)> = self.at.iter().filter(|(name, _)| read.contains(name)).cloned().collect();
        for name in inputs(&own.model) {
            if !at.iter().any(|(other, _)| *other == name) {
                at.push((name.clone(), "0".to_owned()));
                zero.push(name);
            }
        }
        let wanted = Wanted { phase: Some(own.name.clone()), step: step.filter(|_| timed), at };
        export(self.model, self.alpha, self.population, &wanted)
    }
}

/// Names of the numeric columns in equations of measurements, in derivatives without a state and in means, except
/// columns that motion, noise or `where` also depend on.
fn inputs(model: &Model) -> Vec<String> {
    let is_input_site = |site: &Site| {
        matches!(
            site,
            Site::Input(_) | Site::Offset(_) | Site::InitialMean(_) | Site::Coefficient { .. } | Site::Constant(_)
        )
    };
    let all = model
        .expressions()
        .into_iter()
        .filter(|(site, _)| is_input_site(site) || site.is_of_filter() || site.is_variance());
    let (input_sites, other_sites): (Vec<_>, Vec<_>) = all.partition(|(site, _)| is_input_site(site));
    let reads = |all: &[(Site, &Expression)], column: usize| {
        let own = |part: &Expression| matches!(part, Expression::Column(other) if *other == column);
        all.iter().any(|(_, expression)| expression.any(&mut |part| own(part)))
    };
    let regressed = |column: usize| model.mean.regression.iter().any(|regression| regression.column == column);
    let is_input = |&column: &usize| (reads(&input_sites, column) || regressed(column)) && !reads(&other_sites, column);
    (0..model.columns.len()).filter(is_input).map(|column| model.columns[column].name.clone()).collect()
}
