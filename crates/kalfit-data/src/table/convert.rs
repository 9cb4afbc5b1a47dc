//! Columns of any numeric type as columns of one type.
//!
//! Only types that hold numbers, dates or times come here, so that a few loops replace the conversions of all types to all types
//! (docs/decisions/0027-crates.md).

use arrow_array::cast::AsArray;
use arrow_array::types::{
    ArrowPrimitiveType, Date32Type, Date64Type, Decimal32Type, Decimal64Type, Decimal128Type, Decimal256Type,
    DecimalType, Float16Type, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type,
    TimestampMicrosecondType, TimestampMillisecondType, TimestampNanosecondType, TimestampSecondType, UInt8Type,
    UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, Float32Array, Float64Array, Int64Array, PrimitiveArray, StringArray, UInt64Array};
use arrow_schema::{ArrowError, DataType, TimeUnit};

/// A column of type `F` as one of type `T`; nulls stay null.
fn converted<F: ArrowPrimitiveType, T: ArrowPrimitiveType>(
    array: &dyn Array,
    value: impl Fn(F::Native) -> T::Native,
) -> PrimitiveArray<T> {
    array.as_primitive::<F>().unary(value)
}

fn cannot<T>(array: &dyn Array, to: &str) -> Result<T, ArrowError> {
    Err(ArrowError::CastError(format!("a column of type {} cannot be read as {to}", array.data_type())))
}

/// The values of a column of a dictionary, row by row.
pub(super) fn unpacked(array: &dyn Array) -> Result<ArrayRef, ArrowError> {
    let dictionary = array.as_any_dictionary();
    arrow_select::take::take(dictionary.values(), dictionary.keys(), None)
}

/// Numbers of any type as `f64`; true is 1, false 0.
pub(super) fn to_f64(array: &dyn Array) -> Result<Float64Array, ArrowError> {
    Ok(match array.data_type() {
        DataType::Float64 => array.as_primitive::<Float64Type>().clone(),
        DataType::Float32 => converted::<Float32Type, _>(array, f64::from),
        DataType::Float16 => converted::<Float16Type, _>(array, f64::from),
        DataType::Int8 => converted::<Int8Type, _>(array, f64::from),
        DataType::Int16 => converted::<Int16Type, _>(array, f64::from),
        DataType::Int32 => converted::<Int32Type, _>(array, f64::from),
        DataType::Int64 => converted::<Int64Type, _>(array, |value| value as f64),
        DataType::UInt8 => converted::<UInt8Type, _>(array, f64::from),
        DataType::UInt16 => converted::<UInt16Type, _>(array, f64::from),
        DataType::UInt32 => converted::<UInt32Type, _>(array, f64::from),
        DataType::UInt64 => converted::<UInt64Type, _>(array, |value| value as f64),
        DataType::Boolean => {
            array.as_boolean().iter().map(|value| value.map(|value| f64::from(u8::from(value)))).collect()
        }
        DataType::Decimal32(_, scale) => {
            let unit = ten_to(*scale);
            converted::<Decimal32Type, _>(array, move |value| f64::from(value) / unit)
        }
        DataType::Decimal64(_, scale) => {
            let unit = ten_to(*scale);
            converted::<Decimal64Type, _>(array, move |value| value as f64 / unit)
        }
        DataType::Decimal128(_, scale) => {
            let unit = ten_to(*scale);
            converted::<Decimal128Type, _>(array, move |value| value as f64 / unit)
        }
        DataType::Decimal256(_, scale) => {
            let unit = ten_to(*scale);
            converted::<Decimal256Type, _>(array, move |value| {
                // the size first: beside 2¹²⁸ the digits of a small negative number would be rounded away
                let (size, sign) = if value.is_negative() { (value.wrapping_neg(), -1.0) } else { (value, 1.0) };
                let (low, high) = size.to_parts();
                sign * (high as f64 * 2.0_f64.powi(128) + low as f64) / unit
            })
        }
        DataType::Dictionary(..) => return to_f64(&unpacked(array)?),
        _ => return cannot(array, "numbers"),
    })
}

fn ten_to(scale: i8) -> f64 {
    10.0_f64.powi(i32::from(scale))
}

/// Numbers of half or single precision as `f32`.
pub(super) fn to_f32(array: &dyn Array) -> Result<Float32Array, ArrowError> {
    Ok(match array.data_type() {
        DataType::Float32 => array.as_primitive::<Float32Type>().clone(),
        DataType::Float16 => converted::<Float16Type, _>(array, f32::from),
        _ => return cannot(array, "numbers of single precision"),
    })
}

