//! The columns of a table that tests are written to, each name once.

use kalfit::{Labels, Layout, Model, Test, TestKey};

use super::error::WriteError;

/// A column and where its cells come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct OutColumn {
    pub(super) name: String,
    pub(super) from: From,
}

/// Where cells come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum From {
    /// The id of the test.
    Id,
    /// A numeric cell.
    Number(usize),
    /// A text cell.
    Text(usize),
}

/// The columns: the id, the time, the model's numbers, its texts. A column that is read both as text and as number is written as
/// the text, which says both. `many`: there are tests that the layout of the model cannot tell apart without a column of ids.
pub(super) fn columns(model: &Model, layout: &Layout, many: bool) -> Vec<OutColumn> {
    let mut columns = Vec::new();
    if let Some(name) = id_column(model, layout, many) {
        columns.push(OutColumn { name, from: From::Id });
    }
    let texts: Vec<&str> = model.text_columns.iter().map(|column| column.name.as_str()).collect();
    let mut numbers: Vec<usize> = (0..model.columns.len()).collect();
    numbers.sort_by_key(|&index| model.clock.time != Some(index));
    let numbers = numbers.into_iter().map(|index| {
        let name = &model.columns[index].name;
        let text = texts.iter().position(|text| text == name);
        (name, text.map_or(From::Number(index), From::Text))
    });
    let texts = model.text_columns.iter().enumerate().map(|(index, column)| (&column.name, From::Text(index)));
    for (name, from) in numbers.chain(texts) {
        if columns.iter().all(|column| column.name != *name) {
            columns.push(OutColumn { name: name.clone(), from });
        }
    }
    columns
}

/// Name of the column of ids; `None` when there is no need of one. Where the layout names none it is `test`, or `test_2` and so on
/// when the model reads a column of that name.
pub(super) fn id_column(model: &Model, layout: &Layout, many: bool) -> Option<String> {
    match &layout.test {
        TestKey::Column(name) => Some(name.clone()),
        TestKey::Single if !many => None,
        TestKey::Single | TestKey::File => {
            let taken = |name: &str| model.columns.iter().chain(&model.text_columns).any(|column| column.name == name);
            let mut names = std::iter::once("test".to_owned()).chain((2_u32..).map(|k| format!("test_{k}")));
            names.find(|name| !taken(name))
        }
    }
}

/// New ids in a column that the model reads otherwise too would change what it reads.
pub(super) fn refuse_id_in_use(model: &Model, layout: &Layout) -> Result<(), WriteError> {
    let TestKey::Column(name) = &layout.test else { return Ok(()) };
    match model.columns.iter().chain(&model.text_columns).find(|column| column.name == *name) {
        Some(column) => Err(WriteError::IdInUse { column: name.clone(), used_in: column.used_in.clone() }),
        None => Ok(()),
    }
}

/// The text of a cell; `None` when it is missing or a number.
pub(super) fn text<'a>(from: From, test: &'a Test, row: usize, labels: &'a Labels) -> Option<&'a str> {
    match from {
        From::Id => Some(&test.id),
        From::Text(index) => Some(test.texts(row)[index]).filter(|label| !label.is_missing()).map(|l| labels.text(l)),
        From::Number(_) => None,
    }
}
