//! Columns of an estimates file that are constants of its tests: what offsets, regressions, levels and `carry` look up.

use arrow_schema::Schema;
use kalfit::{Label, Labels, Layout, PhasedModel, Test, TestKey};

use super::schema::{ColumnShape, ESTIMATES, TEST};
use super::sheet::SheetRow;
use crate::cell::MissingTexts;
use crate::cell::shown;
use crate::error::DataError;

/// In front of the name of a column that would otherwise be one of the schema.
const PREFIX: &str = "constant.";

/// Where the columns of a model stand in a file.
pub(super) struct ConstantColumns {
    /// By numeric column of the model: its name in the file.
    numbers: Vec<Option<String>>,
    /// By text column.
    texts: Vec<TextCellSource>,
    tokens: MissingTexts,
}

/// What fills a text cell.
enum TextCellSource {
    Nothing,
    Column(String),
    /// The id of the test.
    Id,
    /// The phase, whose label it is.
    Phase(Vec<Option<usize>>),
}

/// The name of a model's column in an estimates file.
pub(super) fn name_in_file(name: &str) -> String {
    if ESTIMATES.iter().any(|column| column.name == name) { format!("{PREFIX}{name}") } else { name.to_owned() }
}

/// The numeric columns of a model that can be constants: all but the time.
pub(super) fn numeric(model: &PhasedModel) -> impl Iterator<Item = (usize, &str)> {
    let shared = model.shared();
    let all = shared.columns.iter().enumerate().map(|(index, column)| (index, column.name.as_str()));
    all.filter(|&(index, _)| shared.clock.time != Some(index))
}

/// The text columns of a model that can be constants: all but the phase.
pub(super) fn textual(model: &PhasedModel) -> impl Iterator<Item = (usize, &str)> {
    let all = model.shared().text_columns.iter().enumerate().map(|(index, column)| (index, column.name.as_str()));
    all.filter(|&(index, _)| model.column != Some(index))
}

impl ConstantColumns {
    pub(super) fn new(model: &PhasedModel, layout: &Layout, schema: &Schema) -> ConstantColumns {
        let there = |name: &str| Some(name_in_file(name)).filter(|name| schema.column_with_name(name).is_some());
        let shared = model.shared();
        let mut numbers = vec![None; shared.columns.len()];
        numeric(model).for_each(|(index, name)| numbers[index] = there(name));
        let texts = shared.text_columns.iter().enumerate().map(|(index, column)| {
            if model.column == Some(index) {
                return TextCellSource::Phase(model.phases.iter().map(|phase| phase.label).collect());
            }
            match there(&column.name) {
                Some(name) => TextCellSource::Column(name),
                None if matches!(&layout.test, TestKey::Column(id) if *id == column.name) => TextCellSource::Id,
                None => TextCellSource::Nothing,
            }
        });
        ConstantColumns { numbers, texts: texts.collect(), tokens: MissingTexts::new(&layout.missing) }
    }

    /// The columns to read beside those of the schema.
    pub(super) fn columns(&self, layout: &Layout) -> Vec<(String, ColumnShape)> {
        let texts = self.texts.iter().filter_map(|from| match from {
            TextCellSource::Column(name) => Some((name.clone(), ColumnShape::Text)),
            _ => None,
        });
        // A column that is read both ways is read as text, which holds the number too.
        let mut columns: Vec<(String, ColumnShape)> = texts.collect();
        let numbers = self.numbers.iter().flatten().map(|name| (name.clone(), ColumnShape::Number));
        let id = match &layout.test {
            TestKey::Column(name) if name != TEST => Some((name.clone(), ColumnShape::Text)),
            _ => None,
        };
        for (name, shape) in id.into_iter().chain(numbers) {
            if columns.iter().all(|(other, _)| *other != name) && ESTIMATES.iter().all(|column| column.name != name) {
                columns.push((name, shape));
            }
        }
        columns
    }

    /// A test of one row with the constants of a row.
    pub(super) fn test(
        &self,
        row: SheetRow<'_>,
        (id, phase): (&str, usize),
        at: kalfit::Source,
        labels: &mut Labels,
    ) -> Result<Test, DataError> {
        let mut numbers = Vec::with_capacity(self.numbers.len());
        for name in &self.numbers {
            numbers.push(name.as_ref().map_or(Ok(f64::NAN), |name| self.number(row, name))?);
        }
        let text = |from: &TextCellSource| match from {
            TextCellSource::Nothing => Label::MISSING,
            TextCellSource::Id => labels.intern(id),
            TextCellSource::Phase(names) => names.get(phase).copied().flatten().map_or(Label::MISSING, Label::literal),
            TextCellSource::Column(name) => {
                let text = row.text(name).filter(|text| !self.tokens.is_missing(text.as_bytes()));
                text.map_or(Label::MISSING, |text| labels.intern(&text))
            }
        };
        let texts: Vec<Label> = self.texts.iter().map(text).collect();
        let mut test = Test::new(id, numbers.len(), texts.len());
        test.push(&numbers, &texts, at);
        Ok(test)
    }

    fn number(&self, row: SheetRow<'_>, name: &str) -> Result<f64, DataError> {
        let found = match row.text(name) {
            Some(text) => self.tokens.number(text.as_bytes()).map_err(|fault| (fault, text)),
            None => {
                let value = row.number_or_nan(name);
                self.tokens.finite(value).map_err(|fault| (fault, value.to_string()))
            }
        };
        found.map_err(|(fault, text)| {
            let (at, found) = (row.place(name), shown(text.as_bytes()));
            match fault {
                crate::cell::CellFault::Infinite => DataError::Infinite { at, found },
                _ => DataError::NotANumber { at, found, used_in: "".into() },
            }
        })
    }
}
