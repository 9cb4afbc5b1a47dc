//! What there is of data: how much each test has, which tests are alike, where there are gaps.

use std::collections::BTreeMap;

use kalfit::FitRecord;
use kalfit::record::TestRecords;
use maud::{PreEscaped, html};
use serde_json::json;

use crate::html::chart::{PageChart, PageCharts};
use crate::html::outlying::MOST_TESTS;
use crate::html::section::PageSection;
use crate::number::plain;
use crate::page::PageLayout;
use crate::summary::{headline, observability};
use crate::table::{ColumnSide, TextColumn};
use crate::words::{clean, count, list};

/// Design classes in the table, the largest first.
const MOST_CLASSES: usize = 20;
/// Tests that are named for a class.
const MOST_NAMES: usize = 4;
/// Bars of a histogram.
const BINS: usize = 30;
/// A pause this many times the usual one is a gap.
const GAP: f64 = 5.0;
/// Gaps that are named.
const MOST_GAPS: usize = 5;

pub(super) fn section(record: &FitRecord, charts: &mut PageCharts) -> Option<PageSection> {
    let page = PageLayout::html();
    let body = html! {
        p { (headline::data(&record.data)) " " (headline::designs(&record.data)) }
        (chart(record, charts).unwrap_or_default())
        (PreEscaped(phases(record, &page)))
        (PreEscaped(classes(record, &page)))
        (PreEscaped(page.section("Gaps in time", &page.items(&gaps(record)))))
    };
    PageSection::new("data", "Data", body)
}

fn chart(record: &FitRecord, charts: &mut PageCharts) -> Option<maud::Markup> {
    let tests = &record.tests;
    let (least, most) = (tests.iter().map(|t| t.observations).min()?, tests.iter().map(|t| t.observations).max()?);
    let alternative = format!("{}, from {least} to {most} observations each.", count(tests.len(), "test"));
    let (names, values, axis, caption) = if tests.len() <= MOST_TESTS {
        let names = tests.iter().map(|t| clean(t.id)).collect();
        let values: Vec<usize> = tests.iter().map(|t| t.observations).collect();
        (names, values, "test", "Tests with few measurements have less weight.")
    } else {
        let (names, values) = histogram(tests, least, most);
        (names, values, "observations of a test", "How many tests have how many measurements.")
    };
    let counted = if axis == "test" { "observations" } else { "tests" };
    let data = json!({ "names": names, "values": values, "axis": axis, "unit": counted });
    Some(charts.figure(PageChart { kind: "bars", title: "Observations", caption, alternative: &alternative, data }))
}

fn histogram(tests: &TestRecords, least: usize, most: usize) -> (Vec<String>, Vec<usize>) {
    let width = (most - least + 1).div_ceil(BINS);
    let bins = (most - least) / width + 1;
    let mut values = vec![0; bins];
    tests.iter().for_each(|test| values[(test.observations - least) / width] += 1);
    let name = |bin: usize| match width {
        1 => (least + bin).to_string(),
        _ => format!("{}–{}", least + bin * width, least + (bin + 1) * width - 1),
    };
    ((0..bins).map(name).collect(), values)
}

/// How many tests have each phase.
fn phases(record: &FitRecord, page: &PageLayout<'_>) -> String {
    if record.phases.len() < 2 {
        return String::new();
    }
    let of_all = |n: Option<usize>| n.map_or_else(String::new, |n| observability::of_all(n, record.data.tests));
    let columns = [
        TextColumn::new("phase", ColumnSide::Left, record.phases.iter().map(|p| p.name.clone()).collect()),
        TextColumn::new("tests", ColumnSide::Right, record.phases.iter().map(|p| of_all(p.tests)).collect()),
        TextColumn::new(
            "estimated states",
            ColumnSide::Left,
            record.phases.iter().map(|p| p.states.join(", ")).collect(),
        ),
    ];
    page.section("Phases", &page.table(&columns))
}

/// Tests that share all that the filter's gains depend on.
fn classes(record: &FitRecord, page: &PageLayout<'_>) -> String {
    let mut classes: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (number, test) in record.tests.iter().enumerate() {
        if let Some(class) = test.design_class {
            classes.entry(class).or_default().push(number);
        }
    }
    let mut classes: Vec<(usize, Vec<usize>)> = classes.into_iter().collect();
    if classes.len() < 2 || classes.len() == record.tests.len() {
        return String::new();
    }
    classes.sort_by_key(|(class, tests)| (usize::MAX - tests.len(), *class));
    let all = classes.len();
    classes.truncate(MOST_CLASSES);
    let column = |of: &dyn Fn(&[usize]) -> String| classes.iter().map(|(_, tests)| of(tests)).collect();
    let test = |number: usize| record.tests.get(number);
    let names = |tests: &[usize]| list(&tests.iter().map(|&t| clean(test(t).id)).collect::<Vec<_>>(), MOST_NAMES);
    let columns = [
        TextColumn::new("class", ColumnSide::Right, classes.iter().map(|(class, _)| class.to_string()).collect()),
        TextColumn::new("tests", ColumnSide::Right, column(&|tests| tests.len().to_string())),
        TextColumn::new(
            "steps each",
            ColumnSide::Right,
            column(&|tests| test(tests[0]).steps.map_or_else(String::new, |n| n.to_string())),
        ),
        TextColumn::new(
            "observations each",
            ColumnSide::Right,
            column(&|tests| test(tests[0]).observations.to_string()),
        ),
        TextColumn::new("which", ColumnSide::Left, column(&names)),
    ];
    let mut body = page.table(&columns);
    let mut said =
        vec!["Tests of one class have the same times, inputs and missing values, and so the same gains.".to_owned()];
    if all > classes.len() {
        said.push(format!("These are the largest {} of {all} classes.", classes.len()));
    }
    body += &page.items(&said);
    page.section("Design classes", &body)
}

/// The longest pauses, where they are much longer than usual.
fn gaps(record: &FitRecord) -> Vec<String> {
    let mut gaps: Vec<(f64, f64, &str)> = Vec::new();
    let mut unit = "time units".to_owned();
    for test in record.tests.iter() {
        let Some(series) = test.innovations.and_then(|i| i.series.as_ref()).filter(|s| s.timed) else {
            continue;
        };
        let mut pauses: Vec<f64> = series.at.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).collect();
        pauses.sort_by(f64::total_cmp);
        if let (Some(&longest), usual) = (pauses.last(), pauses.get(pauses.len() / 2).copied().unwrap_or(0.0))
            && longest > GAP * usual
        {
            gaps.push((longest, usual, test.id));
            unit = series.time_unit.as_deref().map_or(unit, clean);
        }
    }
    gaps.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.2.cmp(b.2)));
    let Some(&(longest, usual, id)) = gaps.first() else { return Vec::new() };
    let others: Vec<String> = gaps[1..].iter().map(|(_, _, id)| clean(id)).collect();
    let others = match others.len() {
        0 => String::new(),
        n => format!(" Pauses of that kind are in {} more: {}.", count(n, "test"), list(&others, MOST_GAPS)),
    };
    let looked = record.tests.iter().filter(|t| t.innovations.is_some_and(|i| i.series.is_some())).count();
    let among =
        if looked < record.tests.len() { format!(" among the {looked} tests looked at") } else { String::new() };
    vec![format!(
        "The longest pause between measurements{among} is {} {unit}, in test {}, where {} is usual.{others}",
        plain(longest, 3),
        clean(id),
        plain(usual, 3)
    )]
}
