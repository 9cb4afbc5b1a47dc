//! Tests in groups: the spread by level, and a forest of the groups with their tests.

use kalfit::FitRecord;
use kalfit::record::{FactorRecord, LevelRecord, SquareRecord, TestRecord, UnitRecord};
use maud::{Markup, PreEscaped, html};

use crate::html::chart::PageCharts;
use crate::html::estimates::{DIGITS, MOST_IN_MATRIX};
use crate::html::forest::{self, ForestGroup, ForestRow};
use crate::html::math::{self, equation, hat, op};
use crate::html::section::PageSection;
use crate::number::plain;
use crate::page::PageLayout;
use crate::summary::{levels, places};
use crate::words::clean;

/// Standard deviations to each side of a posterior mean that hold 95 %.
const SIDES: f64 = 1.96;
/// States of which there is a forest.
const MOST_STATES: usize = 4;

pub(super) fn section(record: &FitRecord, charts: &mut PageCharts) -> Option<PageSection> {
    if record.levels.is_empty() {
        return None;
    }
    let table = levels::section(record, &PageLayout::html());
    let covariances = places::outer(record).into_iter().filter_map(|(level, place)| covariance(level, &place));
    let states = 0..record.levels[0].states.len().min(MOST_STATES);
    let mut forests: Vec<Markup> = states.clone().filter_map(|i| units(record, i, charts)).collect();
    for factor in &record.crossed {
        forests.extend(states.clone().filter_map(|i| effects(record, factor, i, charts)));
    }
    PageSection::new(
        "levels",
        "Levels",
        html! { (PreEscaped(table)) @for one in covariances { (one) } @for one in &forests { (one) } },
    )
}

/// Σ of a level.
fn covariance(level: &LevelRecord, place: &str) -> Option<Markup> {
    let found = &level.covariance.estimate;
    (1..=MOST_IN_MATRIX).contains(&found.len()).then(|| {
        html! {
            h3 { "Covariance" (place) }
            div.equations.matrices { (equation(math::row([hat("Σ"), op("="), math::matrix(found, DIGITS)]))) }
        }
    })
}

/// Each group of the outermost level, then its inner groups and its tests.
fn units(record: &FitRecord, i: usize, charts: &mut PageCharts) -> Option<Markup> {
    let state = clean(&record.levels[0].states[i]);
    let unit = record.phases.first().and_then(|phase| phase.units.get(i).cloned().flatten());
    let label = unit.map_or_else(|| state.clone(), |unit| format!("{state} [{}]", clean(&unit)));
    let mut rows = Vec::new();
    let innermost = &record.levels.len().checked_sub(2).map(|at| &record.levels[at])?.name;
    let is_nested = |group: &&UnitRecord| record.crossed.iter().all(|factor| factor.level.name != group.level);
    let mut groups: Vec<&UnitRecord> = record.groups.iter().filter(is_nested).collect();
    groups.sort_by(|a, b| a.id.cmp(&b.id)); // a group stands before what stands in it
    for group in groups {
        let indent = "– ".repeat(group.id.len() - 1);
        rows.extend(row(format!("{indent}{}", clean(group.id.last()?)), (&group.mean, &group.covariance), i));
        let has_tests = group.level == *innermost;
        let own = record.tests.iter().filter(|test| has_tests && test.groups == group.id);
        rows.extend(own.filter_map(|test| test_row(test, &format!("{indent}– "), i)));
    }
    let unit = places::innermost(record)?;
    let caption = format!(
        "Each group with the mean of its tests, and below it the tests: posterior means with 95 % intervals, given all data. \
         The spread of the groups is the variation between groups, that of the tests of one {unit} the variation within it."
    );
    forest::forest(&format!("{state}: groups and their tests"), &caption, vec![ForestGroup { label, rows }], charts)
}

/// The effect of each level of a crossed factor on a state.
fn effects(record: &FitRecord, factor: &FactorRecord, i: usize, charts: &mut PageCharts) -> Option<Markup> {
    if levels::is_held_at_zero(&factor.level, i) || factor.effects.is_empty() {
        return None;
    }
    let (name, state) = (clean(&factor.level.name), clean(factor.level.states.get(i)?));
    let unit = record.phases.first().and_then(|phase| phase.units.get(i).cloned().flatten());
    let label = unit.map_or_else(|| state.clone(), |unit| format!("{state} [{}]", clean(&unit)));
    let mut all: Vec<_> = factor.effects.iter().collect();
    all.sort_by(|a, b| a.id.cmp(&b.id));
    let rows = all.into_iter().filter_map(|one| row(clean(&one.id), (&one.mean, &one.covariance), i)).collect();
    let caption = format!("The effect of each {name} on {state}: posterior mean with 95 % interval, given all data.");
    forest::forest(&format!("{state}: effect of each {name}"), &caption, vec![ForestGroup { label, rows }], charts)
}

fn test_row(test: TestRecord<'_>, indent: &str, i: usize) -> Option<ForestRow> {
    let part = test.phases.iter().next()?;
    let within = test
        .groups
        .iter()
        .fold(test.id, |id, group| id.strip_prefix(group.as_str()).and_then(|id| id.strip_prefix('/')).unwrap_or(id));
    row(format!("{indent}{}", clean(within)), (part.mean, &part.covariance), i)
}

fn row<E: AsRef<[f64]>>(name: String, (mean, covariance): (&[f64], &SquareRecord<E>), i: usize) -> Option<ForestRow> {
    let estimate = *mean.get(i)?;
    let half = SIDES * covariance.rows().nth(i)?.get(i)?.max(0.0).sqrt();
    let ends = [Some(estimate - half), Some(estimate + half)];
    let words = format!("{} ± {}", plain(estimate, 4), plain(half, 2));
    Some(ForestRow { name, estimate, ends: Some(ends), words, reference: None })
}
