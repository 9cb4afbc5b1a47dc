//! Reading TOML tables so that every key is either used or refused, and every message has its place.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::error::{Result, Span, SpecError, SpecProblem};
use crate::keys::{self, Key};
use crate::suggest::{either, suggest};

/// A table of the file with the keys that were read of it.
pub(crate) struct TomlTable<'d> {
    /// The table in words.
    pub(crate) place: String,
    /// Its header, or the whole table when it is written inline.
    pub(crate) span: Span,
    table: &'d DeTable<'d>,
    read: Vec<&'d str>,
}

/// A key and its value.
#[derive(Clone)]
pub(crate) struct TomlField<'d> {
    pub(crate) key: &'d str,
    pub(crate) key_span: Span,
    pub(crate) span: Span,
    pub(crate) place: String,
    value: &'d DeValue<'d>,
}

impl<'d> TomlTable<'d> {
    /// A table whose keys are names that the user gives.
    pub(crate) fn open(place: impl Into<String>, span: Span, table: &'d DeTable<'d>) -> TomlTable<'d> {
        TomlTable { place: place.into(), span, table, read: Vec::new() }
    }

    /// Refuses keys that are not among `known`.
    pub(crate) fn only(self, known: &[&str]) -> Result<TomlTable<'d>> {
        for field in self.fields() {
            if !known.contains(&field.key) {
                let problem = SpecProblem::UnknownKey { key: field.key.to_owned(), place: self.place.clone() };
                let hint = suggest(field.key, known.iter().copied());
                return Err(SpecError::new(problem)
                    .at(field.key_span)
                    .maybe_hint(hint.or_else(|| Some(format!("its keys are {}", either(known))))));
            }
        }
        Ok(self)
    }

    /// Refuses keys that the table does not have.
    pub(crate) fn with_keys(self, keys: &'static [Key]) -> Result<TomlTable<'d>> {
        self.only(&keys::names(keys))
    }

    /// All keys in file order.
    pub(crate) fn fields(&self) -> impl Iterator<Item = TomlField<'d>> + use<'_, 'd> {
        self.table.iter().map(|(key, value)| self.field(key, value))
    }

    /// Number of keys.
    pub(crate) fn len(&self) -> usize {
        self.table.len()
    }

    /// The value of a key, which counts as used from now on.
    pub(crate) fn take(&mut self, key: &str) -> Option<TomlField<'d>> {
        let field = self.peek(key)?;
        self.read.push(field.key);
        Some(field)
    }

    /// The value of a key, which does not count as used.
    pub(crate) fn peek(&self, key: &str) -> Option<TomlField<'d>> {
        let (key, value) = self.table.iter().find(|(k, _)| k.get_ref() == key)?;
        Some(self.field(key, value))
    }

    /// The value of a key that must be there.
    pub(crate) fn need(&mut self, key: &str) -> Result<TomlField<'d>> {
        self.take(key).ok_or_else(|| self.missing(key))
    }

    /// The error that a key is not there.
    pub(crate) fn missing(&self, key: &str) -> SpecError {
        SpecError::new(SpecProblem::MissingKey { key: key.to_owned(), place: self.place.clone() }).at(self.span.clone())
    }

    /// Refuses the first key that nobody used: it has no effect for the reason `why`.
    pub(crate) fn finish(self, why: &str, hint: Option<&str>) -> Result<()> {
        match self.fields().find(|field| !self.read.contains(&field.key)) {
            None => Ok(()),
            Some(field) => Err(field.no_effect(why).maybe_hint(hint.map(str::to_owned))),
        }
    }

    fn field(&self, key: &'d Spanned<toml::de::DeString<'d>>, value: &'d Spanned<DeValue<'d>>) -> TomlField<'d> {
        TomlField {
            key: key.get_ref(),
            key_span: key.span(),
            span: value.span(),
            place: self.place.clone(),
            value: value.get_ref(),
        }
    }
}

impl<'d> TomlField<'d> {
    /// "`key` of place".
    pub(crate) fn what(&self) -> String {
        format!("`{}` of {}", self.key, self.place)
    }

