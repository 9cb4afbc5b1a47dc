//! Arrays of numpy: a `.npy` for each value, in a zip archive that is not compressed.
//! Format: <https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>, version 1.0.

use kalfit::record::ExportRecord;

use super::fields::{FieldValue, fields};
use super::zip::ZipArchive;

/// The file.
pub(super) fn file(record: &ExportRecord) -> Vec<u8> {
    let mut archive = ZipArchive::default();
    for (name, value) in fields(record) {
        archive.add(&format!("{name}.npy"), &array(&value));
    }
    archive.finish()
}

/// One array, row-major.
fn array(value: &FieldValue<'_>) -> Vec<u8> {
    match value {
        FieldValue::Number(x) => numbers(&[], &[*x]),
        FieldValue::Vector(all) => numbers(&[all.len()], all),
        FieldValue::Matrix(rows, columns, all) => numbers(&[*rows, *columns], all),
        FieldValue::Text(text) => texts(&[], &[text]),
        FieldValue::Texts(all) => texts(&[all.len()], all),
    }
}

fn numbers(shape: &[usize], values: &[f64]) -> Vec<u8> {
    let mut bytes = header("<f8", shape);
    values.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    bytes
}

/// Unicode of a fixed width, the longest text's.
fn texts(shape: &[usize], all: &[&str]) -> Vec<u8> {
    let width = all.iter().map(|text| text.chars().count()).max().unwrap_or(0).max(1);
    let mut bytes = header(&format!("<U{width}"), shape);
    for text in all {
        let letters = text.chars().map(u32::from).chain(std::iter::repeat(0)).take(width);
        letters.for_each(|letter| bytes.extend(letter.to_le_bytes()));
    }
    bytes
}

/// Magic, version, and a dictionary that ends where 64 bytes do.
fn header(kind: &str, shape: &[usize]) -> Vec<u8> {
    let shape: String = shape.iter().map(|length| format!("{length},")).collect();
    let mut words = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    let before = 10;
    while (before + words.len() + 1) % 64 != 0 {
        words.push(' ');
    }
    words.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((words.len() as u16).to_le_bytes());
    bytes.extend(words.as_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_has_the_header_of_the_format() {
        let bytes = array(&FieldValue::Matrix(1, 2, vec![1.5, -2.0]));
        assert_eq!(&bytes[..10], b"\x93NUMPY\x01\x00\x76\x00");
        assert!(bytes[10..].starts_with(b"{'descr': '<f8', 'fortran_order': False, 'shape': (1,2,), }"));
        assert_eq!((bytes.len(), bytes[127]), (128 + 16, b'\n'));
        assert_eq!(&bytes[128..136], &1.5_f64.to_le_bytes());
        assert_eq!(array(&FieldValue::Texts(vec!["µ", "rate"])).len(), 128 + 2 * 4 * 4);
    }
}
