//! Columns of lists, whichever way Arrow lays them out.

use std::ops::Range;

use arrow_array::cast::AsArray;
use arrow_array::{Array, ArrayRef};
use arrow_schema::ArrowError;
use arrow_schema::DataType;

use crate::table::arrays::{NumberArray, is_numeric};
use crate::table::strings::{StringColumn, is_text};

/// A column of lists of numbers.
pub(super) struct NumberLists {
    rows: Vec<Option<Range<usize>>>,
    /// Elements of all lists; NaN where null.
    values: Vec<f64>,
    /// They were written with 24 bits, not 53.
    single: bool,
}

/// A column of lists of texts.
pub(super) struct TextLists {
    rows: Vec<Option<Range<usize>>>,
    /// Elements of all lists; none when all lists are empty.
    texts: Option<StringColumn>,
}

/// The type of the elements of a list; `None` for other types.
fn element(data_type: &DataType) -> Option<&DataType> {
    match data_type {
        DataType::List(field) | DataType::LargeList(field) | DataType::FixedSizeList(field, _) => {
            Some(field.data_type())
        }
        _ => None,
    }
}

/// True for lists of numbers.
pub(super) fn is_numbers(data_type: &DataType) -> bool {
    element(data_type).is_some_and(|element| is_numeric(element) && *element != DataType::Boolean)
}

/// True for lists of texts.
pub(super) fn is_words(data_type: &DataType) -> bool {
    element(data_type).is_some_and(|element| is_text(element) || *element == DataType::Null)
}

/// Where the list of each row stands among the values of all; `None` for a missing one.
type ListRanges = (Vec<Option<Range<usize>>>, ArrayRef);

/// Elements of each row, and all elements.
fn parts(array: &dyn Array) -> Result<ListRanges, ArrowError> {
    let rows = |ranges: &dyn Fn(usize) -> Range<usize>| -> Vec<Option<Range<usize>>> {
        (0..array.len()).map(|row| array.is_valid(row).then(|| ranges(row))).collect()
    };
    if let Some(list) = array.as_list_opt::<i32>() {
        let at = |row: usize| list.value_offsets()[row] as usize..list.value_offsets()[row + 1] as usize;
        Ok((rows(&at), list.values().clone()))
    } else if let Some(list) = array.as_list_opt::<i64>() {
        let at = |row: usize| list.value_offsets()[row] as usize..list.value_offsets()[row + 1] as usize;
        Ok((rows(&at), list.values().clone()))
    } else if let Some(list) = array.as_fixed_size_list_opt() {
        let size = list.value_length().max(0) as usize;
        let first = if list.is_empty() { 0 } else { list.value_offset_at(0) };
        Ok((rows(&|row| first + row * size..first + (row + 1) * size), list.values().clone()))
    } else {
        Err(ArrowError::CastError(format!("{} is no list", array.data_type())))
    }
}

impl NumberLists {
    pub(super) fn new(array: &dyn Array) -> Result<NumberLists, ArrowError> {
        let (rows, values) = parts(array)?;
        let single = matches!(values.data_type(), DataType::Float16 | DataType::Float32);
        let values = match NumberArray::new(&values)? {
            NumberArray::Values(values) => values,
            NumberArray::Texts(_) => return Err(ArrowError::CastError("texts are no numbers".to_owned())),
        };
        Ok(NumberLists { rows, values, single })
    }

    /// The list in a row, with NaN for null elements; `None` when it is null.
    pub(super) fn get(&self, row: usize) -> Option<&[f64]> {
        self.values.get(self.rows[row].clone()?)
    }

    /// The numbers have the precision of single floats.
    pub(super) fn is_single(&self) -> bool {
        self.single
    }
}

impl TextLists {
    pub(super) fn new(array: &dyn Array) -> Result<TextLists, ArrowError> {
        let (rows, values) = parts(array)?;
        Ok(TextLists { rows, texts: StringColumn::new(&values) })
    }

    /// True when the list in a row is this one and has no null element.
    pub(super) fn are(&self, row: usize, expected: &[String]) -> bool {
        let Some(range) = self.rows[row].clone() else { return false };
        let found = |at: usize| self.texts.as_ref().and_then(|texts| texts.get(at));
        range.len() == expected.len() && range.zip(expected).all(|(at, name)| found(at) == Some(name))
    }

    /// The list in a row, without its null elements; `None` when it is null.
    pub(super) fn get(&self, row: usize) -> Option<Vec<&str>> {
        let range = self.rows[row].clone()?;
        let Some(texts) = &self.texts else { return Some(Vec::new()) };
        Some(range.filter_map(|at| texts.get(at)).collect())
    }
}