/// Signed integers as `i64`; dates and times as the counts that they are stored as.
pub(super) fn to_i64(array: &dyn Array) -> Result<Int64Array, ArrowError> {
    Ok(match array.data_type() {
        DataType::Int64 => array.as_primitive::<Int64Type>().clone(),
        DataType::Int8 => converted::<Int8Type, _>(array, i64::from),
        DataType::Int16 => converted::<Int16Type, _>(array, i64::from),
        DataType::Int32 => converted::<Int32Type, _>(array, i64::from),
        DataType::Date32 => converted::<Date32Type, _>(array, i64::from),
        DataType::Date64 => converted::<Date64Type, _>(array, |value| value),
        DataType::Timestamp(TimeUnit::Second, _) => converted::<TimestampSecondType, _>(array, |value| value),
        DataType::Timestamp(TimeUnit::Millisecond, _) => converted::<TimestampMillisecondType, _>(array, |value| value),
        DataType::Timestamp(TimeUnit::Microsecond, _) => converted::<TimestampMicrosecondType, _>(array, |value| value),
        DataType::Timestamp(TimeUnit::Nanosecond, _) => converted::<TimestampNanosecondType, _>(array, |value| value),
        _ => return cannot(array, "integers"),
    })
}

/// Unsigned integers as `u64`.
pub(super) fn to_u64(array: &dyn Array) -> Result<UInt64Array, ArrowError> {
    Ok(match array.data_type() {
        DataType::UInt64 => array.as_primitive::<UInt64Type>().clone(),
        DataType::UInt8 => converted::<UInt8Type, _>(array, u64::from),
        DataType::UInt16 => converted::<UInt16Type, _>(array, u64::from),
        DataType::UInt32 => converted::<UInt32Type, _>(array, u64::from),
        _ => return cannot(array, "unsigned integers"),
    })
}

/// Decimals as texts, with as many digits behind the point as their scale says.
pub(super) fn decimal_texts(array: &dyn Array) -> Result<StringArray, ArrowError> {
    fn texts<T: DecimalType>(array: &dyn Array) -> StringArray {
        let decimals = array.as_primitive::<T>();
        (0..decimals.len()).map(|row| decimals.is_valid(row).then(|| decimals.value_as_string(row))).collect()
    }
    Ok(match array.data_type() {
        DataType::Decimal32(..) => texts::<Decimal32Type>(array),
        DataType::Decimal64(..) => texts::<Decimal64Type>(array),
        DataType::Decimal128(..) => texts::<Decimal128Type>(array),
        DataType::Decimal256(..) => texts::<Decimal256Type>(array),
        _ => return cannot(array, "decimals"),
    })
}

#[cfg(test)]
mod tests {
    use arrow_array::{Decimal128Array, Decimal256Array, DictionaryArray, Int8Array, Int32Array};
    use arrow_buffer::i256;

    use super::*;

    fn numbers(array: &dyn Array) -> Vec<Option<f64>> {
        to_f64(array).expect("numbers").iter().collect()
    }

    #[test]
    fn decimals_are_numbers_of_either_sign() {
        let expected = [Some(-6.125), None, Some(0.0), Some(41.5)];
        let short = Decimal128Array::from(vec![Some(-6125), None, Some(0), Some(41_500)]);
        let short = short.with_precision_and_scale(9, 3).expect("three places");
        assert_eq!(numbers(&short), expected);
        let long = [Some(-6125), None, Some(0), Some(41_500)].map(|value| value.map(i256::from_i128));
        let long = Decimal256Array::from(long.to_vec()).with_precision_and_scale(50, 3).expect("three places");
        assert_eq!(numbers(&long), expected);
        let large = i256::from_parts(0, -4); // -4 × 2¹²⁸
        let large = Decimal256Array::from(vec![large]).with_precision_and_scale(76, 0).expect("no places");
        assert_eq!(numbers(&large), [Some(-(2.0_f64.powi(130)))]);
        let texts = decimal_texts(&short).expect("decimals");
        assert_eq!(texts.iter().collect::<Vec<_>>(), [Some("-6.125"), None, Some("0.000"), Some("41.500")]);
    }

    #[test]
    fn a_dictionary_is_read_row_by_row() {
        let values = Int32Array::from(vec![Some(7), None, Some(-3)]);
        let keys = Int8Array::from(vec![Some(2), Some(0), None, Some(1)]);
        let dictionary = DictionaryArray::new(keys, std::sync::Arc::new(values));
        assert_eq!(numbers(&dictionary), [Some(-3.0), Some(7.0), None, None]);
    }

    #[test]
    fn what_is_no_number_is_refused_by_its_type() {
        let error = to_f64(&StringArray::from(vec!["a"])).expect_err("no numbers").to_string();
        assert!(error.contains("a column of type Utf8 cannot be read as numbers"), "{error}");
    }
}
