//! Columns of record batches, read as numbers, times and texts.

use std::fmt::Write;
use std::ops::Range;

use arrow_array::cast::AsArray;
use arrow_array::types::{Date32Type, Float64Type};
use arrow_array::{Array, BooleanArray, Float32Array, Float64Array, Int64Array, UInt64Array};
use arrow_schema::ArrowError;
use arrow_schema::{DataType, TimeUnit};

use super::convert::{decimal_texts, to_f32, to_f64, to_i64, to_u64, unpacked};
use super::strings::{StringColumn, is_text};
use crate::fill::change;
use crate::moment::{Moment, date_text};

const DAY: i128 = 86_400_000_000_000;

/// True for types that hold numbers.
pub(crate) fn is_numeric(data_type: &DataType) -> bool {
    match data_type {
        DataType::Boolean | DataType::Null => true,
        DataType::Decimal32(..) | DataType::Decimal64(..) | DataType::Decimal128(..) | DataType::Decimal256(..) => true,
        DataType::Dictionary(_, values) => values.is_numeric(),
        other => other.is_numeric(),
    }
}

/// True for types that hold dates and times of day.
fn is_temporal(data_type: &DataType) -> bool {
    matches!(data_type, DataType::Timestamp(..) | DataType::Date32 | DataType::Date64)
}

/// A numeric column of a batch.
pub(crate) enum NumberArray {
    /// Values; nulls are NaN.
    Values(Vec<f64>),
    /// Texts, to be read as in a CSV file.
    Texts(StringColumn),
}

/// The time column of a batch.
pub(crate) enum TimeArray {
    /// Numbers or texts.
    Numbers(NumberArray),
    /// Dates and timestamps; None where null.
    Moments(Vec<Option<Moment>>),
}

/// A text column of a batch.
pub(crate) enum TextArray {
    Strings(StringColumn),
    Signed(Int64Array),
    Unsigned(UInt64Array),
    Single(Float32Array),
    Double(Float64Array),
    Boolean(BooleanArray),
    /// Printed decimals, with their trailing zeros.
    Decimal(StringColumn),
    Dates(Vec<Option<i64>>),
    Moments(Vec<Option<Moment>>),
    Nothing,
}

impl NumberArray {
    /// Shape: one value a row.
    pub(crate) fn new(array: &dyn Array) -> Result<NumberArray, ArrowError> {
        if let Some(strings) = StringColumn::new(array) {
            return Ok(NumberArray::Texts(strings));
        }
        if *array.data_type() == DataType::Null {
            return Ok(NumberArray::Values(vec![f64::NAN; array.len()]));
        }
        let values = to_f64(array)?;
        Ok(NumberArray::Values(match values.null_count() {
            0 => values.values().to_vec(),
            _ => values.iter().map(|value| value.unwrap_or(f64::NAN)).collect(),
        }))
    }
}

impl TimeArray {
    /// Shape: one value a row.
    pub(crate) fn new(array: &dyn Array) -> Result<TimeArray, ArrowError> {
        Ok(match moments(array)? {
            Some(moments) => TimeArray::Moments(moments),
            None => TimeArray::Numbers(NumberArray::new(array)?),
        })
    }
}

impl TextArray {
    /// Shape: one text a row.
    pub(crate) fn new(array: &dyn Array) -> Result<TextArray, ArrowError> {
        if let Some(strings) = StringColumn::new(array) {
            return Ok(TextArray::Strings(strings));
        }
        Ok(match array.data_type() {
            DataType::Dictionary(..) => return TextArray::new(&unpacked(array)?),
            DataType::Null => TextArray::Nothing,
            DataType::Boolean => TextArray::Boolean(array.as_boolean().clone()),
            DataType::Float16 | DataType::Float32 => TextArray::Single(to_f32(array)?),
            DataType::Float64 => TextArray::Double(array.as_primitive::<Float64Type>().clone()),
            DataType::Date32 => {
                TextArray::Dates(array.as_primitive::<Date32Type>().iter().map(|day| day.map(i64::from)).collect())
            }
            DataType::UInt8 | DataType::UInt16 | DataType::UInt32 | DataType::UInt64 => {
                TextArray::Unsigned(to_u64(array)?)
            }
            other if other.is_integer() => TextArray::Signed(to_i64(array)?),
            other if is_temporal(other) => TextArray::Moments(moments(array)?.unwrap_or_default()),
            _ => TextArray::Decimal(StringColumn::Utf8(decimal_texts(array)?)),
        })
    }

