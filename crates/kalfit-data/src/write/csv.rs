//! Tests as CSV.

use std::io::Write;

use kalfit::{Labels, Test};

use super::columns::{OutCellSource, OutColumn, text};
use super::error::WriteError;

/// Writes CSV with a header. Numbers are in the shortest form that reads back the same; missing cells are empty.
pub(super) struct CsvTestWriter<W: Write> {
    writer: csv::Writer<W>,
}

impl<W: Write> CsvTestWriter<W> {
    pub(super) fn new(mut sink: W, delimiter: u8, columns: &[OutColumn]) -> Result<CsvTestWriter<W>, WriteError> {
        header(&mut sink, delimiter, columns.iter().map(|column| column.name.as_str()))?;
        Ok(CsvTestWriter { writer: csv::WriterBuilder::new().delimiter(delimiter).from_writer(sink) })
    }

    pub(super) fn write(&mut self, columns: &[OutColumn], test: &Test, labels: &Labels) -> Result<(), WriteError> {
        for row in 0..test.rows() {
            for column in columns {
                let cell = match &column.from {
                    OutCellSource::Number(index) => self.writer.write_field(number(test.numbers(row)[*index])),
                    from => self.writer.write_field(text(from, test, row, labels).unwrap_or_default()),
                };
                cell.map_err(failed)?;
            }
            self.writer.write_record(None::<&[u8]>).map_err(failed)?;
        }
        Ok(())
    }

    pub(super) fn finish(self) -> Result<W, WriteError> {
        self.writer.into_inner().map_err(|error| WriteError::Io(error.into_error()))
    }
}

/// The reader takes the most frequent delimiter outside quotes: a name with any delimiter in it needs quotes.
pub(super) fn header<'a>(
    sink: &mut impl Write,
    delimiter: u8,
    names: impl Iterator<Item = &'a str>,
) -> std::io::Result<()> {
    let quoted = |name: &str| match name.contains([',', ';', '\t', '"', '\n', '\r']) {
        true => format!("\"{}\"", name.replace('"', "\"\"")),
        false => name.to_owned(),
    };
    let names: Vec<String> = names.map(quoted).collect();
    writeln!(sink, "{}", names.join(&char::from(delimiter).to_string()))
}

/// What the csv library says, as an error of the system: nothing but writing can fail here.
pub(super) fn failed(error: csv::Error) -> WriteError {
    WriteError::Io(error.into())
}

/// The shortest text that reads back the same; empty for a missing cell.
pub(super) fn number(value: f64) -> String {
    let size = value.abs();
    match value {
        x if x.is_nan() => String::new(),
        x if x == 0.0 || (1e-5..1e16).contains(&size) => format!("{x}"),
        x => format!("{x:e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_back_bit_for_bit() {
        for x in [0.1, -0.0, 1.0 / 3.0, 1e300, -5e-324, 123456789.0, 1e16, f64::MAX, 9.99e-6] {
            let text = number(x);
            let back: f64 = text.parse().expect("a number");
            assert_eq!(back.to_bits(), x.to_bits(), "{x:e} is written {text}");
            assert!(text.len() < 26, "{text}");
        }
        assert_eq!(number(f64::NAN), "");
    }
}
