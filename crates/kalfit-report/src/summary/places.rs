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
    let groups: Vec<String> =
        levels.iter().map(|level| format!("{} of `{}`", count(level.groups, "group"), clean(&level.name))).collect();
    Some(format!("Levels: {}; {} within them.", list(&groups, MOST_NAMES), count(tests.groups, "test")))
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
    record.levels.iter().zip(places).filter(|(level, _)| level.column.is_some()).collect()
}

/// Where a reader finds what varies from group to group.
pub(crate) fn elsewhere(record: &FitRecord) -> Option<String> {
    let (_, groups) = record.levels.split_last()?;
    let unit = innermost(record)?;
    let places: Vec<String> = places(record)[..groups.len()].iter().map(|place| format!("from {place}")).collect();
    Some(format!(
        "These standard deviations describe tests of one {unit}; see \"{TABLE}\" for those {}.",
        list(&places, MOST_NAMES)
    ))
}

/// Where the states of each level vary, the outermost first: `lot to lot`, `chip to chip`, `within one chip`.
pub(crate) fn places(record: &FitRecord) -> Vec<String> {
    let place = |level: &LevelRecord| match level.column {
        Some(_) => format!("{0} to {0}", clean(&level.name)),
        None => within(record).trim_start().to_owned(),
    };
    record.levels.iter().map(place).collect()
}
