//! `levels` and `crossed` of `[data]`, the groups that tests stand in, and `[levels]` and `[crossed]`, what varies from
//! group to group.

use std::collections::BTreeMap;

use kalfit::TestKey;
use kalfit::model::{CovarianceStructure, GroupLevel, State};

use crate::covariance;
use crate::elements::NamedElements;
use crate::error::{Result, Span, SpecError, SpecProblem, StructureProblem};
use crate::keys;
use crate::names::{NameContext, table_key};
use crate::phases::PhaseSource;
use crate::slots::Slots;
use crate::suggest::{either, suggest};
use crate::table::{TomlField, TomlTable};

/// Levels of one model; each has a covariance of all estimated states.
const MAX_LEVELS: usize = 10;

/// How groups stand to each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum GroupKind {
    /// Groups within groups.
    Levels,
    /// Factors whose groups cross all others.
    Crossed,
}

impl GroupKind {
    /// The key in `[data]`, and of the table with the covariances.
    pub(crate) fn key(self) -> &'static str {
        match self {
            GroupKind::Levels => "levels",
            GroupKind::Crossed => "crossed",
        }
    }

    /// What one of its columns is called.
    fn what(self) -> &'static str {
        match self {
            GroupKind::Levels => "level",
            GroupKind::Crossed => "crossed factor",
        }
    }
}

/// The columns of groups, the outermost first, or of crossed factors.
#[derive(Debug)]
pub(crate) struct GroupColumns {
    kind: GroupKind,
    all: Vec<GroupColumn>,
    /// The key in `[data]`.
    key: Span,
}

#[derive(Debug)]
struct GroupColumn {
    name: String,
    /// Text column of the model; `None` for a factor with a column for each slot.
    index: Option<usize>,
    span: Span,
}

/// Names of the factors with slots, which are no columns, and where each is named.
pub(crate) fn slotted<'d>(crossed: Option<&TomlField<'d>>) -> Vec<(&'d str, Span)> {
    // what is wrong with the tables is said when they are read
    let tables = crossed.and_then(|field| field.section("").ok());
    let has_slots = |field: &TomlField<'d>| field.section("").is_ok_and(|table| table.peek("as").is_some());
    let all = tables.iter().flat_map(TomlTable::fields).filter(has_slots);
    all.map(|field| (field.key, field.key_span.clone())).collect()
}

