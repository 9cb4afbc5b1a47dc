//! Misfit that tests have in common, tests unlike those of their groups, and single rows that contradict the others.

use kalfit::FitRecord;
use kalfit::record::{MisfitRecord, MisfitTermRecord, SEARCH_LEVEL, WrongRowRecord};

use crate::figures;
use crate::number::{p_value, plain, probability};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::clean;

const MOST_ROWS: usize = 8;

pub(crate) fn section(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let Some(misfit) = &record.misfit else { return String::new() };
    let parts = [terms(record, misfit, page), wrong_rows(misfit, page), unlike(misfit, page)];
    if parts.iter().all(String::is_empty) {
        return String::new();
    }
    page.section("Misfit that tests have in common, and single rows", &parts.concat())
}

/// Terms that the model lacks.
fn terms(record: &FitRecord, misfit: &MisfitRecord, page: &PageLayout<'_>) -> String {
    let all = misfit.terms.len() + usize::from(misfit.normality.is_some());
    let is_found = |p: f64| p * all as f64 <= SEARCH_LEVEL;
    let found: Vec<&MisfitTermRecord> = misfit.terms.iter().filter(|term| is_found(term.p_value)).collect();
    let mut lines = Vec::new();
    match &misfit.normality {
        Some(normality) if is_found(normality.p_value) => lines.push(format!(
            "The innovations are not normal (Shapiro-Francia {}): intervals of levels and Σ are then too short or too long.",
            p_value(normality.p_value)
        )),
        _ => {}
    }
    if found.is_empty() {
        return if lines.is_empty() { String::new() } else { page.items(&lines) };
    }
    let rows = &found[..found.len().min(page.rows(MOST_ROWS))];
    let cells = |of: &dyn Fn(&MisfitTermRecord) -> String| rows.iter().map(|term| of(term)).collect();
    let step = if record.has_times() { "time" } else { "step" };
    let columns = [
        TextColumn::new("measurement", ColumnSide::Left, cells(&|term| clean(&term.measurement))),
        TextColumn::new("missing term", ColumnSide::Left, cells(&|term| clean(&term.words()))),
        TextColumn::new("largest at", ColumnSide::Left, cells(&|term| place(term, step))),
        TextColumn::new("deviation", ColumnSide::Right, cells(&deviation)),
        TextColumn::new("p-value", ColumnSide::Right, cells(&|term| probability(term.p_value))),
    ];
    lines.push(if record.has_correlated_innovations() {
        format!(
            "The innovations of single tests are correlated {} too. Unless tests share that, these p-values are too small: add \
             the process that is missing, then look again.",
            record.correlates()
        )
    } else {
        "All tests deviate from the model in the same way there: values that are clipped, a response that bends, a lag, or a \
         drift that tests share."
            .to_owned()
    });
    page.table(&columns) + &page.items(&lines)
}

/// `step`: what steps are known by.
fn place(term: &MisfitTermRecord, step: &str) -> String {
    match (term.at, &term.column) {
        (Some([from, to]), column) => {
            let name =
                column.as_deref().map_or_else(|| if term.term == "record" { "row" } else { step }.to_owned(), clean);
            match from.to_bits() == to.to_bits() {
                true => format!("{name} = {}", plain(from, 4)),
                false => format!("{name} {} to {}", plain(from, 4), plain(to, 4)),
            }
        }
        (None, _) => "-".to_owned(),
    }
}

fn deviation(term: &MisfitTermRecord) -> String {
    match (term.deviation, term.std_dev) {
        (Some(deviation), Some(std_dev)) => format!("{} ± {}", plain(deviation, 3), plain(std_dev, 2)),
        _ => "-".to_owned(),
    }
}

/// Rows that contradict the other rows of their test.
fn wrong_rows(misfit: &MisfitRecord, page: &PageLayout<'_>) -> String {
    let found: Vec<&WrongRowRecord> =
        misfit.wrong_rows.iter().filter(|row| row.adjusted_p_value < SEARCH_LEVEL).collect();
    if found.is_empty() {
        return String::new();
    }
    let rows = &found[..found.len().min(page.rows(MOST_ROWS))];
    let cells = |of: &dyn Fn(&WrongRowRecord) -> String| rows.iter().map(|row| of(row)).collect();
    let timed = rows.iter().any(|row| row.time.is_some());
    let time = |row: &WrongRowRecord| row.time.map_or_else(|| "-".to_owned(), |t| plain(t, 6));
    let columns = [
        Some(TextColumn::new("test", ColumnSide::Left, cells(&|row| clean(&row.test)))),
        Some(figures::column(WrongRowRecord::row, rows.iter().copied())),
        timed.then(|| TextColumn::new("time", ColumnSide::Right, cells(&time))),
        Some(TextColumn::new("measurement", ColumnSide::Left, cells(&|row| clean(&row.measurement)))),
        Some(TextColumn::new(
            "deviation",
            ColumnSide::Right,
            cells(&|row| format!("{} ± {}", plain(row.deviation, 3), plain(row.std_dev, 2))),
        )),
        Some(figures::column(WrongRowRecord::adjusted_p_value, rows.iter().copied())),
    ];
    let columns: Vec<TextColumn> = columns.into_iter().flatten().collect();
    let line =
        "Each of these values contradicts all other values of its test; at most one of a test is listed.".to_owned();
    page.table(&columns) + &page.items(&[line])
}

/// Tests that are unlike the other tests of their groups.
fn unlike(misfit: &MisfitRecord, page: &PageLayout<'_>) -> String {
    let found = misfit.unlike.iter().filter(|one| one.adjusted_p_value < SEARCH_LEVEL);
    let line = |one: &kalfit::record::UnlikeRecord| {
        format!(
            "Test {} is unlike the other tests of its groups: {} deviates by {} standard deviations ({} among all tests).",
            clean(&one.test),
            clean(&one.state),
            plain(one.deviation, 3),
            p_value(one.adjusted_p_value)
        )
    };
    let lines: Vec<String> = found.take(page.rows(MOST_ROWS)).map(line).collect();
    if lines.is_empty() { String::new() } else { page.items(&lines) }
}