    pub(crate) fn text(&self) -> Result<&'d str> {
        self.as_text().ok_or_else(|| self.wrong_type("a string"))
    }

    pub(crate) fn as_text(&self) -> Option<&'d str> {
        self.value.as_str()
    }

    pub(crate) fn is_number(&self) -> bool {
        matches!(self.value, DeValue::Integer(_) | DeValue::Float(_))
    }

    /// A finite number, whole or not.
    pub(crate) fn number(&self) -> Result<f64> {
        self.number_or("a number")
    }

    /// A finite number; what else could stand here is in `expected`.
    pub(crate) fn number_or(&self, expected: &'static str) -> Result<f64> {
        let (value, text) = match self.value {
            DeValue::Integer(n) if n.radix() == 10 => (n.as_str().parse().ok(), n.as_str()),
            DeValue::Integer(n) => (u64::from_str_radix(n.as_str(), n.radix()).ok().map(|n| n as f64), n.as_str()),
            DeValue::Float(x) => (x.as_str().parse().ok(), x.as_str()),
            _ => return Err(self.wrong_type(expected)),
        };
        value.filter(|x: &f64| x.is_finite()).ok_or_else(|| {
            SpecError::new(SpecProblem::NotFinite { what: self.what(), found: text.to_owned() }).at(self.span.clone())
        })
    }

    pub(crate) fn truth(&self) -> Result<bool> {
        self.value.as_bool().ok_or_else(|| self.wrong_type("`true` or `false`"))
    }

    /// The table that stands here, under a name of its own.
    pub(crate) fn section(&self, place: impl Into<String>) -> Result<TomlTable<'d>> {
        match self.value {
            DeValue::Table(table) => Ok(TomlTable::open(place, self.span.clone(), table)),
            _ => Err(self.wrong_type("a table")),
        }
    }

    pub(crate) fn is_table(&self) -> bool {
        self.value.is_table()
    }

    /// The items of an array, each a field under this key.
    pub(crate) fn items(&self, expected: &'static str) -> Result<Vec<TomlField<'d>>> {
        let DeValue::Array(array) = self.value else { return Err(self.wrong_type(expected)) };
        Ok(array
            .iter()
            .map(|item| TomlField {
                span: item.span(),
                value: item.get_ref(),
                place: self.place.clone(),
                ..self.clone()
            })
            .collect())
    }

    /// The texts of an array.
    pub(crate) fn texts(&self) -> Result<Vec<(&'d str, Span)>> {
        let expected = "an array of strings";
        self.items(expected)?
            .iter()
            .map(|item| Ok((item.as_text().ok_or_else(|| item.wrong_type(expected))?, item.span.clone())))
            .collect()
    }

    pub(crate) fn wrong_type(&self, expected: &'static str) -> SpecError {
        let found = match self.value {
            DeValue::String(_) => "a string",
            DeValue::Integer(_) | DeValue::Float(_) => "a number",
            DeValue::Boolean(_) => "a truth value",
            DeValue::Datetime(_) => "a date or time",
            DeValue::Array(_) => "an array",
            DeValue::Table(_) => "a table",
        };
        SpecError::new(SpecProblem::WrongType { key: self.key.to_owned(), place: self.place.clone(), found, expected })
            .at(self.span.clone())
            .label(format!("expected {expected}"))
    }

    pub(crate) fn no_effect(&self, why: &str) -> SpecError {
        SpecError::new(SpecProblem::NoEffect { key: self.key.to_owned(), why: why.to_owned() })
            .at(self.key_span.clone())
    }

    /// The word that stands here, which must be one of `words`; its index.
    pub(crate) fn word(&self, words: &[&str]) -> Result<usize> {
        let found = self.text()?;
        words.iter().position(|word| *word == found).ok_or_else(|| {
            SpecError::new(SpecProblem::UnknownWord {
                what: self.key.to_owned(),
                place: self.place.clone(),
                found: found.to_owned(),
                expected: either(words),
            })
            .at(self.span.clone())
            .maybe_hint(suggest(found, words.iter().copied()))
        })
    }
}
