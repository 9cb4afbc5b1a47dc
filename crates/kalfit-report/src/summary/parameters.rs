//! Dynamic parameters.

use kalfit::FitRecord;
use kalfit::record::ParameterRecord;

use super::states::{FigureCells, cells, std_error};
use crate::number::{DIGITS, FigurePrecision, plain};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count};

/// Rows of the table; a model can have very many parameters.
const MOST_ROWS: usize = 40;
/// A parameter with more levels than this shows the first ones and the extremes.
const MOST_LEVELS: usize = 12;
const FIRST_LEVELS: usize = 6;
/// Digits of the end of an interval that no standard error stands behind.
const END_DIGITS: usize = 3;

pub(crate) fn section(record: &FitRecord, page: &PageLayout<'_>) -> String {
    if record.parameters.is_empty() {
        return String::new();
    }
    let mut rows: Vec<&ParameterRecord> = Vec::new();
    let mut remarks = Vec::new();
    for of_one in record.parameters.chunk_by(|a, b| a.name == b.name) {
        if of_one.len() <= page.rows(MOST_LEVELS) {
            rows.extend(of_one);
        } else {
            let chosen = first_and_extremes(of_one);
            remarks.push(others(of_one, chosen.len()));
            rows.extend(chosen);
        }
    }
    if rows.len() > page.rows(MOST_ROWS) {
        remarks.push(format!("… and {} more rows; all are in the results file.", rows.len() - page.rows(MOST_ROWS)));
        rows.truncate(page.rows(MOST_ROWS));
    }
    let (values, errors): (Vec<_>, Vec<_>) = rows.iter().map(|row| value(row)).unzip();
    let columns = [
        TextColumn::new("parameter", ColumnSide::Left, rows.iter().map(|r| r.name.clone()).collect()),
        TextColumn::new("for", ColumnSide::Left, rows.iter().map(|r| level(r)).collect()),
        TextColumn::new("unit", ColumnSide::Left, rows.iter().map(|r| r.unit.clone().unwrap_or_default()).collect()),
        TextColumn::new("value", ColumnSide::Right, values),
        TextColumn::new("", ColumnSide::Left, errors),
        TextColumn::new("95 % interval", ColumnSide::Left, rows.iter().map(|r| interval(r)).collect()),
    ];
    let body = page.table(&columns) + &page.items(&remarks);
    page.section(&format!("Dynamic parameters (± {})", std_error(&record.std_errors)), &body)
}

/// The first levels, then the smallest and the largest value.
fn first_and_extremes(levels: &[ParameterRecord]) -> Vec<&ParameterRecord> {
    let order = |a: &&ParameterRecord, b: &&ParameterRecord| a.estimate.total_cmp(&b.estimate);
    let extremes = [levels.iter().min_by(order), levels.iter().max_by(order)];
    let mut chosen: Vec<&ParameterRecord> = levels[..FIRST_LEVELS].iter().collect();
    for extreme in extremes.into_iter().flatten() {
        if !chosen.iter().any(|shown| std::ptr::eq(*shown, extreme)) {
            chosen.push(extreme);
        }
    }
    chosen
}

fn others(levels: &[ParameterRecord], shown: usize) -> String {
    let mut values: Vec<f64> = levels.iter().map(|level| level.estimate).collect();
    values.sort_by(f64::total_cmp);
    let fixed = levels.iter().filter(|level| level.fixed).count();
    let fixed = if fixed > 0 { format!(", {fixed} of them fixed") } else { String::new() };
    format!(
        "{} has {}{fixed}. The table shows the first {FIRST_LEVELS}, the smallest and the largest; {} more are in the \
         results file. The median of all is {}.",
        clean(&levels[0].name),
        count(levels.len(), "level"),
        levels.len() - shown,
        plain(values[values.len() / 2], DIGITS)
    )
}

