//! Levels of parameters and the tests that have them.

use std::collections::{BTreeMap, BTreeSet};

use crate::diagnosis::list;
use kalfit_model::Model;
use kalfit_model::{Evidence, PhasedTest};
use kalfit_model::{Label, Labels};

/// Levels of the column of a parameter that occur in the data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LevelCounts {
    /// Index of the parameter in [`Model::parameters`].
    pub parameter: usize,
    /// Number of tests that have each level, as (level, number) sorted by level.
    pub tests: Vec<(String, usize)>,
}

impl LevelCounts {
    /// Counts for all parameters that have levels, over all phases of each test; a phase that is given by a reduction
    /// has no rows to count in.
    pub fn all(model: &Model, labels: &Labels, tests: &[PhasedTest]) -> Vec<LevelCounts> {
        let mut of_column: BTreeMap<usize, Vec<(String, usize)>> = BTreeMap::new();
        let with_levels = model.parameters.iter().enumerate().filter_map(|(i, p)| Some((i, p.per?)));
        with_levels
            .map(|(parameter, column)| {
                let tests = of_column.entry(column).or_insert_with(|| count(column, labels, tests)).clone();
                LevelCounts { parameter, tests }
            })
            .collect()
    }
}

fn count(column: usize, labels: &Labels, tests: &[PhasedTest]) -> Vec<(String, usize)> {
    let mut counts: BTreeMap<Label, usize> = BTreeMap::new();
    for test in tests {
        let rows = test.phases.iter().filter_map(Evidence::cells);
        let own: BTreeSet<Label> =
            rows.flat_map(|rows| (0..rows.rows()).map(move |row| rows.texts(row)[column])).collect();
        own.into_iter().filter(|level| !level.is_missing()).for_each(|level| *counts.entry(level).or_default() += 1);
    }
    let mut named: Vec<(String, usize)> =
        counts.into_iter().map(|(level, n)| (labels.text(level).to_owned(), n)).collect();
    named.sort();
    named
}

/// Notes on fixed levels that the data do not have, in sentences without a full stop: a misspelt level leaves the
/// intended level free.
pub fn level_notes(model: &Model, counts: &[LevelCounts]) -> Vec<String> {
    let mut notes = Vec::new();
    for LevelCounts { parameter, tests } in counts {
        let parameter = &model.parameters[*parameter];
        let Some(column) = parameter.per else { continue };
        let has = |text: &str| tests.binary_search_by(|(level, _)| level.as_str().cmp(text)).is_ok();
        let mut unknown_levels: Vec<&str> =
            parameter.fixed_levels.keys().map(|&l| model.literals[l].as_str()).filter(|text| !has(text)).collect();
        unknown_levels.sort_unstable();
        if !unknown_levels.is_empty() {
            let column = &model.text_columns[column].name;
            notes.push(format!(
                "`{}` is fixed for {column} {}, which the data do not have: they have {}",
                parameter.name,
                list(unknown_levels.into_iter(), "and"),
                list(tests.iter().map(|(level, _)| level.as_str()), "and")
            ));
        }
    }
    notes
}
