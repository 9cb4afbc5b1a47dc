//! CSV files.

use std::io::{self, Cursor, Read};

use csv::{ByteRecord, Reader, ReaderBuilder, Terminator};
use kalfit::{Label, Labels};

use super::LastLabel;
use crate::error::DataError;
use crate::row::Row;
use crate::wanted::Wanted;

/// A CSV file, row by row.
pub(crate) struct CsvTable<'a> {
    file: &'a str,
    wanted: &'a Wanted,
    reader: Reader<Limited<'a>>,
    record: ByteRecord,
    /// Position of each wanted column.
    positions: Vec<usize>,
    /// Number of cells of the header.
    width: usize,
    /// Label of the text last seen in each wanted column.
    last: Vec<LastLabel>,
}

/// Stands after the last byte of the file as a row of its own. If it ends up inside a cell, a quote was not closed: the
/// csv library says nothing of that, and the rest of the file would vanish in one cell.
const END: &[u8] = b"\0end of file\0";

/// Longest row that is read.
const ROW_LIMIT: u64 = 64 << 20;

/// Longest part of the header line that is looked at for the delimiter.
const SNIFF_LIMIT: usize = 1 << 20;

impl<'a> CsvTable<'a> {
    /// Reads the header. With `tab` the delimiter is known to be the tab.
    pub(super) fn open(
        file: &'a str,
        mut bytes: impl Read + 'a,
        tab: bool,
        wanted: &'a Wanted,
    ) -> Result<CsvTable<'a>, DataError> {
        let start = header_line(&mut bytes).map_err(|source| DataError::Io { file: file.to_owned(), source })?;
        if start.starts_with(b"\xff\xfe") || start.starts_with(b"\xfe\xff") {
            return Err(DataError::NotUtf8 { file: file.to_owned(), row: 1, column: None });
        }
        let start = start.strip_prefix(b"\xef\xbb\xbf").map(<[u8]>::to_vec).unwrap_or(start);
        let delimiter = if tab { b'\t' } else { sniff(&start) };
        let end = Cursor::new([b"\n", END, b"\n"].concat());
        let bytes = Limited { bytes: Box::new(Cursor::new(start).chain(bytes).chain(end)), left: ROW_LIMIT };
        // Rows end at LF only, so that lines are counted exactly; the CR of a CRLF is taken off the last cell.
        let reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .delimiter(delimiter)
            .terminator(Terminator::Any(b'\n'))
            .buffer_capacity(1 << 16)
            .from_reader(bytes);
        let last = wanted.columns.iter().map(|_| LastLabel::default()).collect();
        let mut table =
            CsvTable { file, wanted, reader, record: ByteRecord::new(), positions: Vec::new(), width: 0, last };
        table.read_header()?;
        Ok(table)
    }

    /// Bytes of the rows so far.
    pub(crate) fn read(&self) -> u64 {
        self.reader.position().byte()
    }

    fn read_header(&mut self) -> Result<(), DataError> {
        let Some((row, _)) = self.advance()? else {
            return Err(DataError::Empty { file: self.file.to_owned() });
        };
        self.width = self.record.len();
        let mut names = Vec::with_capacity(self.width);
        for position in 0..self.width {
            let name = std::str::from_utf8(cell(&self.record, position)).map_err(|_| DataError::NotUtf8 {
                file: self.file.to_owned(),
                row,
                column: None,
            })?;
            if name.contains('\r') {
                return Err(DataError::CarriageReturns { file: self.file.to_owned() });
            }
            names.push(name);
        }
        self.positions = self.wanted.positions(self.file, &names)?;
        Ok(())
    }

    /// Reads the next row that is not blank: the line where it begins and the number of its lines.
    fn advance(&mut self) -> Result<Option<(u64, u64)>, DataError> {
        let mut blank = None;
        loop {
            let before = self.reader.position().line();
            self.reader.get_mut().left = ROW_LIMIT;
            let found = self.reader.read_byte_record(&mut self.record);
            if !found.map_err(|error| self.failed(error, before))? {
                return Ok(None);
            }
            let after = self.reader.position().line();
            let lines = if after - before == 1 { 1 } else { 1 + count_lf(self.record.as_slice()) };
            let row = after - lines;
            if row > before {
                blank = blank.or(Some(before));
            }
            if self.record.as_slice().ends_with(END) && self.record.len() == 1 && &self.record[0] == END {
                return Ok(None);
            }
            if self.record.as_slice().ends_with(b"\0\n") && self.record.as_slice().trim_ascii_end().ends_with(END) {
                // No line end stands after an open cell: all are in it.
                return Err(DataError::OpenQuote { file: self.file.to_owned(), row: row + 1 });
            }
            if self.record.len() == 1 && &self.record[0] == b"\r" {
                blank = blank.or(Some(row));
                continue;
            }
            return match blank {
                Some(row) if self.width == 1 => Err(DataError::BlankRow { file: self.file.to_owned(), row }),
                _ => Ok(Some((row, lines))),
            };
        }
    }

    fn failed(&self, error: csv::Error, row: u64) -> DataError {
        let file = self.file.to_owned();
        let source = match error.into_kind() {
            csv::ErrorKind::Io(source) => source,
            other => io::Error::new(io::ErrorKind::InvalidData, format!("{other:?}")),
        };
        if self.reader.get_ref().left == 0 {
            return DataError::LongRow { file, row, limit: ROW_LIMIT };
        }
        DataError::Io { file, source }
    }

    /// Reads the next row; false at the end.
    pub(super) fn next(&mut self, row: &mut Row, labels: &mut Labels) -> Result<bool, DataError> {
        let Some((line, lines)) = self.advance()? else { return Ok(false) };
        if self.record.len() != self.width {
            return Err(DataError::RowLength {
                file: self.file.to_owned(),
                row: line,
                found: self.record.len(),
                expected: self.width,
                lines,
            });
        }
        row.number = line;
        let (file, tokens) = (self.file, &self.wanted.tokens);
        for ((column, &position), last) in self.wanted.columns.iter().zip(&self.positions).zip(&mut self.last) {
            let cell = cell(&self.record, position);
            if column.is_number() {
                let value = tokens.number(cell).map_err(|fault| column.fault(fault, file, line, cell))?;
                column.numbers.iter().for_each(|&number| row.numbers[number] = value);
            }
            if column.is_time {
                row.time = Some(column.moment(tokens, file, line, cell)?);
            }
            if column.is_text() {
                let missing = tokens.is_missing(cell);
                let text = std::str::from_utf8(cell).map_err(|_| column.not_utf8(file, line))?;
                if column.is_test {
                    if missing {
                        return Err(DataError::MissingTest { at: column.place(file, line) });
                    }
                    row.set_id(text);
                }
                if !column.texts.is_empty() {
                    let label = if missing { Label::MISSING } else { last.label(text, labels) };
                    column.texts.iter().for_each(|&index| row.texts[index] = label);
                }
            }
        }
        Ok(true)
    }
}

