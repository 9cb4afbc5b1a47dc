//! A test along its record: measured and predicted values, innovations.

use kalfit::record::{AlongRecord, MeasurementAlong, TestAlong};

use crate::plot::axis::PlotAxis;
use crate::plot::canvas::{BLUE, FAINT, INK, ORANGE, PlotCanvas, SMALL, TextAnchor, WORDS, cut};
use crate::plot::error::PlotError;
use crate::plot::picture::DrawablePlot;
use crate::words::{clean, list};

/// Measurements that are drawn.
const MOST: usize = 6;
/// Tests that are named.
const MOST_NAMES: usize = 20;
/// Heights of the values, of the innovations and of the quantiles of a measurement, and of what stands around each.
const VALUES: f64 = 170.0;
const INNOVATIONS: f64 = 90.0;
const QUANTILES: f64 = 260.0;
const AROUND: f64 = 50.0;
/// Half of the interval that holds 95 % of a standard normal number.
const LIMIT: f64 = 1.96;
const LEFT: f64 = 66.0;

/// What is drawn of each measurement of a test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RecordPanels {
    /// Values with predictions, and innovations.
    Values,
    /// Innovations alone.
    Innovations,
    /// Innovations against the quantiles of the normal law.
    Quantiles,
}

impl RecordPanels {
    /// Height of what is drawn of a measurement.
    fn height(self) -> f64 {
        match self {
            RecordPanels::Values => VALUES + INNOVATIONS + 2.0 * AROUND,
            RecordPanels::Innovations => INNOVATIONS + 2.0 * AROUND,
            RecordPanels::Quantiles => QUANTILES + 2.0 * AROUND,
        }
    }
}

pub(super) struct RecordPlot<'a> {
    panels: RecordPanels,
    test: &'a TestAlong,
    unit: Option<String>,
    of: usize,
}

impl<'a> RecordPlot<'a> {
    /// Of this test, by default the least probable.
    pub(super) fn of(
        along: Option<&'a AlongRecord>,
        test: Option<&str>,
        panels: RecordPanels,
    ) -> Result<RecordPlot<'a>, PlotError> {
        let Some(along) = along else {
            return Err(PlotError::Nothing("records over time need a model with `time`, and the data".to_owned()));
        };
        let found = match test {
            None => along.tests.first(),
            Some(id) => along.tests.iter().find(|one| one.id == id),
        };
        match (found, test) {
            (Some(test), _) => {
                Ok(RecordPlot { panels, test, unit: along.time_unit.as_deref().map(clean), of: along.of })
            }
            (None, Some(id)) if !along.tests.is_empty() => Err(PlotError::NoTest {
                test: clean(id),
                known: list(&along.tests.iter().map(|one| clean(&one.id)).collect::<Vec<_>>(), MOST_NAMES),
            }),
            (None, _) => Err(PlotError::Nothing(
                along.notes.first().map_or("there are no records".to_owned(), |note| clean(note)),
            )),
        }
    }

    fn measurements(&self) -> Vec<(String, &'a MeasurementAlong)> {
        let several = self.test.phases.len() > 1;
        let name = |phase: &str, own: &MeasurementAlong| match several {
            true => format!("{}: {}", clean(phase), clean(&own.name)),
            false => clean(&own.name),
        };
        let phases = self.test.phases.iter();
        let all = phases.flat_map(|phase| phase.measurements.iter().map(|own| (name(&phase.name, own), own)));
        all.take(MOST).collect()
    }
}

impl DrawablePlot for RecordPlot<'_> {
    fn caption(&self) -> String {
        let what = match self.panels {
            RecordPanels::Values => "measured values, predictions ± 2 standard deviations, innovations",
            RecordPanels::Innovations => "innovations over their standard deviations",
            RecordPanels::Quantiles => "innovations against the quantiles of the normal law",
        };
        format!("Test {} of {}: {what}", clean(&self.test.id), self.of)
    }

    fn height(&self, _: f64) -> f64 {
        self.measurements().len() as f64 * self.panels.height() + 10.0
    }

    fn draw(&self, on: &mut PlotCanvas<'_>) {
        let time = self.unit.as_ref().map_or("time".to_owned(), |unit| format!("time [{unit}]"));
        for (k, (name, own)) in self.measurements().into_iter().enumerate() {
            let on = &mut on.below(k as f64 * self.panels.height());
            match self.panels {
                RecordPanels::Values => {
                    values(own, &name, on);
                    innovations(own, "innovations / standard deviation", &time, &mut on.below(VALUES + AROUND));
                }
                RecordPanels::Innovations => innovations(own, &name, &time, on),
                RecordPanels::Quantiles => quantiles(own, &name, on),
            }
        }
    }
}

