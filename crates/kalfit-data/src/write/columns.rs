//! The columns of a table that tests are written to, each name once.

use kalfit::{Labels, Layout, Model, Test, TestKey};

use super::error::WriteError;

/// A column and where its cells come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct OutColumn {
    pub(super) name: String,
    pub(super) from: OutCellSource,
}

/// Where cells come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum OutCellSource {
    /// The id of the test, without the groups in these text cells, which have columns of their own.
    Id(Vec<usize>),
    /// A numeric cell.
    Number(usize),
    /// A text cell.
    Text(usize),
}

/// The columns: groups, the id, the time, the model's numbers, its texts. A column that is read both as text and as number is written as
/// the text, which says both. `many`: there are tests that the layout of the model cannot tell apart without a column of ids.
pub(super) fn columns(model: &Model, layout: &Layout, many: bool) -> Vec<OutColumn> {
    let mut columns = groups(model, layout);
    if let Some(name) = id_column(model, layout, many) {
        let before = match layout.test {
            TestKey::Column(_) => {
                columns[..layout.levels.len()].iter().filter_map(|column| column.from.text()).collect()
            }
            TestKey::Single | TestKey::File | TestKey::Row => Vec::new(),
        };
        columns.push(OutColumn { name, from: OutCellSource::Id(before) });
    }
    let texts: Vec<&str> = model.text_columns.iter().map(|column| column.name.as_str()).collect();
    let mut numbers: Vec<usize> = (0..model.columns.len()).collect();
    numbers.sort_by_key(|&index| model.clock.time != Some(index));
    let numbers = numbers.into_iter().map(|index| {
        let name = &model.columns[index].name;
        let text = texts.iter().position(|text| text == name);
        (name, text.map_or(OutCellSource::Number(index), OutCellSource::Text))
    });
    let texts = model.text_columns.iter().enumerate().map(|(index, column)| (&column.name, OutCellSource::Text(index)));
    for (name, from) in numbers.chain(texts) {
        if columns.iter().all(|column| column.name != *name) {
            columns.push(OutColumn { name: name.clone(), from });
        }
    }
    columns
}

/// The columns of groups, the outermost first, then those of crossed factors.
fn groups(model: &Model, layout: &Layout) -> Vec<OutColumn> {
    let column = |name: &String| {
        let index = model.text_columns.iter().position(|column| column.name == *name)?;
        Some(OutColumn { name: name.clone(), from: OutCellSource::Text(index) })
    };
    layout.levels.iter().chain(&layout.crossed).filter_map(column).collect()
}

impl OutCellSource {
    /// The text cell that it is.
    fn text(&self) -> Option<usize> {
        match self {
            OutCellSource::Text(index) => Some(*index),
            OutCellSource::Id(_) | OutCellSource::Number(_) => None,
        }
    }
}

/// Name of the column of ids; `None` when there is no need of one. Where the layout names none it is `test`, or `test_2` and so on
/// when the model reads a column of that name.
pub(super) fn id_column(model: &Model, layout: &Layout, many: bool) -> Option<String> {
    match &layout.test {
        TestKey::Column(name) => Some(name.clone()),
        TestKey::Single if !many => None,
        TestKey::Row => None,
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
pub(super) fn text<'a>(from: &OutCellSource, test: &'a Test, row: usize, labels: &'a Labels) -> Option<&'a str> {
    let of = |index: usize| Some(test.texts(row)[index]).filter(|label| !label.is_missing()).map(|l| labels.text(l));
    match from {
        OutCellSource::Id(groups) => Some(own_id(&test.id, groups.iter().map(|&index| of(index)))),
        OutCellSource::Text(index) => of(*index),
        OutCellSource::Number(_) => None,
    }
}

/// An id without the groups it begins with, which the reader puts before it; whole where it does not begin with them.
fn own_id<'a>(id: &'a str, mut groups: impl Iterator<Item = Option<&'a str>>) -> &'a str {
    groups.try_fold(id, |rest, group| rest.strip_prefix(group?)?.strip_prefix('/')).unwrap_or(id)
}
