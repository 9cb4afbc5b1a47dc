//! The groups of each test, from the rows of the test.

use kalfit_model::{Evidence, PhasedTest};
use kalfit_model::{GroupLevel, PhasedModel};
use kalfit_model::{Grouping, Label};

/// Reasons why tests cannot be grouped.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GroupingError {
    /// The groups of a test are unknown.
    #[error(
        "which groups test `{test}` stands in is not known: it is given by a reduction without them, or by estimates"
    )]
    NoRows {
        /// Id of the test.
        test: String,
    },
    /// The rows of a test lack the name of a group at some level.
    #[error("test `{test}` has no name of its group of level `{level}`")]
    NoName {
        /// Id of the test.
        test: String,
        /// Name of the level.
        level: String,
    },
    /// A test belongs to several groups of one level.
    #[error("test `{test}` is of more than one group of level `{level}`")]
    Varies {
        /// Id of the test.
        test: String,
        /// Name of the level.
        level: String,
    },
}

/// The groups that the rows of tests give; `None` for a model without levels.
///
/// # Errors
/// A test has no rows, lacks the name of a group, or has several groups of one level.
pub fn grouping(model: &PhasedModel, tests: &[PhasedTest]) -> Result<Option<Grouping>, GroupingError> {
    if model.levels.is_empty() {
        return Ok(None);
    }
    let path = |test: &PhasedTest| match &test.phases[..] {
        [only] => groups_of(model, &test.id, only),
        _ => Err(GroupingError::NoRows { test: test.id.to_string() }),
    };
    let paths = tests.iter().map(|test| Ok((test.id.as_str(), path(test)?)));
    let counts = (model.factors().len(), model.nested().len());
    Ok(Some(Grouping::crossed(counts, paths.collect::<Result<Vec<_>, _>>()?)))
}

/// Names of the groups of a test, in the order of the levels of the model; empty for a model without levels.
///
/// # Errors
/// The same errors as [`grouping`].
pub fn groups_of(model: &PhasedModel, test: &str, evidence: &Evidence) -> Result<Vec<Label>, GroupingError> {
    let id = || test.to_owned();
    let rows = match evidence {
        Evidence::Rows(rows) => rows,
        Evidence::Reduced(piece) if piece.groups.len() == model.levels.len() => return Ok(piece.groups.clone()),
        _ if model.levels.is_empty() => return Ok(Vec::new()),
        Evidence::Reduced(_) | Evidence::Estimates(_) => return Err(GroupingError::NoRows { test: id() }),
    };
    let one = |level: &GroupLevel| {
        let name = |row: usize| rows.texts(row)[level.column];
        let first = if rows.rows() == 0 { Label::MISSING } else { name(0) };
        let level = || level.name.clone();
        if first.is_missing() {
            return Err(GroupingError::NoName { test: id(), level: level() });
        }
        match (1..rows.rows()).all(|row| name(row) == first) {
            true => Ok(first),
            false => Err(GroupingError::Varies { test: id(), level: level() }),
        }
    };
    model.levels.iter().map(one).collect()
}
