//! The tables of a hypothesis put into those of a model.

use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use crate::error::{SpecError, SpecProblem};
use crate::levels::GroupKind;
use crate::suggest::suggest;

/// The hypothesis in messages.
pub(crate) const PLACE: &str = "the hypothesis";
/// Keys of `[covariance]` that are no constraints on Σ: those of the model stay.
const KEPT: [&str; 2] = ["order", "known"];
/// The states that vary: a structure is one of these.
const VARYING: &str = "states";
/// Keys of `[covariance]` with a row and a column for each estimated state.
const MATRICES: [&str; 2] = ["matrix", "start"];
/// Tables of a phase that a hypothesis may have.
pub(crate) const OF_PHASE: [&str; 2] = ["mean", "covariance"];

type TomlKey<'i> = Spanned<DeString<'i>>;
type TomlItem<'i> = Spanned<DeValue<'i>>;

/// Puts the keys of a hypothesis, which were checked, into the model's.
pub(crate) fn merge<'i>(base: &mut DeTable<'i>, own: DeTable<'i>) -> Result<(), SpecError> {
    let mut phases = DeTable::new();
    refuse_idle(base, &own)?;
    for (key, value) in own {
        match (key.get_ref().as_ref(), value.get_ref()) {
            ("title", _) => {}
            ("parameters", DeValue::Table(_)) => parameters(base, key, value)?,
            ("phases", DeValue::Table(_)) => phases = into_table(value),
            ("levels" | "crossed", DeValue::Table(_)) => levels(base, key, value),
            _ => replace(base, key, value),
        }
    }
    for (phase, tables) in phases {
        for (key, value) in into_table(tables) {
            in_phase(base, phase.get_ref(), key, value);
        }
    }
    for key in OF_PHASE {
        if idle(base, key) {
            let found = base.keys().find(|k| k.get_ref() == key).cloned();
            found.map(|key| base.remove(&key));
        }
    }
    Ok(())
}

/// Refuses tables of the top level that no phase of the model takes.
fn refuse_idle(base: &DeTable<'_>, own: &DeTable<'_>) -> Result<(), SpecError> {
    let idle = |key: &&TomlKey<'_>| OF_PHASE.contains(&key.get_ref().as_ref()) && idle(base, key.get_ref());
    let Some(key) = own.keys().find(idle) else { return Ok(()) };
    let (name, why) = (key.get_ref().to_string(), "when every phase of the model has its own".to_owned());
    let hint = format!("write `[phases.NAME.{name}]`");
    Err(SpecError::new(SpecProblem::NoEffect { key: name, why }).at(key.span()).hint(hint))
}

/// Every phase has this table itself.
fn idle(base: &DeTable<'_>, key: &str) -> bool {
    let phases = base.iter().find(|(k, _)| k.get_ref() == "phases").and_then(|(_, phases)| phases.get_ref().as_table());
    let has = |phase: &TomlItem<'_>| {
        phase.get_ref().as_table().is_some_and(|tables| tables.keys().any(|k| k.get_ref() == key))
    };
    phases.is_some_and(|phases| phases.values().all(has))
}

/// Puts the matrices of a hypothesis' `[covariance]` from the order that it gives into that of the model. An order that does not
/// name every state once stays, for the reading of the model to refuse.
pub(crate) fn reorder(covariance: &mut DeTable<'_>, states: &[String]) {
    let Some(places) = places(covariance, states) else { return };
    permute_matrices(covariance, &places);
    remove(covariance, |key| key == "order");
}

/// The same of its `[levels.NAME.covariance]` and `[crossed.NAME.covariance]`, whose order is that of its `[covariance]`.
pub(crate) fn reorder_levels(own: &mut DeTable<'_>, states: &[String]) {
    let Some(places) = table_in(own, "covariance").and_then(|covariance| places(covariance, states)) else { return };
    for kind in [GroupKind::Levels, GroupKind::Crossed] {
        let Some(levels) = table_in(own, kind.key()) else { continue };
        for (_, level) in levels.iter_mut() {
            let DeValue::Table(level) = level.get_mut() else { continue };
            if let Some(covariance) = table_in(level, "covariance") {
                permute_matrices(covariance, &places);
            }
        }
    }
}

