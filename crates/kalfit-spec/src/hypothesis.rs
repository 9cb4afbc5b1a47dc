//! A hypothesis: a file whose `[mean]`, `[covariance]` and `[parameters]` replace keys of a model.
//!
//! The tables of the two files are merged and read again as one model. Places in the hypothesis are counted from the end of
//! the model's text, so that every message still knows its file.

use kalfit::model::{Column, Regression};
use kalfit::{Model, PhasedModel};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::Spec;
use crate::build::{self, MAX_BYTES, Places};
use crate::error::{Problem, Span, SpecError};
use crate::suggest::suggest;
use crate::table::Section;

const KEYS: [&str; 4] = ["title", "mean", "covariance", "parameters"];
const PLACE: &str = "the hypothesis";
/// Keys of `[covariance]` that are no constraints on Σ: a hypothesis leaves them alone.
const KEPT: [&str; 2] = ["order", "known"];

/// A model under a hypothesis.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// What the hypothesis is called, if it says so.
    pub title: Option<String>,
    /// The model with the keys replaced. Its columns and texts are numbered as in the model it came from.
    pub model: PhasedModel,
    /// `sha256:` and 64 hexadecimal digits: the digest of the text of the hypothesis.
    pub digest: String,
}

/// What is wrong with a hypothesis, and which file the place is in.
#[derive(Debug, Clone, PartialEq)]
pub enum HypothesisError {
    /// In the hypothesis.
    Hypothesis(SpecError),
    /// In the model: a key that the hypothesis does not go with.
    Model(SpecError),
}

impl Spec {
    /// The model under a hypothesis, given as text: keys of its `[mean]`, `[covariance]` and `[parameters]` replace the
    /// model's; `structure` drops the model's other keys of `[covariance]` but `order` and `known`, which are no constraints.
    /// Start values of the model are dropped where the hypothesis speaks of the same table. What `set` fixed stays fixed.
    ///
    /// # Errors
    /// Whatever is wrong with the text, and with the two together.
    pub fn under(&self, hypothesis: &str) -> Result<Hypothesis, HypothesisError> {
        let found = hypothesis.len() as u64;
        if found > MAX_BYTES {
            let problem = Problem::TooLarge { found, limit: MAX_BYTES };
            return Err(HypothesisError::Hypothesis(SpecError::new(problem)));
        }
        let (text, offset) = (format!("{}\n{hypothesis}", self.text), self.text.len() + 1);
        let sort = |error: SpecError| located(error, offset);
        let (title, model) = self.merged(&text, offset).map_err(sort)?;
        Ok(Hypothesis { title, model: model.into(), digest: build::digest(hypothesis) })
    }

    fn merged(&self, text: &str, offset: usize) -> Result<(Option<String>, Model), SpecError> {
        let (first, second) = (&text[..offset - 1], &text[offset..]);
        let own = DeTable::parse(second).map_err(|error| moved(build::not_toml(&error, second), offset))?;
        let own = shifted_table(own.into_inner(), offset);
        let mut base = DeTable::parse(first).map_err(|error| build::not_toml(&error, first))?.into_inner();
        let title = check(&own, offset..text.len())?;
        for (key, value) in own {
            match (key.get_ref().as_ref(), value.get_ref()) {
                ("title", _) => {}
                ("parameters", DeValue::Table(_)) => parameters(&mut base, key, value)?,
                (_, DeValue::Table(_)) => replace(&mut base, key, value)?,
                _ => _ = base.insert(key, value), // not a table: reading the model says so
            }
        }
        let root = Section::open("the model file", 0..text.len(), &base);
        let (read, _, places) = build::model(text, root)?;
        let mut model = self.adopt(read, &places)?;
        self.keep_set(&mut model);
        Ok((title, model))
    }

    /// What the hypothesis speaks of, with columns and texts numbered as in the model.
    fn adopt(&self, mut read: Model, places: &Places) -> Result<Model, SpecError> {
        for Regression { column, .. } in &mut read.mean.regression {
            let name = &read.columns[*column].name;
            let found = self.model.shared().columns.iter().position(|known| known.name == *name);
            *column = found.ok_or_else(|| {
                let place = format!("{PLACE}: the model has no regression on it");
                let problem = Problem::UnknownName { what: "regression column", name: name.clone(), place };
                SpecError { span: places.columns.get(name).cloned(), ..SpecError::new(problem) }
            })?;
        }
        let Model { mean, covariance, parameters, .. } = read;
        let mut model = Model { mean, covariance, parameters, ..self.model.shared().clone() };
        for parameter in &mut model.parameters {
            let same = |known: &Column, column: &Column| known.name == column.name;
            parameter.per =
                parameter.per.map(|column| place_of(&mut model.text_columns, &read.text_columns[column], same));
            let levels = std::mem::take(&mut parameter.fixed_levels).into_iter();
            let level = |(level, value): (usize, f64)| {
                (place_of(&mut model.literals, &read.literals[level], String::eq), value)
            };
            parameter.fixed_levels = levels.map(level).collect();
        }
        Ok(model)
    }