/// A cell of a record, without the CR of the line's end.
fn cell(record: &ByteRecord, position: usize) -> &[u8] {
    let cell = record.get(position).unwrap_or_default();
    if position + 1 == record.len() { cell.strip_suffix(b"\r").unwrap_or(cell) } else { cell }
}

fn count_lf(bytes: &[u8]) -> u64 {
    bytes.iter().filter(|&&byte| byte == b'\n').count() as u64
}

/// The bytes up to the end of the first line that is not blank (or a little further).
fn header_line(bytes: &mut impl Read) -> io::Result<Vec<u8>> {
    let (mut start, mut scanned, mut quoted, mut text) = (Vec::new(), 0, false, false);
    while start.len() < SNIFF_LIMIT {
        if bytes.take(1 << 13).read_to_end(&mut start)? == 0 {
            break;
        }
        for &byte in &start[scanned..] {
            quoted ^= byte == b'"';
            if byte == b'\n' && !quoted && text {
                return Ok(start);
            }
            text |= !byte.is_ascii_whitespace();
        }
        scanned = start.len();
    }
    Ok(start)
}

/// The delimiter: whichever occurs most often outside quotes in the first line that is not blank.
fn sniff(start: &[u8]) -> u8 {
    let (mut counts, mut quoted, mut text) = ([0; 3], false, false);
    for &byte in start {
        match byte {
            b'"' => quoted = !quoted,
            b'\n' if !quoted && text => break,
            b',' if !quoted => counts[0] += 1,
            b';' if !quoted => counts[1] += 1,
            b'\t' if !quoted => counts[2] += 1,
            _ => {}
        }
        text |= !byte.is_ascii_whitespace();
    }
    match counts {
        [comma, semicolon, tab] if comma >= semicolon && comma >= tab => b',',
        [_, semicolon, tab] if semicolon >= tab => b';',
        _ => b'\t',
    }
}

/// Bytes with an end to patience: a row that never ends would fill the memory.
struct Limited<'a> {
    bytes: Box<dyn Read + 'a>,
    left: u64,
}

impl Read for Limited<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.left == 0 {
            return Err(io::ErrorKind::InvalidData.into());
        }
        let read = self.bytes.read(buffer)?;
        self.left = self.left.saturating_sub(read as u64);
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_delimiter_is_the_commonest_outside_quotes_in_the_header() {
        for (header, expected) in [
            ("a,b\n1;2;3;4\n", b','),
            ("a;b;\"x,y,z,w\"\n", b';'),
            ("\n\na\tb\tc,d\n", b'\t'),
            ("a;b,c\n", b','),
            ("alone", b','),
        ] {
            assert_eq!(char::from(sniff(header.as_bytes())), char::from(expected), "{header}");
        }
    }
}