/// Where each state stands in `order`, if that names every state once.
fn places(covariance: &DeTable<'_>, states: &[String]) -> Option<Vec<usize>> {
    let (_, order) = covariance.iter().find(|(key, _)| key.get_ref() == "order")?;
    let order = order.get_ref().as_array()?;
    let place = |name: &String| order.iter().position(|item| item.get_ref().as_str() == Some(name.as_str()));
    let places: Option<Vec<usize>> = states.iter().map(place).collect();
    places.filter(|_| order.len() == states.len())
}

fn permute_matrices(covariance: &mut DeTable<'_>, places: &[usize]) {
    for (key, value) in covariance.iter_mut() {
        let DeValue::Array(rows) = value.get_mut() else { continue };
        let square = |rows: &toml::de::DeArray<'_>| {
            let fits = |row: &TomlItem<'_>| row.get_ref().as_array().is_some_and(|row| row.len() == places.len());
            rows.len() == places.len() && rows.iter().all(fits)
        };
        if !MATRICES.contains(&key.get_ref().as_ref()) || !square(rows) {
            continue; // reading the model says what is wrong
        }
        permute(rows, places);
        rows.iter_mut().for_each(|row| {
            if let DeValue::Array(row) = row.get_mut() {
                permute(row, places);
            }
        });
    }
}

fn permute(array: &mut toml::de::DeArray<'_>, places: &[usize]) {
    let moved: Vec<TomlItem<'_>> = places.iter().map(|&place| array[place].clone()).collect();
    array.iter_mut().zip(moved).for_each(|(to, from)| *to = from);
}

/// A phase has this table itself.
pub(crate) fn has_own(base: &DeTable<'_>, phase: &str, key: &str) -> bool {
    let named = |table: &DeTable<'_>, key: &str| table.keys().any(|k| k.get_ref() == key);
    base.iter().filter(|(k, _)| k.get_ref() == "phases").filter_map(|(_, phases)| phases.get_ref().as_table()).any(
        |phases| {
            let own = phases.iter().find(|(k, _)| k.get_ref() == phase);
            own.and_then(|(_, tables)| tables.get_ref().as_table()).is_some_and(|tables| named(tables, key))
        },
    )
}

/// Keys replace those of what a phase has: its own table, or else a copy of the top level's.
fn in_phase<'i>(base: &mut DeTable<'i>, phase: &str, key: TomlKey<'i>, value: TomlItem<'i>) {
    let top = base.get(&key).cloned();
    let Some(phase) = table_in(base, "phases").and_then(|phases| table_in(phases, phase)) else { return };
    if let (None, Some(top)) = (phase.get(&key), top) {
        phase.insert(key.clone(), top);
    }
    replace(phase, key, value);
}

pub(crate) fn table_in<'t, 'i>(table: &'t mut DeTable<'i>, key: &str) -> Option<&'t mut DeTable<'i>> {
    let (_, value) = table.iter_mut().find(|(k, _)| k.get_ref() == key)?;
    match value.get_mut() {
        DeValue::Table(table) => Some(table),
        _ => None,
    }
}

fn into_table(value: TomlItem<'_>) -> DeTable<'_> {
    match value.into_inner() {
        DeValue::Table(table) => table,
        _ => DeTable::new(),
    }
}

/// Keys of the covariance of a level or factor replace those of the level or factor.
fn levels<'i>(base: &mut DeTable<'i>, key: TomlKey<'i>, value: TomlItem<'i>) {
    let Some(levels) = table_in(base, key.get_ref()) else {
        base.insert(key, value);
        return;
    };
    for (name, tables) in into_table(value) {
        let Some(level) = table_in(levels, name.get_ref()) else {
            levels.insert(name, tables);
            continue;
        };
        into_table(tables).into_iter().for_each(|(key, value)| replace(level, key, value));
    }
}