fn value(row: &ParameterRecord) -> FigureCells {
    let why = match row.standing.as_deref() {
        Some("lower") if row.estimate == 0.0 => "at zero",
        Some("lower") if row.note.as_deref().is_some_and(|note| note.starts_with("practically zero")) => {
            "practically zero"
        }
        Some("lower") => "at its lower bound",
        Some("upper") => "at its upper bound",
        Some("unbounded") => "no upper limit found",
        Some("edge") => "at the edge",
        Some("without_effect") => "without effect",
        Some("unidentified") => "not identified",
        _ if row.at_bound => "at its bound",
        _ => return cells(row.estimate, row.std_error, row.fixed, &|| None),
    };
    let (value, error) = cells(row.estimate, row.std_error, row.fixed, &|| Some(why));
    match row.std_error {
        Some(_) if !row.fixed => (value, format!("{error}, {why}")),
        _ => (value, error),
    }
}

pub(crate) fn level(row: &ParameterRecord) -> String {
    match (&row.per, &row.level) {
        (Some(column), Some(level)) => format!("{column} {level}"),
        (Some(column), None) => format!("other {column}"),
        (None, _) => String::new(),
    }
}

fn interval(row: &ParameterRecord) -> String {
    row.interval95
        .filter(|_| !row.fixed)
        .map_or_else(String::new, |ends| ends_in_words(row.estimate, row.std_error, ends))
}

/// `1.2 to 3.4`, or the one end that is known.
pub(crate) fn ends_in_words(estimate: f64, std_error: Option<f64>, ends: [Option<f64>; 2]) -> String {
    // without a standard error each end stands for itself
    let precision = match std_error {
        Some(error) => FigurePrecision::of(estimate, Some(error)),
        None => FigurePrecision::Significant(END_DIGITS),
    };
    match ends {
        [Some(low), Some(high)] => format!("{} to {}", precision.show(low), precision.show(high)),
        [Some(low), None] => format!("from {}", precision.show(low)),
        [None, Some(high)] => format!("to {}", precision.show(high)),
        [None, None] => String::new(),
    }
}

/// Several methods side by side.
pub(crate) fn methods(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let methods = &record.methods;
    if methods.is_empty() {
        return String::new();
    }
    let column = |of: &dyn Fn(&kalfit::record::MethodRecord) -> String| methods.iter().map(of).collect();
    let work = [
        TextColumn::new("method", ColumnSide::Left, column(&|m| m.method.clone())),
        TextColumn::new(
            "log-lik.",
            ColumnSide::Right,
            column(&|m| FigurePrecision::Decimals(6).show(m.log_likelihood)),
        ),
        TextColumn::new("converged", ColumnSide::Left, column(&|m| if m.converged { "yes" } else { "no" }.to_owned())),
        TextColumn::new("iter.", ColumnSide::Right, column(&|m| m.iterations.to_string())),
        TextColumn::new("filter runs", ColumnSide::Right, column(&|m| m.filter_passes.to_string())),
        TextColumn::new("backward", ColumnSide::Right, column(&|m| m.score_passes.to_string())),
        TextColumn::new("time", ColumnSide::Right, column(&|m| crate::number::seconds(m.seconds))),
    ];
    let free: Vec<&ParameterRecord> = record.parameters.iter().filter(|p| !p.fixed).collect();
    let shown = free.len().min(MOST_LEVELS);
    let name = |p: &ParameterRecord| format!("{} {}", p.name, level(p)).trim_end().to_owned();
    let mut columns =
        vec![TextColumn::new("parameter", ColumnSide::Left, free[..shown].iter().map(|p| name(p)).collect())];
    for method in methods {
        let cell = |i: usize| method.values.get(i).map_or(String::new(), |x| plain(*x, 7));
        columns.push(TextColumn::new(&method.method, ColumnSide::Right, (0..shown).map(cell).collect()));
    }
    let mut body = page.table(&work) + "\n" + &page.table(&columns);
    let mut remarks: Vec<String> = methods
        .iter()
        .filter(|m| !m.converged)
        .map(|m| format!("{} did not converge: {}.", clean(&m.method), clean(&m.reason)))
        .collect();
    if free.len() > shown {
        remarks.push(format!("… and {} more free values.", free.len() - shown));
    }
    body += &page.items(&remarks);
    page.section("Methods side by side", &body)
}
