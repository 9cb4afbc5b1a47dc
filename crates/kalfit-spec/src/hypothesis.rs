//! A hypothesis: a file whose `[mean]`, `[covariance]`, those of phases and levels, and `[parameters]` replace keys of a model.
//!
//! The tables of the two files are merged and read again as one model. Places in the hypothesis are counted from the end of
//! the model's text, so that every message still knows its file.

use kalfit::model::{Column, Regression};
use kalfit::{Model, PhasedModel};
use toml::de::DeTable;

use crate::beside::{self, BesideError};
use crate::build;
use crate::digest;
use crate::error::{Span, SpecError, SpecProblem};
use crate::keys;
use crate::levels::{self, GroupKind};
use crate::merge::{OF_PHASE, PLACE, has_own, merge, reorder, reorder_levels, table_in};
use crate::names::{phase_key, table_key};
use crate::phase::ReadPurpose;
use crate::phases;
use crate::places::SpecPlaces;
use crate::spec::Spec;
use crate::table::{TomlField, TomlTable};

const KEYS: [&str; 7] = ["title", "mean", "covariance", "levels", "crossed", "parameters", "phases"];

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

impl Spec {
    /// The model under a hypothesis, given as text: keys of its `[mean]`, `[covariance]` and `[parameters]` replace the
    /// model's; `structure` drops the model's other keys of `[covariance]` but `order` and `known`, which are no constraints, and
    /// `states`, which says what varies; `states = []` drops the structure too, of which nothing is left.
    /// An `order` of the hypothesis is that of its own matrices; Σ stays in the order of the model.
    /// Start values of the model are dropped where the hypothesis speaks of the same table. What `set` fixed stays fixed.
    /// `[phases.NAME.mean]` and `[phases.NAME.covariance]` replace keys of what that phase has, its own table or that of the
    /// top level; `[mean]` and `[covariance]` act on the phases that leave them out, as in the model. `[levels.NAME.covariance]`
    /// and `[crossed.NAME.covariance]` replace keys of that level or factor, its matrices in the order of `[covariance]` of the same file.
    ///
    /// # Errors
    /// Whatever is wrong with the text, and with the two together.
    pub fn under(&self, hypothesis: &str) -> Result<Hypothesis, BesideError> {
        let (title, model) = beside::read(&self.text, hypothesis, |text, offset| self.merged(text, offset))?;
        Ok(Hypothesis { title, model, digest: digest::of_text(hypothesis) })
    }

    fn merged(&self, text: &str, offset: usize) -> Result<(Option<String>, PhasedModel), SpecError> {
        let [mut base, mut own] = beside::tables(text, offset)?;
        let title = self.check(&own, offset..text.len())?;
        self.reorder(&base, &mut own);
        merge(&mut base, own)?;
        let root = TomlTable::open("the model file", 0..text.len(), &base);
        let build::BuiltSpec { model: read, places, .. } = build::model(text, root, ReadPurpose::Tests)?;
        let mut model = self.adopt(read, &places)?;
        self.keep_set(&mut model);
        Ok((title, model))
    }

    /// Matrices of the hypothesis in the order of the model, where the hypothesis has an order of its own.
    fn reorder(&self, base: &DeTable<'_>, own: &mut DeTable<'_>) {
        if !self.model.levels.is_empty() {
            reorder_levels(own, &self.model.shared().estimated_names());
        }
        for phase in &self.model.phases {
            let states = phase.model.estimated_names();
            if !has_own(base, &phase.name, "covariance")
                && let Some(covariance) = table_in(own, "covariance")
            {
                reorder(covariance, &states);
            }
            let of_phase = table_in(own, "phases").and_then(|phases| table_in(phases, &phase.name));
            if let Some(covariance) = of_phase.and_then(|tables| table_in(tables, "covariance")) {
                reorder(covariance, &states);
            }
        }
    }

    /// What the hypothesis speaks of, with columns and texts numbered as in the model.
    fn adopt(&self, read: PhasedModel, places: &SpecPlaces) -> Result<PhasedModel, SpecError> {
        let mut model = self.model.clone();
        for (phase, read) in model.phases.iter_mut().zip(&read.phases) {
            phase.model = self.adopt_phase(phase.model.clone(), &read.model, places)?;
        }
        for (level, read) in model.levels.iter_mut().zip(read.levels) {
            level.covariance = read.covariance;
        }
        Ok(model)
    }