/// Where the panel is, with its axis of time.
fn times(own: &MeasurementAlong, on: &PlotCanvas<'_>) -> PlotAxis {
    PlotAxis::over(own.at.iter().chain(&own.innovations_at).copied(), LEFT, on.width - 18.0)
}

fn values(own: &MeasurementAlong, name: &str, on: &mut PlotCanvas<'_>) {
    let (x, right) = (times(own, on), on.width - 18.0);
    let (top, bottom) = (24.0, 24.0 + VALUES);
    let rows = own.at.len().min(own.measured.len()).min(own.predicted.len()).min(own.std_dev.len());
    // the band of the first steps, before anything is known, would leave nothing else to see
    let y = PlotAxis::over(own.measured.iter().copied(), bottom, top);
    let band = |sign: f64| (0..rows).map(move |i| (i, own.predicted[i] + sign * 2.0 * own.std_dev[i]));
    let point = |(i, value): (usize, f64)| [x.at(own.at[i]), y.at(value)];
    on.text([12.0, 10.0], &cut(name, on.width - 24.0, WORDS), WORDS, TextAnchor::Left, INK);
    x.below(on, top, bottom);
    y.beside(on, LEFT, right);
    if rows > 1 {
        let edge: Vec<[f64; 2]> = band(1.0).map(point).chain(band(-1.0).rev().map(point)).collect();
        on.area(&edge, BLUE);
        on.line(&(0..rows).map(|i| point((i, own.predicted[i]))).collect::<Vec<_>>(), BLUE, 1.2);
    }
    for i in 0..rows {
        on.dot(point((i, own.measured[i])), 1.8, INK, true);
    }
}

fn innovations(own: &MeasurementAlong, name: &str, time: &str, on: &mut PlotCanvas<'_>) {
    let (x, right) = (times(own, on), on.width - 18.0);
    let (top, bottom) = (24.0, 24.0 + INNOVATIONS);
    let y = PlotAxis::over(own.standardised.iter().copied().chain([-LIMIT, LIMIT]), bottom, top);
    on.text([12.0, 10.0], &cut(name, on.width - 24.0, WORDS), WORDS, TextAnchor::Left, INK);
    x.below(on, top, bottom);
    y.beside(on, LEFT, right);
    for limit in [-LIMIT, LIMIT] {
        on.dashed([LEFT, y.at(limit)], [right, y.at(limit)], FAINT);
    }
    for (at, value) in own.innovations_at.iter().zip(&own.standardised) {
        on.dot([x.at(*at), y.at(*value)], 1.8, if value.abs() > 3.0 { ORANGE } else { BLUE }, true);
    }
    on.text([right, bottom + 23.0], time, SMALL, TextAnchor::Right, FAINT);
}

fn quantiles(own: &MeasurementAlong, name: &str, on: &mut PlotCanvas<'_>) {
    let (top, bottom) = (24.0, 24.0 + QUANTILES);
    let right = (LEFT + 1.4 * QUANTILES).min(on.width - 18.0);
    let both = || own.quantiles.iter().flatten().copied();
    let (x, y) = (PlotAxis::over(both(), LEFT, right), PlotAxis::over(both(), bottom, top));
    on.text([12.0, 10.0], &cut(name, on.width - 24.0, WORDS), WORDS, TextAnchor::Left, INK);
    x.below(on, top, bottom);
    y.beside(on, LEFT, right);
    let ends = both().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| [low.min(at), high.max(at)]);
    if ends[0] < ends[1] {
        on.dashed([x.at(ends[0]), y.at(ends[0])], [x.at(ends[1]), y.at(ends[1])], FAINT);
    }
    for [quantile, value] in &own.quantiles {
        on.dot([x.at(*quantile), y.at(*value)], 1.8, if value.abs() > 3.0 { ORANGE } else { BLUE }, true);
    }
    on.text([right, bottom + 23.0], "quantile of the normal law", SMALL, TextAnchor::Right, FAINT);
}
