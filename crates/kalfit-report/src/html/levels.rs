//! Tests in groups: the spread by level, and a forest of the groups with their tests.

use kalfit::FitRecord;
use kalfit::record::{SquareRecord, TestRecord, UnitRecord};
use maud::{Markup, PreEscaped, html};

use crate::html::chart::Charts;
use crate::html::forest::{self, Group, Row};
use crate::html::section::Section;
use crate::number::plain;
use crate::page::Page;
use crate::summary::levels;
use crate::words::clean;

/// Standard deviations to each side of a posterior mean that hold 95 %.
const SIDES: f64 = 1.96;
/// States of which there is a forest.
const MOST_STATES: usize = 4;

pub(super) fn section(record: &FitRecord, charts: &mut Charts) -> Option<Section> {
    if record.levels.is_empty() {
        return None;
    }
    let table = levels::section(record, &Page::html());
    let forests: Vec<Markup> =
        (0..record.levels[0].states.len().min(MOST_STATES)).filter_map(|i| units(record, i, charts)).collect();
    Section::new("levels", "Levels", html! { (PreEscaped(table)) @for one in &forests { (one) } })
}

/// Each group of the outermost level, then its inner groups and its tests.
fn units(record: &FitRecord, i: usize, charts: &mut Charts) -> Option<Markup> {
    let state = clean(&record.levels[0].states[i]);
    let unit = record.phases.first().and_then(|phase| phase.units.get(i).cloned().flatten());
    let label = unit.map_or_else(|| state.clone(), |unit| format!("{state} [{}]", clean(&unit)));
    let mut rows = Vec::new();
    let mut groups: Vec<&UnitRecord> = record.groups.iter().collect();
    groups.sort_by(|a, b| a.id.cmp(&b.id)); // a group stands before what stands in it
    for group in groups {
        let indent = "– ".repeat(group.id.len() - 1);
        rows.extend(row(format!("{indent}{}", clean(group.id.last()?)), (&group.mean, &group.covariance), i));
        let innermost = group.id.len() + 1 == record.levels.len();
        let own = record.tests.iter().filter(|test| innermost && test.groups == group.id);
        rows.extend(own.filter_map(|test| test_row(test, &format!("{indent}– "), i)));
    }
    let caption = "Each group with the mean of its tests, and below it the tests: posterior means with 95 % intervals, given all \
                   data. Groups apart from each other differ from unit to unit; tests of one group apart from each other differ \
                   from run to run.";
    forest::forest(&format!("{state}: groups and their tests"), caption, vec![Group { label, rows }], charts)
}

fn test_row(test: &TestRecord, indent: &str, i: usize) -> Option<Row> {
    let part = test.phases.first()?;
    let within = test.groups.iter().fold(test.id.as_str(), |id, group| {
        id.strip_prefix(group.as_str()).and_then(|id| id.strip_prefix('/')).unwrap_or(id)
    });
    row(format!("{indent}{}", clean(within)), (&part.mean, &part.covariance), i)
}

fn row(name: String, (mean, covariance): (&[f64], &SquareRecord), i: usize) -> Option<Row> {
    let estimate = *mean.get(i)?;
    let half = SIDES * covariance.rows().nth(i)?.get(i)?.max(0.0).sqrt();
    let ends = [Some(estimate - half), Some(estimate + half)];
    let words = format!("{} ± {}", plain(estimate, 4), plain(half, 2));
    Some(Row { name, estimate, ends: Some(ends), words, reference: None })
}
