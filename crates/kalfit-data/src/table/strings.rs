//! Columns of text, whichever way Arrow lays them out.

use std::ops::Range;

use arrow_array::cast::AsArray;
use arrow_array::{Array, ArrayRef, LargeStringArray, StringArray, StringViewArray};
use arrow_schema::DataType;

use crate::fill::change;

/// A column of text. Texts are looked at in place: a dictionary or view may show one long text in every row.
pub(crate) enum StringColumn {
    Utf8(StringArray),
    Large(LargeStringArray),
    View(StringViewArray),
    Dictionary { keys: ArrayRef, index: Vec<usize>, values: Box<StringColumn> },
}

/// True for types that [`StringColumn`] can show.
pub(crate) fn is_text(data_type: &DataType) -> bool {
    match data_type {
        DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View => true,
        DataType::Dictionary(_, values) => {
            matches!(**values, DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View)
        }
        _ => false,
    }
}

impl StringColumn {
    /// The texts of an array; None when it is of another type.
    pub(crate) fn new(array: &dyn Array) -> Option<StringColumn> {
        Some(match array.data_type() {
            DataType::Utf8 => StringColumn::Utf8(array.as_string::<i32>().clone()),
            DataType::LargeUtf8 => StringColumn::Large(array.as_string::<i64>().clone()),
            DataType::Utf8View => StringColumn::View(array.as_string_view().clone()),
            DataType::Dictionary(_, values) if is_text(values) && is_text(array.data_type()) => {
                let dictionary = array.as_any_dictionary_opt()?;
                let index = if dictionary.values().is_empty() { Vec::new() } else { dictionary.normalized_keys() };
                let values = Box::new(StringColumn::new(dictionary.values())?);
                StringColumn::Dictionary { keys: arrow_array::make_array(dictionary.keys().to_data()), index, values }
            }
            _ => return None,
        })
    }

    /// The text in a row; None when it is null.
    pub(crate) fn get(&self, row: usize) -> Option<&str> {
        match self {
            StringColumn::Utf8(array) => array.is_valid(row).then(|| array.value(row)),
            StringColumn::Large(array) => array.is_valid(row).then(|| array.value(row)),
            StringColumn::View(array) => array.is_valid(row).then(|| array.value(row)),
            StringColumn::Dictionary { keys, index, values } if keys.is_valid(row) => values.get(*index.get(row)?),
            StringColumn::Dictionary { .. } => None,
        }
    }
    /// The first row of a range that may have another text than its first one; the end when there is none.
    pub(crate) fn change(&self, rows: Range<usize>) -> usize {
        match self {
            StringColumn::Dictionary { keys, index, .. } => {
                change(rows, |row| keys.is_valid(row).then(|| index.get(row)).flatten())
            }
            _ => change(rows, |row| self.get(row)),
        }
    }
}
