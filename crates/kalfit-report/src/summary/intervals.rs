//! 95 % intervals, where they are more than standard errors already say.

use kalfit::record::{FitRecord, Interval, PhaseRecord, RegressionRecord};

use super::places;
use super::spread::StateSpread;
use crate::number::FigurePrecision;
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};

/// What stands for an end that the data do not set.
const OPEN: &str = "-";

struct IntervalRow {
    quantity: String,
    /// Where it varies, when there is more than one such place.
    place: String,
    estimate: String,
    ends: [String; 2],
}

pub(crate) fn section(
    record: &FitRecord,
    phase: &PhaseRecord,
    title: &dyn Fn(&str) -> String,
    page: &PageLayout<'_>,
) -> String {
    let how = match record.intervals.as_str() {
        "profile" => "95 % intervals by profile likelihood",
        "bootstrap" => "95 % intervals by profile likelihood, with quantiles from drawn ensembles",
        _ => return String::new(),
    };
    let mut rows = of_mean(phase);
    rows.extend(of_spread(phase.into(), places::within(record).trim_start()));
    for (level, place) in places::outer(record) {
        rows.extend(of_spread(level.into(), place.trim_start_matches(" from ")));
    }
    if rows.is_empty() {
        return String::new();
    }
    let column = |of: &dyn Fn(&IntervalRow) -> &String| rows.iter().map(|row| of(row).clone()).collect();
    let columns = [
        TextColumn::new("", ColumnSide::Left, column(&|r| &r.quantity)),
        TextColumn::new("spread", ColumnSide::Left, column(&|r| &r.place)),
        TextColumn::new("estimate", ColumnSide::Right, column(&|r| &r.estimate)),
        TextColumn::new("from", ColumnSide::Right, column(&|r| &r.ends[0])),
        TextColumn::new("to", ColumnSide::Right, column(&|r| &r.ends[1])),
    ];
    let mut body = page.table(&columns);
    if rows.iter().any(|row| row.ends.iter().any(|end| end == OPEN)) {
        body += &page.items(&[format!("{OPEN} no limit was found on this side.")]);
    }
    page.section(&title(how), &body)
}

fn of_mean(phase: &PhaseRecord) -> Vec<IntervalRow> {
    let of_state = |(i, name): (usize, &String)| {
        let interval = phase.mean.interval95.get(i).copied().flatten();
        row(format!("mean of {name}"), phase.mean.estimate.get(i).copied(), interval)
    };
    let of_column =
        |r: &RegressionRecord| row(format!("mean of {} per {}", r.state, r.column), Some(r.estimate), r.interval95);
    let states = phase.states.iter().enumerate().filter_map(of_state);
    states.chain(phase.mean.regression.iter().filter_map(of_column)).collect()
}

/// `place` says in words where they vary so, when there is more than one such place.
fn of_spread(spread: StateSpread<'_>, place: &str) -> Vec<IntervalRow> {
    let names = spread.states;
    let std_dev = |i: usize| {
        let interval = spread.std_dev.interval95.get(i).copied().flatten();
        row(format!("std dev of {}", names[i]), spread.std_dev.estimate.get(i).copied(), interval)
    };
    let correlation = |(i, k): (usize, usize)| {
        let estimate = spread.correlation.estimate.get(i).and_then(|row| row.get(k)).copied().flatten();
        let interval = spread.correlation.interval95.get(i).and_then(|row| row.get(k)).copied().flatten();
        row(format!("correlation of {}, {}", names[k], names[i]), estimate, interval)
    };
    let pairs = (0..names.len()).flat_map(|i| (0..i).map(move |k| (i, k)));
    let rows = (0..names.len()).filter_map(std_dev).chain(pairs.filter_map(correlation));
    rows.map(|row| IntervalRow { place: place.to_owned(), ..row }).collect()
}

/// Digits as for a standard error of a quarter of the interval; nothing without an interval.
fn row(quantity: String, estimate: Option<f64>, interval: Interval) -> Option<IntervalRow> {
    let (estimate, ends) = (estimate?, interval?);
    let width = ends.iter().flatten().map(|end| (end - estimate).abs()).fold(0.0, f64::max);
    let precision = FigurePrecision::of(estimate, Some(0.5 * width).filter(|w| *w > 0.0));
    let end = |end: Option<f64>| end.map_or_else(|| OPEN.to_owned(), |x| precision.show(x));
    Some(IntervalRow { quantity, place: String::new(), estimate: precision.show(estimate), ends: ends.map(end) })
}
