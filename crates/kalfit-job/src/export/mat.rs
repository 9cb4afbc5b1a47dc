//! Variables of Matlab: a MAT-file of level 5, not compressed. Format: "MAT-File Format", The MathWorks, chapter 1.
//!
//! Numbers are matrices of doubles, column after column; a text is a row of characters, a list of names a column of cells.

use kalfit::record::ExportRecord;

use super::fields::{FieldValue, fields};

/// Types of data.
const INT8: u32 = 1;
const INT32: u32 = 5;
const UINT32: u32 = 6;
const DOUBLE: u32 = 9;
const MATRIX: u32 = 14;
/// Of all encodings the one that Matlab, Octave and scipy read alike.
const UTF8: u32 = 16;
/// Classes of arrays.
const CELLS: u32 = 1;
const CHARACTERS: u32 = 4;
const DOUBLES: u32 = 6;

/// The file.
pub(super) fn file(record: &ExportRecord) -> Vec<u8> {
    let mut bytes = format!("MATLAB 5.0 MAT-file, written by kalfit {}", record.kalfit_version).into_bytes();
    bytes.resize(116, b' ');
    bytes.extend([0; 8]); // no data of subsystems
    bytes.extend(0x0100_u16.to_le_bytes());
    bytes.extend(b"IM"); // little end first
    for (name, value) in fields(record) {
        bytes.extend(variable(name, &value));
    }
    bytes
}

fn variable(name: &str, value: &FieldValue<'_>) -> Vec<u8> {
    match value {
        FieldValue::Number(x) => doubles(name, (1, 1), &[*x]),
        FieldValue::Vector(all) => doubles(name, (all.len(), 1), all),
        FieldValue::Matrix(rows, columns, all) => doubles(name, (*rows, *columns), all),
        FieldValue::Text(text) => characters(name, text),
        FieldValue::Texts(all) => {
            let cells: Vec<u8> = all.iter().flat_map(|text| characters("", text)).collect();
            array((name, CELLS), (all.len(), 1), &cells)
        }
    }
}

/// `values`: row after row.
fn doubles(name: &str, (rows, columns): (usize, usize), values: &[f64]) -> Vec<u8> {
    let places = (0..columns).flat_map(|column| (0..rows).map(move |row| row * columns + column));
    let values: Vec<u8> = places.flat_map(|place| values[place].to_le_bytes()).collect();
    array((name, DOUBLES), (rows, columns), &element(DOUBLE, &values))
}

fn characters(name: &str, text: &str) -> Vec<u8> {
    let length = text.chars().count();
    array((name, CHARACTERS), (usize::from(length > 0), length), &element(UTF8, text.as_bytes()))
}

fn array((name, class): (&str, u32), (rows, columns): (usize, usize), contents: &[u8]) -> Vec<u8> {
    let flags: Vec<u8> = [class, 0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let shape: Vec<u8> = [rows as i32, columns as i32].iter().flat_map(|x| x.to_le_bytes()).collect();
    let parts = [element(UINT32, &flags), element(INT32, &shape), element(INT8, name.as_bytes()), contents.to_vec()];
    element(MATRIX, &parts.concat())
}

/// A tag, the data, and zeros up to the next eight bytes.
fn element(kind: u32, data: &[u8]) -> Vec<u8> {
    let mut bytes: Vec<u8> = [kind, data.len() as u32].iter().flat_map(|x| x.to_le_bytes()).collect();
    bytes.extend(data);
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_stands_column_after_column() {
        let bytes = doubles("F", (2, 3), &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        // tag, flags, shape, name, tag of the numbers
        let numbers: Vec<f64> =
            bytes[64..].chunks(8).map(|eight| f64::from_le_bytes(eight.try_into().expect("eight bytes"))).collect();
        assert_eq!(numbers, [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
        assert_eq!(bytes[4..8], (bytes.len() as u32 - 8).to_le_bytes());
    }
}