/// What `[covariance]` of a hypothesis leaves of the model's.
#[derive(Clone, Copy, PartialEq)]
enum CovarianceChange {
    /// All but start values.
    Nothing,
    /// Another structure of the states that vary.
    Structure,
    /// Nothing varies.
    Still,
}

impl CovarianceChange {
    fn of(own: &DeTable<'_>) -> CovarianceChange {
        let value = |key: &str| own.iter().find(|(k, _)| k.get_ref() == key).map(|(_, value)| value.get_ref());
        let empty = value(VARYING).and_then(DeValue::as_array).is_some_and(|states| states.is_empty());
        match value("structure") {
            Some(_) => CovarianceChange::Structure,
            None if empty => CovarianceChange::Still,
            None => CovarianceChange::Nothing,
        }
    }

    fn drops(self, key: &str) -> bool {
        match self {
            _ if key == "start" => true,
            CovarianceChange::Nothing => false,
            CovarianceChange::Structure => !KEPT.contains(&key) && key != VARYING,
            CovarianceChange::Still => !KEPT.contains(&key),
        }
    }
}

fn remove(table: &mut DeTable<'_>, drops: impl Fn(&str) -> bool) {
    let gone: Vec<TomlKey<'_>> = table.keys().filter(|key| drops(key.get_ref())).cloned().collect();
    gone.iter().for_each(|key| {
        table.remove(key);
    });
}

/// Keys replace keys.
fn replace<'i>(base: &mut DeTable<'i>, key: TomlKey<'i>, value: TomlItem<'i>) {
    let DeValue::Table(own) = value.get_ref() else {
        base.insert(key, value); // reading the model says what is wrong
        return;
    };
    let anew = CovarianceChange::of(own);
    let Some(DeValue::Table(table)) = base.get_mut(&key).map(Spanned::get_mut) else {
        base.insert(key, value);
        return;
    };
    remove(table, |key| anew.drops(key));
    for (key, value) in into_table(value) {
        table.remove(&key); // the place of the key is the hypothesis' from now on
        table.insert(key, value);
    }
}

/// Parameters of the model only.
fn parameters<'i>(base: &mut DeTable<'i>, key: TomlKey<'i>, value: TomlItem<'i>) -> Result<(), SpecError> {
    let DeValue::Table(own) = value.get_ref() else { return Ok(()) };
    let known: Vec<String> = match base.get(&key).map(Spanned::get_ref) {
        Some(DeValue::Table(table)) => table.keys().map(|k| k.get_ref().to_string()).collect(),
        _ => Vec::new(),
    };
    if let Some(strange) = own.keys().find(|k| !known.iter().any(|name| name == k.get_ref())) {
        let name = strange.get_ref().to_string();
        let hint = suggest(&name, known.iter().map(String::as_str));
        let problem = SpecProblem::UnknownName { what: "parameter", name, place: PLACE.to_owned() };
        return Err(SpecError::new(problem).at(strange.span()).maybe_hint(hint));
    }
    let (Some(DeValue::Table(table)), DeValue::Table(own)) =
        (base.get_mut(&key).map(Spanned::get_mut), value.into_inner())
    else {
        return Ok(());
    };
    for (key, value) in own {
        if let Some(slot) = table.get_mut(&key) {
            *slot = value; // the order of the parameters stays
        }
    }
    Ok(())
}

/// The same table with all places moved.
pub(crate) fn shifted_table(table: DeTable<'_>, by: usize) -> DeTable<'_> {
    let mut moved = DeTable::new();
    for (key, value) in table {
        let span = key.span();
        moved.insert(Spanned::new(span.start + by..span.end + by, key.into_inner()), shifted(value, by));
    }
    moved
}

fn shifted(value: Spanned<DeValue<'_>>, by: usize) -> Spanned<DeValue<'_>> {
    let span = value.span();
    let inner = match value.into_inner() {
        DeValue::Table(table) => DeValue::Table(shifted_table(table, by)),
        DeValue::Array(array) => DeValue::Array(array.into_iter().map(|entry| shifted(entry, by)).collect()),
        plain => plain,
    };
    Spanned::new(span.start + by..span.end + by, inner)
}
