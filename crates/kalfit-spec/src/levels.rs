//! `levels` of `[data]`, the groups that tests stand in, and `[levels]`, what varies from group to group.

use std::collections::BTreeMap;

use kalfit::TestKey;
use kalfit::model::{CovarianceStructure, GroupLevel, State};

use crate::covariance;
use crate::elements::NamedElements;
use crate::error::{Result, Span, SpecError, SpecProblem, StructureProblem};
use crate::keys;
use crate::names::{NameContext, table_key};
use crate::phases::PhaseSource;
use crate::suggest::{either, suggest};
use crate::table::{TomlField, TomlTable};

/// Levels of one model; each has a covariance of all estimated states.
const MAX_LEVELS: usize = 10;

/// The columns of groups, the outermost first.
#[derive(Debug)]
pub(crate) struct GroupColumns {
    all: Vec<GroupColumn>,
    /// The key in `[data]`.
    key: Span,
}

#[derive(Debug)]
struct GroupColumn {
    name: String,
    /// Text column of the model.
    index: usize,
    span: Span,
}

/// Reads `levels` of `[data]`.
pub(crate) fn columns(context: &mut NameContext<'_>, field: &TomlField<'_>, test: &TestKey) -> Result<GroupColumns> {
    if *test == TestKey::Single {
        let hint = "all rows are one test then: `test` names the column that tells tests apart";
        return Err(field.no_effect("without `test`").hint(hint));
    }
    let (place, names) = (field.what(), field.texts()?);
    let found = names.len();
    if found == 0 || found > MAX_LEVELS {
        let problem = SpecProblem::Count { what: "levels of groups", found, expected: format!("1 to {MAX_LEVELS}") };
        let error = SpecError::new(problem).at(field.span.clone());
        return Err(error.hint("without groups leave `levels` out; with them, as in `levels = [\"unit\"]`"));
    }
    let mut all: Vec<GroupColumn> = Vec::with_capacity(found);
    for (name, span) in names {
        let same = |other: &str| other.trim() == name.trim();
        if all.iter().any(|other| same(&other.name)) {
            let problem = StructureProblem::ListedTwice { name: name.to_owned(), place };
            return Err(SpecError::new(problem).at(span));
        }
        check_column(name, &span, field, test)?;
        let index = context.text_column(name, span.clone(), &place);
        all.push(GroupColumn { name: name.to_owned(), index, span });
    }
    Ok(GroupColumns { all, key: field.key_span.clone() })
}

/// Refuses what no column of groups can be.
fn check_column(name: &str, span: &Span, field: &TomlField<'_>, test: &TestKey) -> Result<()> {
    if name.starts_with('@') {
        let (what, place, found) = (field.key.to_owned(), field.place.clone(), name.to_owned());
        let problem = SpecProblem::UnknownWord { what, place, found, expected: "the names of columns".to_owned() };
        return Err(SpecError::new(problem).at(span.clone()));
    }
    match test {
        TestKey::Column(id) if id.trim() == name.trim() => {
            Err(SpecError::new(SpecProblem::LevelOfTests { name: name.to_owned() })
                .at(span.clone())
                .hint("a level is a column of what has several tests, such as the unit that is tested"))
        }
        _ => Ok(()),
    }
}

impl GroupColumns {
    /// The names, the outermost first.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> + Clone {
        self.all.iter().map(|one| one.name.as_str())
    }

    /// Where each is named.
    pub(crate) fn spans(&self) -> BTreeMap<String, Span> {
        self.all.iter().map(|one| (one.name.clone(), one.span.clone())).collect()
    }

    /// Refuses phases and filters.
    pub(crate) fn refuse_beside(&self, phases: &[PhaseSource<'_>]) -> Result<()> {
        let beside = match &phases[0] {
            phase if phase.span.is_some() => "phases",
            phase if phase.table("filter").is_some() => "filter",
            _ => return Ok(()),
        };
        let hint = format!("take `levels` or `[{beside}]` out: tests in groups have one phase and the optimal filter");
        Err(SpecError::new(SpecProblem::LevelsBeside { beside }).at(self.key.clone()).hint(hint))
    }
}

/// Reads `[levels]`: a level without a table has a full covariance. `estimated`: the states in the order of Σ.
pub(crate) fn read(
    context: &mut NameContext<'_>,
    columns: Option<&GroupColumns>,
    field: Option<TomlField<'_>>,
    (states, estimated): (&[State], &[usize]),
) -> Result<Vec<GroupLevel>> {
    let Some(columns) = columns else { return field.map_or(Ok(Vec::new()), |field| Err(without_columns(&field))) };
    let mut section = field.map(|field| field.section("`[levels]`")).transpose()?;
    if let Some(field) =
        section.iter().flat_map(TomlTable::fields).find(|field| !columns.names().any(|n| n == field.key))
    {
        return Err(unknown(&field, columns.names(), "`[levels]`"));
    }
    let elements = NamedElements::new(states, estimated);
    let mut levels = Vec::with_capacity(columns.all.len());
    for GroupColumn { name, index, .. } in &columns.all {
        let table = section.as_mut().and_then(|section| section.take(name));
        let covariance = level(context, name, table, &elements)?;
        levels.push(GroupLevel { name: name.clone(), column: *index, covariance });
    }
    Ok(levels)
}

fn without_columns(field: &TomlField<'_>) -> SpecError {
    let (key, why) = ("[levels]".to_owned(), "without `levels` in `[data]`".to_owned());
    SpecError::new(SpecProblem::NoEffect { key, why })
        .at(field.key_span.clone())
        .hint("`levels` there names the columns of groups, as in `levels = [\"unit\"]`")
}

/// The error of a table for what is no level.
pub(crate) fn unknown<'n>(
    field: &TomlField<'_>,
    known: impl Iterator<Item = &'n str> + Clone,
    place: &str,
) -> SpecError {
    let problem = SpecProblem::UnknownName { what: "level", name: field.key.to_owned(), place: place.to_owned() };
    let listed = || format!("`levels` of `[data]` names {}", either(&known.clone().collect::<Vec<_>>()));
    let hint = suggest(field.key, known.clone()).unwrap_or_else(listed);
    SpecError::new(problem).at(field.key_span.clone()).hint(hint)
}

fn level(
    context: &mut NameContext<'_>,
    name: &str,
    field: Option<TomlField<'_>>,
    elements: &NamedElements,
) -> Result<CovarianceStructure> {
    let key = table_key("levels", name);
    let mut table = field.map(|field| field.section(format!("`[{key}]`"))?.with_keys(keys::LEVEL)).transpose()?;
    let own = table.as_mut().and_then(|table| table.take("covariance"));
    let own = own.map(|field| covariance::open_level(&field, format!("`[{key}.covariance]`"))).transpose()?;
    covariance::read(context, own, elements)
}