    /// Parameters that were set after the model was read and that the hypothesis says nothing else of.
    fn keep_set(&self, model: &mut Model) {
        let unset = build::spec(&self.name, &self.text).expect("the model was read before").model;
        for ((new, old), set) in
            model.parameters.iter_mut().zip(&unset.shared().parameters).zip(&self.model.shared().parameters)
        {
            if new == old {
                new.clone_from(set);
            }
        }
    }
}

/// Where an entry stands in a list; at its end when it was not there.
fn place_of<T: Clone>(list: &mut Vec<T>, entry: &T, same: impl Fn(&T, &T) -> bool) -> usize {
    list.iter().position(|known| same(known, entry)).unwrap_or_else(|| {
        list.push(entry.clone());
        list.len() - 1
    })
}

fn located(mut error: SpecError, offset: usize) -> HypothesisError {
    match error.span.take() {
        Some(span) if span.start >= offset => {
            error.span = Some(span.start - offset..span.end - offset);
            HypothesisError::Hypothesis(error)
        }
        Some(span) => {
            error.span = Some(span);
            HypothesisError::Model(error)
        }
        None => HypothesisError::Hypothesis(error),
    }
}

fn moved(mut error: SpecError, offset: usize) -> SpecError {
    error.span = error.span.map(|span| span.start + offset..span.end + offset);
    error
}

/// Known keys only, and at least one that says something.
fn check(own: &DeTable<'_>, span: Span) -> Result<Option<String>, SpecError> {
    let mut root = Section::open(PLACE, span.clone(), own).only(&KEYS)?;
    let title = root.take("title").map(|title| title.text().map(str::to_owned)).transpose()?;
    if KEYS[1..].iter().all(|key| root.peek(key).is_none()) {
        let problem = Problem::MissingKey { key: "mean".to_owned(), place: PLACE.to_owned() };
        return Err(SpecError::new(problem).at(span).hint("say what to test, in `[mean]` or `[covariance]`"));
    }
    for field in KEYS[1..].iter().filter_map(|key| root.peek(key)) {
        let section = field.section(format!("`[{}]` of {PLACE}", field.key))?;
        if field.key == "covariance"
            && let Some(kept) = KEPT.iter().find_map(|key| section.peek(key))
        {
            return Err(kept.no_effect("in a hypothesis: it is no constraint, and the model's stays"));
        }
    }
    Ok(title)
}

/// Keys replace keys.
fn replace<'i>(
    base: &mut DeTable<'i>,
    key: Spanned<toml::de::DeString<'i>>,
    value: Spanned<DeValue<'i>>,
) -> Result<(), SpecError> {
    let DeValue::Table(own) = value.get_ref() else { return Ok(()) };
    let anew = own.keys().any(|k| k.get_ref() == "structure");
    let Some(DeValue::Table(table)) = base.get_mut(&key).map(Spanned::get_mut) else {
        base.insert(key, value);
        return Ok(());
    };
    let dropped = |k: &str| k == "start" || (anew && !KEPT.contains(&k));
    let gone: Vec<_> = table.keys().filter(|k| dropped(k.get_ref())).cloned().collect();
    for key in gone {
        table.remove(&key);
    }
    let DeValue::Table(own) = value.into_inner() else { return Ok(()) };
    for (key, value) in own {
        table.remove(&key); // the place of the key is the hypothesis' from now on
        table.insert(key, value);
    }
    Ok(())
}

/// Parameters of the model only.
fn parameters<'i>(
    base: &mut DeTable<'i>,
    key: Spanned<toml::de::DeString<'i>>,
    value: Spanned<DeValue<'i>>,
) -> Result<(), SpecError> {
    let DeValue::Table(own) = value.get_ref() else { return Ok(()) };
    let known: Vec<String> = match base.get(&key).map(Spanned::get_ref) {
        Some(DeValue::Table(table)) => table.keys().map(|k| k.get_ref().to_string()).collect(),
        _ => Vec::new(),
    };
    if let Some(strange) = own.keys().find(|k| !known.iter().any(|name| name == k.get_ref())) {
        let name = strange.get_ref().to_string();
        let hint = suggest(&name, known.iter().map(String::as_str));
        let problem = Problem::UnknownName { what: "parameter", name, place: PLACE.to_owned() };
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
fn shifted_table(table: DeTable<'_>, by: usize) -> DeTable<'_> {
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
