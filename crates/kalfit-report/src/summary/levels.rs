//! Tests in groups: how much of the spread is from group to group of each level, and which groups stand out.

use kalfit::FitRecord;
use kalfit::record::{LevelRecord, SEARCH_LEVEL, UnitRecord};

use super::combination::NEGLIGIBLE;
use super::doubts;
use super::states::{Cells, spread};
use crate::number::{Precision, plain, probability};
use crate::page::Page;
use crate::table::{Column, Side};
use crate::words::{clean, count, list};

/// Groups of a table.
const MOST_ROWS: usize = 5;
/// Levels of a sentence.
const MOST_NAMES: usize = 8;

/// The levels and their groups: for the first lines.
pub(crate) fn counted(record: &FitRecord) -> Option<String> {
    let (tests, levels) = record.levels.split_last()?;
    let groups: Vec<String> =
        levels.iter().map(|level| format!("{} of `{}`", count(level.groups, "group"), clean(&level.name))).collect();
    Some(format!("Levels: {}; {} within them.", list(&groups, MOST_NAMES), count(tests.groups, "test")))
}

pub(crate) fn section(record: &FitRecord, page: &Page<'_>) -> String {
    let Some((_, groups)) = record.levels.split_last() else { return String::new() };
    let inner = groups.last().map_or(String::new(), |level| clean(&level.name));
    let outer = groups.iter().map(|level| format!("{0} to {0}", clean(&level.name)));
    let mut names: Vec<String> = outer.collect();
    names.push(format!("test to test of one {inner}"));
    let table = page.table(&columns(record, &names));
    let mut sentences = Vec::new();
    for (level, name) in record.levels.iter().zip(&names).filter(|(level, _)| level.column.is_some()) {
        sentences.extend(zero(level, name));
        sentences.extend(doubts::unidentified(&level.unidentified, &level.states, false));
    }
    let sums = record.levels.iter().any(|level| level.unidentified.iter().any(|one| !one.phases.is_empty()));
    if sums {
        sentences.push(
            "The levels are not told apart by these data: only sums of their covariances are known (see the notes)."
                .to_owned(),
        );
    }
    let body = table + &page.items(&sentences);
    let spread = page.section("Spread by level (share of the variance of a test)", &body);
    let apart = outlying(record, page);
    if apart.is_empty() { spread } else { format!("{spread}\n{apart}") }
}

/// One row for each state and level.
fn columns(record: &FitRecord, names: &[String]) -> Vec<Column> {
    let states = record.levels[0].states.len();
    let variance = |level: &LevelRecord, i: usize| {
        level.covariance.estimate.get(i).and_then(|row| row.get(i)).copied().filter(|x| x.is_finite()).unwrap_or(0.0)
    };
    let (mut state, mut level, mut groups, mut figure, mut beside, mut ends, mut share) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let varying = |i: &usize| record.levels.iter().any(|one| !is_held_at_zero(one, *i));
    for i in (0..states).filter(varying) {
        let all: f64 = record.levels.iter().map(|one| variance(one, i)).sum();
        for (k, (one, name)) in record.levels.iter().zip(names).enumerate() {
            let (value, error): Cells = std_dev(one, i);
            state.push(if k == 0 { one.states[i].clone() } else { String::new() });
            level.push(name.clone());
            groups.push(one.groups.to_string());
            figure.push(value);
            beside.push(error);
            ends.push(interval(one, i));
            let part = variance(one, i) / all;
            let known = all > 0.0 && !record.levels.iter().any(|level| is_open(level, i));
            share.push(if known { format!("{} %", plain(100.0 * part, 3)) } else { "-".to_owned() });
        }
    }
    vec![
        Column::new("state", Side::Left, state),
        Column::new("varies from", Side::Left, level),
        Column::new("number", Side::Right, groups),
        Column::new("std dev", Side::Right, figure),
        Column::new("", Side::Left, beside),
        Column::new("95 % interval", Side::Left, ends),
        Column::new("share", Side::Right, share),
    ]
}

fn is_fixed(level: &LevelRecord, i: usize) -> bool {
    level.covariance.fixed.get(i).and_then(|row| row.get(i)).copied().unwrap_or(false)
}

