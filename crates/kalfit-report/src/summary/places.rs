//! Where states vary, in words: from group to group of each level, and within one group.

use kalfit::FitRecord;
use kalfit::record::LevelRecord;

use crate::words::{clean, count, list};

/// Levels of a sentence.
const MOST_NAMES: usize = 8;
/// The table of levels.
pub(crate) const TABLE: &str = "Spread by level";

/// The levels and their groups: for the first lines.
pub(crate) fn counted(record: &FitRecord) -> Option<String> {
    let (tests, levels) = record.levels.split_last()?;
    let of = |level: &LevelRecord, what: &str| format!("{} of `{}`", count(level.groups, what), clean(&level.name));
    let groups: Vec<String> = levels.iter().map(|level| of(level, "group")).collect();
    let factors: Vec<String> = record.crossed.iter().map(|factor| of(&factor.level, "level")).collect();
    let crossed = || format!("Crossed: {}", list(&factors, MOST_NAMES));
    let tests = count(tests.groups, "test");
    Some(match (groups.is_empty(), factors.is_empty()) {
        (true, _) => format!("{}; {tests}.", crossed()),
        (false, true) => format!("Levels: {}; {tests} within them.", list(&groups, MOST_NAMES)),
        (false, false) => format!("Levels: {}; {tests} within them. {}.", list(&groups, MOST_NAMES), crossed()),
    })
}

/// The name of a group of the innermost level, as in "within one chip"; nothing without levels.
pub(crate) fn innermost(record: &FitRecord) -> Option<String> {
    let (_, groups) = record.levels.split_last()?;
    groups.last().map(|level| clean(&level.name))
}

/// Where the tests' own states vary, with a space in front; empty without levels.
pub(crate) fn within(record: &FitRecord) -> String {
    innermost(record).map_or_else(String::new, |unit| format!(" within one {unit}"))
}

/// The levels of groups with where their states vary, with a space in front.
pub(crate) fn outer(record: &FitRecord) -> Vec<(&LevelRecord, String)> {
    let places = places(record).into_iter().map(|place| format!(" from {place}"));
    record.all_levels().zip(places).filter(|(level, _)| level.column.is_some()).collect()
}

/// Where a reader finds the intervals of what varies from group to group.
pub(crate) fn elsewhere(record: &FitRecord) -> Option<String> {
    (!record.levels.is_empty()).then(|| format!("Intervals of the standard deviations are in \"{TABLE}\"."))
}

/// Where the states of each crossed factor and of each level vary, the outermost first: `station to station`,
/// `lot to lot`, `chip to chip`, `within one chip`.
pub(crate) fn places(record: &FitRecord) -> Vec<String> {
    let place = |level: &LevelRecord| match level.column {
        Some(_) => format!("{0} to {0}", clean(&level.name)),
        None if innermost(record).is_none() => "test to test".to_owned(),
        None => within(record).trim_start().to_owned(),
    };
    record.all_levels().map(place).collect()
}
