//! Dynamic parameters.

use kalfit::FitRecord;
use kalfit::record::ParameterRecord;

use super::states::{Cells, cells};
use crate::number::Precision;
use crate::page::Page;
use crate::table::{Column, Side, table};

/// A parameter with a value per test can have thousands of rows.
const MOST_ROWS: usize = 30;

pub(super) fn section(record: &FitRecord, page: &Page<'_>) -> String {
    if record.parameters.is_empty() {
        return String::new();
    }
    let rows = &record.parameters[..record.parameters.len().min(MOST_ROWS)];
    let (values, errors): (Vec<_>, Vec<_>) = rows.iter().map(value).unzip();
    let columns = [
        Column::new("parameter", Side::Left, rows.iter().map(|r| r.name.clone()).collect()),
        Column::new("for", Side::Left, rows.iter().map(level).collect()),
        Column::new("unit", Side::Left, rows.iter().map(|r| r.unit.clone().unwrap_or_default()).collect()),
        Column::new("value", Side::Right, values),
        Column::new("", Side::Left, errors),
        Column::new("95 % interval", Side::Left, rows.iter().map(interval).collect()),
    ];
    let mut body = table(&columns, page.width());
    if record.parameters.len() > rows.len() {
        body += &page.items(&[format!("… and {} more.", record.parameters.len() - rows.len())]);
    }
    page.section("Parameters (± standard error)", &body)
}

fn value(row: &ParameterRecord) -> Cells {
    let (value, error) = cells(row.estimate, row.std_error, row.fixed, &|| None);
    match (row.at_bound && !row.fixed, row.std_error) {
        (true, None) => (value, "at its bound".to_owned()),
        (true, Some(_)) => (value, format!("{error}, at its bound")),
        (false, _) => (value, error),
    }
}

fn level(row: &ParameterRecord) -> String {
    match (&row.per, &row.level) {
        (Some(column), Some(level)) => format!("{column} {level}"),
        (Some(column), None) => format!("other {column}"),
        (None, _) => String::new(),
    }
}

fn interval(row: &ParameterRecord) -> String {
    let Some([low, high]) = row.interval95.filter(|_| !row.fixed) else { return String::new() };
    let precision = Precision::of(row.estimate, row.std_error);
    format!("{} to {}", precision.show(low), precision.show(high))
}
