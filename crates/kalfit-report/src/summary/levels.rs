//! Tests in groups: how much of the spread is from group to group of each level and crossed factor.

use kalfit::FitRecord;
use kalfit::record::LevelRecord;

use super::places::{TABLE, outer, places};
use super::states::{FigureCells, spread};
use super::{correlations, doubts, effects, outlying_groups};
use crate::number::{FigurePrecision, plain};
use crate::page::PageLayout;
use crate::table::{ColumnSide, TextColumn};

pub(crate) fn section(record: &FitRecord, page: &PageLayout<'_>) -> String {
    if record.levels.is_empty() {
        return String::new();
    }
    let mut sentences = Vec::new();
    for (level, place) in outer(record) {
        sentences.extend(boundaries(level, &place));
        sentences.extend(doubts::unidentified(&level.unidentified, &level.states, false));
    }
    let sums = record.all_levels().any(|level| level.unidentified.iter().any(|one| !one.phases.is_empty()));
    if sums {
        sentences.push(
            "These data cannot separate the levels: only sums of their covariances are known (see the notes)."
                .to_owned(),
        );
    }
    let body = page.table(&columns(record, &places(record))) + &page.items(&sentences);
    let mut sections = vec![page.section(&format!("{TABLE} (share: part of the variance of the states)"), &body)];
    let unchanged = |what: &str| what.to_owned();
    for (level, place) in outer(record) {
        sections.push(correlations::section(level.into(), &place, &unchanged, page));
    }
    let units = record.phases.first().map_or(&[][..], |phase| &phase.units);
    sections.extend(record.crossed.iter().map(|factor| effects::section(factor, units, page)));
    sections.push(outlying_groups::section(record, page));
    sections.retain(|section| !section.is_empty());
    sections.join("\n")
}

/// One row for each state and level.
fn columns(record: &FitRecord, names: &[String]) -> Vec<TextColumn> {
    // the states, each of which one effect of each level acts on at most
    let states = &record.levels[record.levels.len() - 1].states;
    let effect = |level: &LevelRecord, i: usize| level.effect_on(states, i).filter(|e| !is_held_at_zero(level, *e));
    let variance = |level: &LevelRecord, i: usize| {
        level.covariance.estimate.get(i).and_then(|row| row.get(i)).copied().filter(|x| x.is_finite()).unwrap_or(0.0)
    };
    let (mut state, mut level, mut groups, mut figure, mut beside, mut ends, mut share) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for i in 0..states.len() {
        let of_state = || record.all_levels().zip(names).filter_map(|(one, name)| Some((one, name, effect(one, i)?)));
        let all: f64 = of_state().map(|(one, _, e)| variance(one, e)).sum();
        for (k, (one, name, e)) in of_state().enumerate() {
            let (value, error): FigureCells = std_dev(one, e);
            state.push(if k == 0 { states[i].clone() } else { String::new() });
            level.push(name.clone());
            groups.push(one.groups.to_string());
            figure.push(value);
            beside.push(error);
            ends.push(interval(one, e));
            let part = variance(one, e) / all;
            let known = all > 0.0 && !of_state().any(|(one, _, e)| is_open(one, e));
            share.push(if known { format!("{} %", plain(100.0 * part, 3)) } else { "-".to_owned() });
        }
    }
    vec![
        TextColumn::new("state", ColumnSide::Left, state),
        TextColumn::new("spread", ColumnSide::Left, level),
        TextColumn::new("number", ColumnSide::Right, groups),
        TextColumn::new("std dev", ColumnSide::Right, figure),
        TextColumn::new("", ColumnSide::Left, beside),
        TextColumn::new("95 % interval", ColumnSide::Left, ends),
        TextColumn::new("share", ColumnSide::Right, share),
    ]
}

fn is_fixed(level: &LevelRecord, i: usize) -> bool {
    level.covariance.fixed.get(i).and_then(|row| row.get(i)).copied().unwrap_or(false)
}

/// The model says that the state does not vary at the level.
pub(crate) fn is_held_at_zero(level: &LevelRecord, i: usize) -> bool {
    is_fixed(level, i) && level.std_dev.estimate.get(i) == Some(&0.0)
}

/// The data do not determine the variance of a state at a level.
fn is_open(level: &LevelRecord, i: usize) -> bool {
    let name = &level.states[i];
    let own = format!("{name}, {name}");
    level
        .unidentified
        .iter()
        .filter(|one| one.what == "covariance")
        .any(|one| one.elements.iter().zip(&one.direction).any(|(element, weight)| *element == own && *weight != 0.0))
}

pub(crate) fn interval(level: &LevelRecord, i: usize) -> String {
    let Some([low, high]) = level.std_dev.interval95.get(i).copied().flatten() else { return String::new() };
    let precision = FigurePrecision::of(level.std_dev.estimate[i], level.std_dev.std_error.get(i).copied().flatten());
    let end = |x: Option<f64>, open: &str| x.map_or_else(|| open.to_owned(), |x| precision.show(x));
    format!("{} to {}", end(low, "0"), end(high, "∞"))
}

pub(crate) fn std_dev(level: &LevelRecord, i: usize) -> FigureCells {
    let Some(&estimate) = level.std_dev.estimate.get(i) else { return Default::default() };
    if is_open(level, i) {
        return ("-".to_owned(), "not identified".to_owned());
    }
    let fixed = is_fixed(level, i);
    let error = level.std_dev.std_error.get(i).copied().flatten();
    spread(&level.states[i], (estimate, error, fixed), &level.boundary, &level.unidentified)
}

/// What is singular of a level: nothing varies there, or some combination does not.
fn boundaries(level: &LevelRecord, place: &str) -> Vec<String> {
    let known = !(0..level.states.len()).any(|i| is_open(level, i));
    let none = level.std_dev.estimate.iter().all(|s| *s == 0.0);
    if known && none && !level.boundary.is_empty() {
        return vec![format!(
            "The covariance{place} is estimated as zero: the variation between tests explains all differences."
        )];
    }
    let from = place.trim_start_matches(" from ");
    level.boundary.iter().map(|one| doubts::at_level(place, &doubts::singular(one, level.states.len(), from))).collect()
}
