//! Single measurements that contradict all others of their test, by auxiliary residuals (de Jong and Penzer 1998).
//!
//! ```text
//! u = V⁻¹r,   t_i = u_i / √(V⁻¹)_ii ~ N(0, 1),   t_i² / ((r'V⁻¹r - t_i²) / (n - q - 1)) ~ F(1, n - q - 1)
//! ```
//!
//! t_i is the score test of a change of measurement i alone: unlike an innovation it uses what comes later, so that a
//! wrong first value is not taken for wrong later ones. L⁻¹ of the change of a measurement is the change of the
//! innovations; only tests with a large innovation are looked at.

use kalfit_filter::innovations::{Change, Innovation, InnovationFilter};
use kalfit_model::{Evidence, PhasedModel, PhasedTest, Source, TestId};
use rayon::prelude::*;

use crate::misfit::columns::UnitColumns;
use crate::misfit::score::FTest;
use crate::misfit::{most_states, row_passes};

/// Most tests that are looked at.
const MAX_TESTS: usize = 20;
/// Standardised innovation from which a test is looked at: one in 500 innovations of a right model is as large.
const LARGE: f64 = 3.0;
/// Most measurements before and after a large innovation that are looked at.
const MAX_DISTANCE: usize = 100;

/// A measurement that contradicts the others of its test.
#[derive(Debug, Clone, PartialEq)]
pub struct WrongRow {
    /// Id of the test.
    pub test: TestId,
    /// Index of the phase.
    pub phase: usize,
    /// Index of the measurement in the model of the phase.
    pub measurement: usize,
    /// File and row of the measurement.
    pub source: Source,
    /// Time of the step, where the model has times.
    pub time: Option<f64>,
    /// How far the value is from what all other measurements of the test say, in the unit of the measurement.
    pub deviation: f64,
    /// Standard deviation of `deviation` when the model is right.
    pub std_dev: f64,
    /// Two-sided p-value, as if this measurement alone were looked at.
    pub p_value: f64,
}

/// Tests with large innovations.
#[derive(Debug, Default)]
pub(super) struct LargeInnovations(Vec<(f64, TestId, usize)>);

impl LargeInnovations {
    /// Takes the tests of a unit, after effects of levels are taken out.
    pub(super) fn add(&mut self, unit: &UnitColumns) {
        for (id, rows) in &unit.tests {
            let of = |row: usize| (unit.values[(row, 0)].abs(), row - rows.start);
            let largest = rows.clone().map(of).max_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((size, row)) = largest.filter(|(size, _)| *size > LARGE) {
                self.0.push((size, id.clone(), row));
            }
        }
    }

    /// The measurement of each of these tests that contradicts the others most. `whole`: the square of all innovations and
    /// its degrees of freedom.
    pub(super) fn wrong(
        mut self,
        filter: &InnovationFilter,
        (model, tests): (&PhasedModel, &[PhasedTest]),
        whole: (f64, usize),
    ) -> Vec<WrongRow> {
        self.0.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.1.to_string().cmp(&b.1.to_string())));
        self.0.truncate(MAX_TESTS);
        let test = |id: &TestId| tests.iter().find(|test| test.id == *id);
        let most = row_passes(most_states(model)) / self.0.len().max(1);
        let of_test = |(_, id, row): &(f64, TestId, usize)| most_wrong(filter, (model, test(id)?), (*row, most), whole);
        self.0.par_iter().filter_map(of_test).collect()
    }
}

/// `near`: number of a large innovation; `most`: rows that the filter passes at most; `whole`: the square of all
/// innovations and its degrees of freedom, by which the deviation is studentised, as a wrong value makes estimated noise
/// levels large.
fn most_wrong(
    filter: &InnovationFilter,
    (model, test): (&PhasedModel, &PhasedTest),
    (near, most): (usize, usize),
    (square, all): (f64, usize),
) -> Option<WrongRow> {
    let base = filter.series(std::slice::from_ref(test)).pop()?.ok()??;
    // in a long record fewer: each takes a pass of the filter over the whole record
    let distance = (most / (2 * base.len().max(1))).clamp(1, MAX_DISTANCE);
    let looked: Vec<usize> = (near.saturating_sub(distance)..(near + distance + 1).min(base.len())).collect();
    let size = |at: usize| base[at].variance.sqrt();
    let rows_of = rows_of(&base, model, test)?;
    let change = |at: &usize| {
        let (place, changed, size) = (&base[*at], rows_of[*at], size(*at));
        let value = move |row: usize, value: f64| if row == changed { value + size } else { value };
        Change { phase: place.phase, measurement: place.measurement, value: Box::new(value) }
    };
    let scored = |(other, at): (Vec<f64>, usize)| {
        let changes = other.iter().zip(&base);
        let (score, information) = changes.fold((0.0, 0.0), |(score, information), (other, base)| {
            let change = other - base.standardised;
            (score + change * base.standardised, information + change * change)
        });
        let statistic = score / f64::sqrt(information);
        statistic.is_finite().then_some((statistic, information, at))
    };
    let changes: Vec<Change<'_>> = looked.iter().map(change).collect();
    let of_all = |other: &Vec<f64>| other.len() == base.len();
    let run = filter.changed(test, &changes).into_iter().zip(looked);
    let found = run.filter_map(|(other, at)| Some((other.filter(of_all)?, at))).filter_map(scored);
    let (statistic, information, at) = found.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))?;
    let place = &base[at];
    let Evidence::Rows(rows) = &test.phases[place.phase] else { return None };
    let std_dev = size(at) / information.sqrt();
    Some(WrongRow {
        test: test.id.clone(),
        phase: place.phase,
        measurement: place.measurement,
        source: rows.source(rows_of[at]),
        time: place.time,
        deviation: statistic * std_dev,
        std_dev,
        p_value: FTest::of(statistic * statistic, 1, square, all)?.p_value(),
    })
}

/// Row of each innovation in its phase; `None` where not every measured value has an innovation.
fn rows_of(series: &[Innovation], model: &PhasedModel, test: &PhasedTest) -> Option<Vec<usize>> {
    let mut rows_of = vec![0; series.len()];
    for (number, (phase, evidence)) in model.phases.iter().zip(&*test.phases).enumerate() {
        let Evidence::Rows(rows) = evidence else { continue };
        for (measurement, meter) in phase.model.measurements.iter().enumerate() {
            let own = |at: &usize| (series[*at].phase, series[*at].measurement) == (number, measurement);
            let places: Vec<usize> = (0..series.len()).filter(own).collect();
            let measured: Vec<usize> =
                (0..rows.rows()).filter(|&row| !rows.numbers(row)[meter.column].is_nan()).collect();
            if places.len() != measured.len() {
                return None;
            }
            places.into_iter().zip(measured).for_each(|(at, row)| rows_of[at] = row);
        }
    }
    Some(rows_of)
}