/// The model says that the state does not vary at the level.
fn is_held_at_zero(level: &LevelRecord, i: usize) -> bool {
    is_fixed(level, i) && level.std_dev.estimate.get(i) == Some(&0.0)
}

/// The data do not determine the variance of a state at a level.
fn is_open(level: &LevelRecord, i: usize) -> bool {
    let name = &level.states[i];
    let own = format!("{name}, {name}");
    level.unidentified.iter().filter(|one| one.what == "covariance").any(|one| {
        one.elements.iter().zip(&one.direction).any(|(element, weight)| *element == own && weight.abs() > NEGLIGIBLE)
    })
}

fn interval(level: &LevelRecord, i: usize) -> String {
    let Some([low, high]) = level.std_dev.interval95.get(i).copied().flatten() else { return String::new() };
    let precision = Precision::of(level.std_dev.estimate[i], level.std_dev.std_error.get(i).copied().flatten());
    let end = |x: Option<f64>, open: &str| x.map_or_else(|| open.to_owned(), |x| precision.show(x));
    format!("{} to {}", end(low, "0"), end(high, "∞"))
}

fn std_dev(level: &LevelRecord, i: usize) -> Cells {
    let Some(&estimate) = level.std_dev.estimate.get(i) else { return Default::default() };
    if is_held_at_zero(level, i) {
        return ("0".to_owned(), "does not vary".to_owned());
    }
    if is_open(level, i) {
        return ("-".to_owned(), "not identified".to_owned());
    }
    let fixed = is_fixed(level, i);
    let error = level.std_dev.std_error.get(i).copied().flatten();
    spread(&level.states[i], (estimate, error, fixed), &level.boundary, &level.unidentified)
}

/// Said of a level at which nothing varies.
fn zero(level: &LevelRecord, name: &str) -> Option<String> {
    let free = level.boundary.iter().any(|one| one.rank == 0);
    let known = !(0..level.states.len()).any(|i| is_open(level, i));
    (free && known).then(|| {
        format!("Nothing varies from {name} beyond what the tests within them explain: its covariance is zero.")
    })
}

/// Groups that do not look like the others.
fn outlying(record: &FitRecord, page: &Page<'_>) -> String {
    let mut tested: Vec<(f64, &UnitRecord)> =
        record.groups.iter().filter_map(|g| g.p_value.filter(|p| p.is_finite()).map(|p| (p, g))).collect();
    tested.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.id.cmp(&b.1.id)));
    let Some(&(least, nearest)) = tested.first() else { return String::new() };
    let all = tested.len();
    let corrected = |p: f64| (p * all as f64).min(1.0);
    let outliers: Vec<(f64, &UnitRecord)> = tested.into_iter().filter(|&(p, _)| corrected(p) < SEARCH_LEVEL).collect();
    if outliers.is_empty() {
        let sentence = format!(
            "No group stands out: the smallest of {all} p-values is {} ({} {}).",
            probability(least),
            clean(&nearest.level),
            clean(&nearest.id.join("/"))
        );
        return page.section("Outlying groups", &page.items(&[sentence]));
    }
    let rows = &outliers[..outliers.len().min(page.rows(MOST_ROWS))];
    let each = |of: &dyn Fn(&UnitRecord) -> String| rows.iter().map(|(_, group)| of(group)).collect();
    let columns = [
        Column::new("level", Side::Left, each(&|g| clean(&g.level))),
        Column::new("group", Side::Left, each(&|g| clean(&g.id.join("/")))),
        Column::new("tests", Side::Right, each(&|g| g.tests.to_string())),
        Column::new("distance²", Side::Right, each(&|g| g.distance.map_or_else(|| "-".to_owned(), |d| plain(d, 3)))),
        Column::new("expected", Side::Right, each(&|g| g.degrees_of_freedom.to_string())),
        Column::new("p-value", Side::Right, rows.iter().map(|&(p, _)| probability(p)).collect()),
        Column::new(
            &format!("times {all}"),
            Side::Right,
            rows.iter().map(|&(p, _)| probability(corrected(p))).collect(),
        ),
    ];
    let stands = if outliers.len() == 1 { "This group stands out" } else { "These groups stand out" };
    let sentence = format!("{stands} even though the search went over {all} groups (Bonferroni, 5 % level).");
    page.section("Outlying groups", &(page.table(&columns) + &page.items(&[sentence])))
}