    /// The first row of a range that may have another text than its first one; the end when there is none.
    pub(crate) fn change(&self, rows: Range<usize>) -> usize {
        match self {
            TextArray::Strings(strings) => strings.change(rows),
            TextArray::Signed(array) => change(rows, |row| array.is_valid(row).then(|| array.value(row))),
            TextArray::Unsigned(array) => change(rows, |row| array.is_valid(row).then(|| array.value(row))),
            TextArray::Nothing => rows.end,
            _ => rows.start + 1,
        }
    }

    /// The text in a row, written to `scratch` unless it is one already; None when it is null or not a number.
    pub(crate) fn get<'a>(&'a self, row: usize, scratch: &'a mut String) -> Option<&'a str> {
        scratch.clear();
        let written = match self {
            TextArray::Strings(strings) => return strings.get(row),
            TextArray::Signed(array) => write!(scratch, "{}", array.is_valid(row).then(|| array.value(row))?),
            TextArray::Unsigned(array) => write!(scratch, "{}", array.is_valid(row).then(|| array.value(row))?),
            // Adding zero turns -0 into 0.
            TextArray::Single(array) => write!(scratch, "{}", array.is_valid(row).then(|| array.value(row) + 0.0)?),
            TextArray::Double(array) => write!(scratch, "{}", array.is_valid(row).then(|| array.value(row) + 0.0)?),
            TextArray::Boolean(array) => write!(scratch, "{}", array.is_valid(row).then(|| array.value(row))?),
            TextArray::Decimal(strings) => {
                let text = strings.get(row)?;
                return Some(if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text });
            }
            TextArray::Dates(days) => write!(scratch, "{}", date_text(days[row]?)),
            TextArray::Moments(moments) => write!(scratch, "{}", moments[row]?),
            TextArray::Nothing => return None,
        };
        written.expect("writing to a String cannot fail");
        Some(scratch)
    }
}

/// Dates and timestamps as moments; None for other types.
fn moments(array: &dyn Array) -> Result<Option<Vec<Option<Moment>>>, ArrowError> {
    let (scale, zoned) = match array.data_type() {
        DataType::Timestamp(unit, zone) => (nanoseconds(*unit), zone.is_some()),
        DataType::Date32 => (DAY, false),
        DataType::Date64 => (1_000_000, false),
        _ => return Ok(None),
    };
    let integers = to_i64(array)?;
    let moment = |value: i64| {
        let nanoseconds = i128::from(value) * scale;
        if zoned { Moment::Instant(nanoseconds) } else { Moment::Civil(nanoseconds) }
    };
    Ok(Some(integers.iter().map(|value| value.map(moment)).collect()))
}

fn nanoseconds(unit: TimeUnit) -> i128 {
    match unit {
        TimeUnit::Second => 1_000_000_000,
        TimeUnit::Millisecond => 1_000_000,
        TimeUnit::Microsecond => 1_000,
        TimeUnit::Nanosecond => 1,
    }
}

/// What a use of a column needs, in words, when the type does not do; None when it does.
pub(crate) fn misfit(data_type: &DataType, is_number: bool, is_time: bool, is_text_use: bool) -> Option<&'static str> {
    let textual = is_text(data_type);
    if is_number && !is_numeric(data_type) && !textual {
        return Some("numbers");
    }
    if is_time && !is_numeric(data_type) && !is_temporal(data_type) && !textual {
        return Some("numbers or date-times");
    }
    if is_text_use && !is_numeric(data_type) && !is_temporal(data_type) && !textual {
        return Some("text or numbers");
    }
    None
}