/// Reads `levels` or `crossed` of `[data]`. `slotted`: names that are no columns.
pub(crate) fn columns(
    context: &mut NameContext<'_>,
    (field, kind): (&TomlField<'_>, GroupKind),
    test: &TestKey,
    slotted: &[(&str, Span)],
) -> Result<GroupColumns> {
    if *test == TestKey::Single {
        let hint = "all rows are one test then: `test` names the column that tells tests apart";
        return Err(field.no_effect("without `test`").hint(hint));
    }
    let (place, names) = (field.what(), field.texts()?);
    let found = names.len();
    if found == 0 || found > MAX_LEVELS {
        let (what, example) = match kind {
            GroupKind::Levels => ("levels of groups", "levels = [\"unit\"]"),
            GroupKind::Crossed => ("crossed factors", "crossed = [\"station\"]"),
        };
        let problem = SpecProblem::Count { what, found, expected: format!("1 to {MAX_LEVELS}") };
        let error = SpecError::new(problem).at(field.span.clone());
        return Err(error.hint(format!("without groups leave `{}` out; with them, as in `{example}`", kind.key())));
    }
    let mut all: Vec<GroupColumn> = Vec::with_capacity(found);
    for (name, span) in names {
        let same = |other: &str| other.trim() == name.trim();
        if all.iter().any(|other| same(&other.name)) {
            let problem = StructureProblem::ListedTwice { name: name.to_owned(), place };
            return Err(SpecError::new(problem).at(span));
        }
        if slotted.iter().any(|(own, _)| *own == name) {
            all.push(GroupColumn { name: name.to_owned(), index: None, span });
            continue;
        }
        check_column(name, &span, field, test)?;
        let index = Some(context.text_column(name, span.clone(), &place));
        all.push(GroupColumn { name: name.to_owned(), index, span });
    }
    Ok(GroupColumns { kind, all, key: field.key_span.clone() })
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

    /// The names that are columns.
    pub(crate) fn columns(&self) -> impl Iterator<Item = &str> + Clone {
        self.all.iter().filter(|one| one.index.is_some()).map(|one| one.name.as_str())
    }

    /// The crossed factors with those that are named by their slots alone; `None` where there are none.
    pub(crate) fn with_slotted(found: Option<GroupColumns>, slotted: &[(&str, Span)]) -> Option<GroupColumns> {
        let unlisted = |(name, _): &&(&str, Span)| found.as_ref().is_none_or(|own| own.names().all(|one| one != *name));
        let column =
            |(name, span): &(&str, Span)| GroupColumn { name: (*name).to_owned(), index: None, span: span.clone() };
        let more: Vec<GroupColumn> = slotted.iter().filter(unlisted).map(column).collect();
        let key = more.first().map(|one| one.span.clone());
        match (found, key) {
            (Some(own), _) => Some(GroupColumns { all: own.all.into_iter().chain(more).collect(), ..own }),
            (None, Some(key)) => Some(GroupColumns { kind: GroupKind::Crossed, all: more, key }),
            (None, None) => None,
        }
    }

    /// Where each is named.
    pub(crate) fn spans(&self) -> BTreeMap<String, Span> {
        self.all.iter().map(|one| (one.name.clone(), one.span.clone())).collect()
    }

    /// Refuses a column that is a level too.
    pub(crate) fn refuse_shared(&self, levels: Option<&GroupColumns>) -> Result<()> {
        let shared =
            |one: &&GroupColumn| levels.is_some_and(|levels| levels.names().any(|name| name.trim() == one.name.trim()));
        match self.all.iter().find(shared) {
            None => Ok(()),
            Some(one) => {
                let (name, place) = (one.name.clone(), "`levels` and `crossed` of `[data]`".to_owned());
                let hint = "a column nests (`levels`) or crosses (`crossed`): take it out of one of them";
                Err(SpecError::new(StructureProblem::ListedTwice { name, place }).at(one.span.clone()).hint(hint))
            }
        }
    }

    /// Refuses phases and filters.
    pub(crate) fn refuse_beside(&self, phases: &[PhaseSource<'_>]) -> Result<()> {
        let beside = match &phases[0] {
            phase if phase.span.is_some() => "phases",
            phase if phase.table("filter").is_some() => "filter",
            _ => return Ok(()),
        };
        let key = self.kind.key();
        let hint = format!("take `{key}` or `[{beside}]` out: tests in groups have one phase and the optimal filter");
        Err(SpecError::new(SpecProblem::LevelsBeside { key, beside }).at(self.key.clone()).hint(hint))
    }
}

/// Reads `[levels]` or `[crossed]`: what has no table has a full covariance. `estimated`: the states in the order of Σ.
pub(crate) fn read(
    context: &mut NameContext<'_>,
    (columns, kind): (Option<&GroupColumns>, GroupKind),
    field: Option<TomlField<'_>>,
    (states, estimated): (&[State], &[usize]),
) -> Result<Vec<GroupLevel>> {
    let Some(columns) = columns else {
        return field.map_or(Ok(Vec::new()), |field| Err(without_columns(&field, kind)));
    };
    if estimated.is_empty() {
        let (key, why) = (kind.key().to_owned(), "where no initial state is estimated".to_owned());
        let hint = "groups differ in estimated states: a state without `process`, or one whose `initial` is left out";
        return Err(SpecError::new(SpecProblem::NoEffect { key, why }).at(columns.key.clone()).hint(hint));
    }
    let place = format!("`[{}]`", kind.key());
    let mut section = field.map(|field| field.section(place.as_str())).transpose()?;
    if let Some(field) =
        section.iter().flat_map(TomlTable::fields).find(|field| !columns.names().any(|n| n == field.key))
    {
        return Err(unknown(&field, kind, columns.names(), &place));
    }
    let elements = NamedElements::new(states, estimated);
    let mut levels = Vec::with_capacity(columns.all.len());
    for GroupColumn { name, index, .. } in &columns.all {
        let table = section.as_mut().and_then(|section| section.take(name));
        let mut table = level_table((name, kind), table)?;
        let slots = table.as_mut().and_then(|table| table.take("as"));
        let slots = slots.map(|field| Slots::read(context, &field)).transpose()?;
        let members = slots.map_or(Ok(Vec::new()), |slots| slots.members(states, estimated))?;
        let of_slots = (!members.is_empty()).then(|| elements.of_slots(&members));
        let covariance = level(context, (name, kind), table, of_slots.as_ref().unwrap_or(&elements))?;
        let column = index.or(members.first().map(|member| member.column)).unwrap_or_default();
        let crossed = kind == GroupKind::Crossed;
        levels.push(GroupLevel { name: name.clone(), column, crossed, covariance, members });
    }
    Ok(levels)
}

fn without_columns(field: &TomlField<'_>, kind: GroupKind) -> SpecError {
    let name = kind.key();
    let (key, why) = (format!("[{name}]"), format!("without `{name}` in `[data]`"));
    let example = match kind {
        GroupKind::Levels => "names the columns of groups, as in `levels = [\"unit\"]`",
        GroupKind::Crossed => "names the columns of factors that cross, as in `crossed = [\"station\"]`",
    };
    SpecError::new(SpecProblem::NoEffect { key, why })
        .at(field.key_span.clone())
        .hint(format!("`{name}` there {example}"))
}

/// The error of a table for what is no level, or no crossed factor.
pub(crate) fn unknown<'n>(
    field: &TomlField<'_>,
    kind: GroupKind,
    known: impl Iterator<Item = &'n str> + Clone,
    place: &str,
) -> SpecError {
    let problem = SpecProblem::UnknownName { what: kind.what(), name: field.key.to_owned(), place: place.to_owned() };
    let listed = || format!("`{}` of `[data]` names {}", kind.key(), either(&known.clone().collect::<Vec<_>>()));
    let hint = suggest(field.key, known.clone()).unwrap_or_else(listed);
    SpecError::new(problem).at(field.key_span.clone()).hint(hint)
}

fn level_table<'d>((name, kind): (&str, GroupKind), field: Option<TomlField<'d>>) -> Result<Option<TomlTable<'d>>> {
    let known = if kind == GroupKind::Crossed { keys::FACTOR } else { keys::LEVEL };
    let key = table_key(kind.key(), name);
    field.map(|field| field.section(format!("`[{key}]`"))?.with_keys(known)).transpose()
}

fn level(
    context: &mut NameContext<'_>,
    (name, kind): (&str, GroupKind),
    mut table: Option<TomlTable<'_>>,
    elements: &NamedElements,
) -> Result<CovarianceStructure> {
    let key = table_key(kind.key(), name);
    let own = table.as_mut().and_then(|table| table.take("covariance"));
    let own = own.map(|field| covariance::open_level(&field, format!("`[{key}.covariance]`"))).transpose()?;
    covariance::read(context, own, elements)
}