    fn adopt_phase(&self, model: Model, read: &Model, places: &SpecPlaces) -> Result<Model, SpecError> {
        let mut model = Model {
            mean: read.mean.clone(),
            covariance: read.covariance.clone(),
            parameters: read.parameters.clone(),
            ..model
        };
        for Regression { column, .. } in &mut model.mean.regression {
            let name = &read.columns[*column].name;
            let found = self.model.shared().columns.iter().position(|known| known.name == *name);
            *column = found.ok_or_else(|| {
                let place = format!("{PLACE}: the model has no regression on it");
                let problem = SpecProblem::UnknownName { what: "regression column", name: name.clone(), place };
                SpecError { span: places.columns.get(name).cloned(), ..SpecError::new(problem) }
            })?;
        }
        // The same places are added in every phase, so that columns and texts stay common to all.
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
    fn keep_set(&self, model: &mut PhasedModel) {
        let unset = build::spec(&self.name, &self.text).expect("the model was read before").model;
        for model in model.models_mut() {
            for ((new, old), set) in
                model.parameters.iter_mut().zip(&unset.shared().parameters).zip(&self.model.shared().parameters)
            {
                if new == old {
                    new.clone_from(set);
                }
            }
        }
    }

    /// Known keys only, and at least one that says something.
    fn check(&self, own: &DeTable<'_>, span: Span) -> Result<Option<String>, SpecError> {
        let mut root = TomlTable::open(PLACE, span.clone(), own).only(&KEYS)?;
        let title = root.take("title").map(|title| title.text().map(str::to_owned)).transpose()?;
        if KEYS[1..].iter().all(|key| root.peek(key).is_none()) {
            let problem = SpecProblem::MissingKey { key: "mean".to_owned(), place: PLACE.to_owned() };
            return Err(SpecError::new(problem).at(span).hint("say what to test, in `[mean]` or `[covariance]`"));
        }
        check_tables(&root, "")?;
        for kind in [GroupKind::Levels, GroupKind::Crossed] {
            root.peek(kind.key()).map_or(Ok(()), |field| self.check_levels(&field, kind))?;
        }
        let Some(field) = root.peek("phases") else { return Ok(title) };
        if self.model.phases.iter().all(|phase| self.phase_span(&phase.name).is_none()) {
            return Err(field.no_effect("in a hypothesis about a model without phases"));
        }
        for field in field.section(format!("`[phases]` of {PLACE}"))?.fields() {
            let known = self.model.phases.iter().map(|phase| phase.name.as_str());
            phases::find(field.key, known, PLACE, &field.key_span)?;
            let prefix = phase_key(field.key);
            let section = field.section(format!("`[{prefix}]` of {PLACE}"))?.only(&OF_PHASE)?;
            if section.len() == 0 {
                return Err(section.missing("mean"));
            }
            check_tables(&section, &format!("{prefix}."))?;
        }
        Ok(title)
    }
}

impl Spec {
    /// Levels or crossed factors of the model only, each with a covariance.
    fn check_levels(&self, field: &TomlField<'_>, kind: GroupKind) -> Result<(), SpecError> {
        let (own, without) = match kind {
            GroupKind::Levels => (self.model.nested(), "in a hypothesis about a model without levels"),
            GroupKind::Crossed => (self.model.factors(), "in a hypothesis about a model without crossed factors"),
        };
        if own.is_empty() {
            return Err(field.no_effect(without));
        }
        let place = format!("`[{}]` of {PLACE}", kind.key());
        for field in field.section(place.as_str())?.fields() {
            let known = own.iter().map(|level| level.name.as_str());
            if known.clone().all(|name| name != field.key) {
                return Err(levels::unknown(&field, kind, known, &place));
            }
            let key = table_key(kind.key(), field.key);
            let section = field.section(format!("`[{key}]` of {PLACE}"))?.with_keys(keys::LEVEL)?;
            let Some(covariance) = section.peek("covariance") else { return Err(section.missing("covariance")) };
            covariance.section("")?;
        }
        Ok(())
    }
}

/// Tables where tables must be, without keys that are no constraints.
fn check_tables(section: &TomlTable<'_>, prefix: &str) -> Result<(), SpecError> {
    for field in ["mean", "covariance", "parameters"].iter().filter_map(|key| section.peek(key)) {
        let section = field.section(format!("`[{prefix}{}]` of {PLACE}", field.key))?;
        if field.key == "covariance"
            && let Some(kept) = section.peek("known")
        {
            return Err(kept.no_effect("in a hypothesis: it is no constraint, and the model's stays"));
        }
    }
    Ok(())
}

/// Where an entry stands in a list; at its end when it was not there.
fn place_of<T: Clone>(list: &mut Vec<T>, entry: &T, same: impl Fn(&T, &T) -> bool) -> usize {
    list.iter().position(|known| same(known, entry)).unwrap_or_else(|| {
        list.push(entry.clone());
        list.len() - 1
    })
}
