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
    /// A slot holds several groups in one test.
    #[error("test `{test}` has more than one name in slot `{slot}` of `{level}`")]
    SlotVaries {
        /// Id of the test.
        test: String,
        /// Name of the factor.
        level: String,
        /// Name of the slot.
        slot: String,
    },
    /// One group stands in two slots of a test.
    #[error("test `{test}` has one name in two slots of `{level}`")]
    Twice {
        /// Id of the test.
        test: String,
        /// Name of the factor.
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
/// A test has no rows, lacks the name of a group, has several groups of one level, or one in two slots.
pub fn grouping(model: &PhasedModel, tests: &[PhasedTest]) -> Result<Option<Grouping>, GroupingError> {
    if model.levels.is_empty() {
        return Ok(None);
    }
    let path = |test: &PhasedTest| match &test.phases[..] {
        [only] => groups_of(model, &test.id, only),
        _ => Err(GroupingError::NoRows { test: test.id.to_string() }),
    };
    let paths = tests.iter().map(|test| Ok((test.id.as_str(), path(test)?)));
    Ok(grouping_of(model, paths.collect::<Result<Vec<_>, _>>()?))
}

/// Groups tests, each given by (id, names of its groups as from [`groups_of`]); `None` for a model without levels.
pub fn grouping_of<'a>(
    model: &PhasedModel,
    tests: impl IntoIterator<Item = (&'a str, Vec<Label>)>,
) -> Option<Grouping> {
    if model.levels.is_empty() {
        return None;
    }
    let slots = |factor: &GroupLevel| factor.members.iter().map(|member| member.selection.clone()).collect();
    let factors = model.factors().iter().map(slots).collect();
    Some(Grouping::with_slots(factors, model.nested().len(), tests))
}

/// Names of the groups of a test, in the order of the levels of the model, a factor with several members slot by slot;
/// empty for a model without levels.
///
/// # Errors
/// The same errors as [`grouping`].
pub fn groups_of(model: &PhasedModel, test: &str, evidence: &Evidence) -> Result<Vec<Label>, GroupingError> {
    let id = || test.to_owned();
    let rows = match evidence {
        Evidence::Rows(rows) => rows,
        Evidence::Reduced(piece) if piece.groups.len() == group_names(model) => return Ok(piece.groups.clone()),
        _ if model.levels.is_empty() => return Ok(Vec::new()),
        Evidence::Reduced(_) | Evidence::Estimates(_) => return Err(GroupingError::NoRows { test: id() }),
    };
    let mut names = Vec::with_capacity(group_names(model));
    for level in &model.levels {
        let before = names.len();
        let named = || level.name.clone();
        for (slot, column) in level.columns().enumerate() {
            let name = |row: usize| rows.texts(row)[column];
            // the rows of other slots need not name what is in this one
            let may_lack = !level.members.is_empty();
            let first =
                (0..rows.rows()).map(name).find(|name| !(may_lack && name.is_missing())).unwrap_or(Label::MISSING);
            let is_first = |row: usize| name(row) == first || (may_lack && name(row).is_missing());
            if !(0..rows.rows()).all(is_first) {
                return Err(match level.members.get(slot) {
                    None => GroupingError::Varies { test: id(), level: named() },
                    Some(member) => GroupingError::SlotVaries { test: id(), level: named(), slot: member.slot.clone() },
                });
            }
            if names[before..].contains(&first) && !first.is_missing() {
                return Err(GroupingError::Twice { test: id(), level: named() });
            }
            names.push(first);
        }
        // a slot may be empty
        if level.members.is_empty() && names[before..].iter().all(|name| name.is_missing()) {
            return Err(GroupingError::NoName { test: id(), level: named() });
        }
    }
    Ok(names)
}

/// Number of names that a test gives of its groups.
fn group_names(model: &PhasedModel) -> usize {
    model.levels.iter().map(|level| level.columns().count()).sum()
}
