//! 95 % intervals, where they are more than standard errors already say.

use kalfit::record::{FitRecord, Interval, PhaseRecord};

use crate::number::Precision;
use crate::page::Page;
use crate::table::{Column, Side};

/// What stands for an end that the data do not set.
const OPEN: &str = "-";

struct Row {
    quantity: String,
    estimate: String,
    ends: [String; 2],
}

pub(crate) fn section(
    record: &FitRecord,
    phase: &PhaseRecord,
    title: &dyn Fn(&str) -> String,
    page: &Page<'_>,
) -> String {
    if record.intervals != "profile" {
        return String::new();
    }
    let rows = rows(phase);
    if rows.is_empty() {
        return String::new();
    }
    let column = |of: &dyn Fn(&Row) -> &String| rows.iter().map(|row| of(row).clone()).collect();
    let columns = [
        Column::new("", Side::Left, column(&|r| &r.quantity)),
        Column::new("estimate", Side::Right, column(&|r| &r.estimate)),
        Column::new("from", Side::Right, column(&|r| &r.ends[0])),
        Column::new("to", Side::Right, column(&|r| &r.ends[1])),
    ];
    let mut body = page.table(&columns);
    if rows.iter().any(|row| row.ends.iter().any(|end| end == OPEN)) {
        body += &page.items(&[format!("{OPEN} no limit was found on this side.")]);
    }
    page.section(&title("95 % intervals by profile likelihood"), &body)
}

fn rows(phase: &PhaseRecord) -> Vec<Row> {
    let names = &phase.states;
    let p = names.len();
    let mut rows = Vec::new();
    let mut add = |quantity: String, estimate: Option<f64>, interval: Interval| {
        if let (Some(estimate), Some(ends)) = (estimate, interval) {
            rows.push(row(quantity, estimate, ends));
        }
    };
    for i in 0..p {
        let interval = phase.mean.interval95.get(i).copied().flatten();
        add(format!("mean of {}", names[i]), phase.mean.estimate.get(i).copied(), interval);
    }
    for r in &phase.mean.regression {
        add(format!("mean of {} per {}", r.state, r.column), Some(r.estimate), r.interval95);
    }
    for i in 0..p {
        let interval = phase.std_dev.interval95.get(i).copied().flatten();
        add(format!("std dev of {}", names[i]), phase.std_dev.estimate.get(i).copied(), interval);
    }
    for i in 0..p {
        for k in 0..i {
            let estimate = phase.correlation.estimate.get(i).and_then(|row| row.get(k)).copied().flatten();
            let interval = phase.correlation.interval95.get(i).and_then(|row| row.get(k)).copied().flatten();
            add(format!("correlation of {}, {}", names[k], names[i]), estimate, interval);
        }
    }
    rows
}

/// Digits as for a standard error of a quarter of the interval.
fn row(quantity: String, estimate: f64, ends: [Option<f64>; 2]) -> Row {
    let width = ends.iter().flatten().map(|end| (end - estimate).abs()).fold(0.0, f64::max);
    let precision = Precision::of(estimate, Some(0.5 * width).filter(|w| *w > 0.0));
    let end = |end: Option<f64>| end.map_or_else(|| OPEN.to_owned(), |x| precision.show(x));
    Row { quantity, estimate: precision.show(estimate), ends: ends.map(end) }
}
