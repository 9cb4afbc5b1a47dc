//! Tests that do not look like the others.

use kalfit::FitRecord;
use kalfit::record::{SEARCH_LEVEL, TestRecord};

use crate::figures;
use crate::number::probability;
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};
use crate::words::clean;

const MOST_ROWS: usize = 5;
/// p-values that differ by less, as a part of themselves, are one.
const ROUNDING: f64 = 1e-9;

pub(crate) fn section(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let all = tested(record).count();
    let Some(least) = tested(record).map(|(p, _)| p).min_by(f64::total_cmp) else { return String::new() };
    // of those that rounding alone tells apart the first by name
    let equal = tested(record).filter(|(p, _)| *p <= least * (1.0 + ROUNDING));
    let nearest = equal.map(|(_, test)| test.id).min().expect("one is the least");
    let corrected = |p: f64| (p * all as f64).min(1.0);
    let outliers = outlying(record);
    if outliers.is_empty() {
        let which = if all == 1 { "its p-value".to_owned() } else { format!("the smallest of {all} p-values") };
        let then = match all {
            1 => String::new(),
            _ => format!(", or {} after Bonferroni correction", probability(corrected(least))),
        };
        let sentence =
            format!("No test is an outlier: {which} is {} (test {}){then}.", probability(least), clean(nearest));
        return page.section("Outlying tests", &page.items(&[sentence]));
    }
    let rows = &outliers[..outliers.len().min(page.rows(MOST_ROWS))];
    let tests = || rows.iter().map(|(_, test)| test);
    let columns = [
        TextColumn::new("test", ColumnSide::Left, rows.iter().map(|(_, t)| t.id.to_owned()).collect()),
        figures::column(TestRecord::distance, tests()),
        figures::column(TestRecord::degrees_of_freedom, tests()),
        figures::column(TestRecord::p_value, tests()),
        TextColumn::new(
            &format!("times {all}"),
            ColumnSide::Right,
            rows.iter().map(|&(p, _)| probability(corrected(p))).collect(),
        ),
    ];
    let more = match outliers.len() - rows.len() {
        0 => String::new(),
        n => format!(" (and {n} more)"),
    };
    let are = if outliers.len() == 1 { ("This test", "is an outlier") } else { ("These tests", "are outliers") };
    let sentence = format!(
        "{}{more} {} at the 5 % level, after Bonferroni correction for {all} tests. {}",
        are.0,
        are.1,
        figures::sentences(&[TestRecord::distance])
    );
    page.section("Outlying tests", &(page.table(&columns) + &page.items(&[sentence])))
}

/// Tests with their p-values.
fn tested(record: &FitRecord) -> impl Iterator<Item = (f64, TestRecord<'_>)> {
    record.tests.iter().filter_map(|test| Some((test.p_value.filter(|p| p.is_finite())?, test)))
}

/// Tests that are improbable among all of them, the least probable first.
pub(super) fn outlying(record: &FitRecord) -> Vec<(f64, TestRecord<'_>)> {
    let all = tested(record).count() as f64;
    let mut found: Vec<_> = tested(record).filter(|(p, _)| (p * all).min(1.0) < SEARCH_LEVEL).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.id.cmp(b.1.id)));
    found
}
