//! A chunk of a CSV file into a block.

use std::io::{Chain, Read};

use csv::{ByteRecord, ReaderBuilder, Terminator};
use memchr::memchr_iter;

use super::comment::MARK;
use super::cut::Chunk;
use super::scan::{Cuts, cuts};
use crate::block::{Block, Filler};
use crate::error::DataError;
use crate::wanted::Wanted;

/// What must be known of a file to read its rows.
#[derive(Clone, Copy)]
pub(super) struct Form<'a> {
    pub(super) file: &'a str,
    pub(super) wanted: &'a Wanted,
    pub(super) delimiter: u8,
    /// Number of cells of the header.
    pub(super) width: usize,
    /// The line after the header.
    pub(super) first: u64,
}

/// The cells of a row.
trait Cells {
    fn len(&self) -> usize;

    /// A cell; nothing where there is none.
    fn get(&self, position: usize) -> &[u8];

    /// A cell without the CR of the line's end.
    fn cell(&self, position: usize) -> &[u8] {
        let cell = self.get(position);
        if position + 1 == self.len() { cell.strip_suffix(b"\r").unwrap_or(cell) } else { cell }
    }
}

/// Cells of a row without quotes: where each begins in some bytes, and where one after the last would.
struct Plain<'c> {
    bytes: &'c [u8],
    starts: &'c [u32],
}

impl Cells for Plain<'_> {
    fn len(&self) -> usize {
        self.starts.len() - 1
    }

    fn get(&self, position: usize) -> &[u8] {
        &self.bytes[self.starts[position] as usize..self.starts[position + 1] as usize - 1]
    }
}

impl Cells for ByteRecord {
    fn len(&self) -> usize {
        ByteRecord::len(self)
    }

    fn get(&self, position: usize) -> &[u8] {
        ByteRecord::get(self, position).unwrap_or_default()
    }
}

/// The rows of a chunk. `positions`: of each wanted column.
pub(super) fn block(form: Form<'_>, positions: &[usize], chunk: &Chunk) -> Block {
    // line ends in quotes are no rows, and a row has its delimiters at least
    let rows = memchr_iter(b'\n', &chunk.bytes).count().min(chunk.bytes.len() / form.width.max(1)) + 1;
    let Wanted { numbers, texts, columns, .. } = form.wanted;
    let mut rows = Rows {
        form,
        positions,
        filler: Filler::new((*numbers, *texts), columns.len(), rows),
        blank: chunk.blank,
        begins: chunk.line == form.first,
    };
    let read = if chunk.quotes { rows.quoted(chunk) } else { rows.plain(chunk) };
    rows.filler.finish(read.err())
}

struct Rows<'a> {
    form: Form<'a>,
    positions: &'a [usize],
    filler: Filler,
    /// First of the blank lines right before the next row.
    blank: Option<u64>,
    /// The next row is the first one after the header.
    begins: bool,
}

impl Rows<'_> {
    /// Without quotes, every line feed ends a row and every delimiter a cell.
    fn plain(&mut self, chunk: &Chunk) -> Result<(), DataError> {
        let Cuts { starts, rows } = cuts(&chunk.bytes, self.form.delimiter);
        let mut first = 0;
        for (line, next) in (chunk.line..).zip(rows) {
            let row = Plain { bytes: &chunk.bytes, starts: &starts[first..=next as usize] };
            match row.get(0) {
                b"" | b"\r" if row.len() == 1 => self.blank = self.blank.or(Some(line)),
                MARK if row.len() == 1 && self.form.wanted.comment.is_some() => {}
                _ => self.row(&row, line, 1)?,
            }
            first = next as usize;
        }
        Ok(())
    }

    /// With quotes the csv library finds the cells.
    fn quoted(&mut self, chunk: &Chunk) -> Result<(), DataError> {
        let mut records = Records::new(&chunk.bytes, self.form, chunk.line);
        while let Some(Record { row, lines, blank }) = records.next(self.form.file)? {
            self.blank = self.blank.or(blank);
            self.row(&records.record, row, lines)?;
        }
        Ok(())
    }

    /// Takes a row that is not blank, from its first line.
    fn row(&mut self, cells: &impl Cells, line: u64, lines: u64) -> Result<(), DataError> {
        let Form { file, width, .. } = self.form;
        if let Some(row) = self.blank.take().filter(|_| width == 1) {
            return Err(DataError::BlankRow { file: file.to_owned(), row });
        }
        if cells.len() != width {
            return Err(DataError::RowLength {
                file: file.to_owned(),
                row: line,
                found: cells.len(),
                expected: width,
                lines,
                begins: std::str::from_utf8(cells.cell(0)).ok().and_then(|text| text.trim_start().chars().next()),
            });
        }
        self.cells(cells, line).map_err(|error| if self.begins { units(error, cells, file, line) } else { error })?;
        self.begins = false;
        self.filler.end_row(line);
        Ok(())
    }

    /// The cells of a row into their columns.
    fn cells(&mut self, cells: &impl Cells, line: u64) -> Result<(), DataError> {
        let Form { file, wanted, .. } = self.form;
        let tokens = &wanted.tokens;
        for (index, (column, &position)) in wanted.columns.iter().zip(self.positions).enumerate() {
            let cell = cells.cell(position);
            if column.is_number() {
                let value = tokens.number(cell).map_err(|fault| column.fault(fault, file, line, cell))?;
                column.numbers.iter().for_each(|&number| self.filler.number(number, value));
            }
            if column.is_time {
                self.filler.time(column.moment(tokens, file, line, cell)?);
            }
            if !column.is_text() || (column.texts.is_empty() && self.filler.is_id(cell)) {
                continue; // nothing else, or the id of the row before
            }
            let missing = tokens.is_missing(cell);
            let text = std::str::from_utf8(cell).map_err(|_| column.not_utf8(file, line))?;
            if column.is_test {
                if missing {
                    return Err(DataError::MissingTest { at: column.place(file, line) });
                }
                self.filler.id(text);
            }
            self.filler.text(index, &column.texts, (!missing).then_some(text));
        }
        Ok(())
    }
}

/// The first row holds no number at all: it tells units, most likely.
fn units(error: DataError, cells: &impl Cells, file: &str, row: u64) -> DataError {
    let text = |position: usize| std::str::from_utf8(cells.cell(position)).unwrap_or_default().trim().to_owned();
    let found = match &error {
        DataError::NotANumber { found, .. } | DataError::NotATime { found, .. } => found.clone(),
        // units of columns, and none of the tests' ids
        DataError::MissingTest { .. } => (0..cells.len()).map(text).find(|cell| !cell.is_empty()).unwrap_or_default(),
        _ => return error,
    };
    let is_text = |position: usize| {
        let text = text(position);
        text.parse::<f64>().is_err() && !text.starts_with(|c: char| c.is_ascii_digit())
    };
    let names_a_unit = found.chars().any(|c| c.is_alphabetic() || "%°".contains(c));
    if names_a_unit && (0..cells.len()).all(is_text) {
        DataError::UnitsRow { file: file.to_owned(), row, found }
    } else {
        error
    }
}

/// Bytes with something before and after them.
type Enclosed<'b> = Chain<Chain<&'static [u8], &'b [u8]>, &'static [u8]>;

/// Records of bytes, by the csv library.
pub(super) struct Records<'b> {
    reader: csv::Reader<Enclosed<'b>>,
    pub(super) record: ByteRecord,
    /// Line of the first byte, and the library's number of it.
    line: u64,
    own: u64,
    /// Lines that are a mark are comments.
    comments: bool,
}

/// Where a record stands: the line where it begins, the number of its lines, and the first of blank lines before it.
pub(super) struct Record {
    pub(super) row: u64,
    pub(super) lines: u64,
    pub(super) blank: Option<u64>,
}

/// A row before the others: what the library takes for a byte order mark at the start is text here.
const BEFORE: &[u8] = b"-\n";
/// Every row has its line end; a blank line at the end is none.
const AFTER: &[u8] = b"\n";

impl<'b> Records<'b> {
    /// `line`: number of the first line.
    pub(super) fn new(bytes: &'b [u8], form: Form<'_>, line: u64) -> Records<'b> {
        // Rows end at LF only, so that lines are counted exactly; the CR of a CRLF is taken off the last cell.
        let mut reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .delimiter(form.delimiter)
            .terminator(Terminator::Any(b'\n'))
            .buffer_capacity(1 << 16)
            .from_reader(BEFORE.chain(bytes).chain(AFTER));
        let mut record = ByteRecord::new();
        let before = reader.read_byte_record(&mut record);
        debug_assert!(before.is_ok_and(|found| found), "bytes in memory are read");
        let own = reader.position().line();
        Records { reader, record, line, own, comments: form.wanted.comment.is_some() }
    }

    /// Bytes up to the end of the last record.
    pub(super) fn read(&self) -> usize {
        self.reader.position().byte() as usize - BEFORE.len()
    }

    /// Number of the line after the last record.
    pub(super) fn next_line(&self) -> u64 {
        self.reader.position().line() - self.own + self.line
    }

    /// Reads the next record that is not a blank line.
    pub(super) fn next(&mut self, file: &str) -> Result<Option<Record>, DataError> {
        let mut blank = None;
        loop {
            let before = self.next_line();
            let found = self.reader.read_byte_record(&mut self.record);
            let failed = |error: csv::Error| DataError::Io { file: file.to_owned(), source: error.into() };
            if !found.map_err(failed)? {
                return Ok(None);
            }
            let after = self.next_line();
            let lines = if after - before == 1 { 1 } else { 1 + count_lf(self.record.as_slice()) };
            let row = after - lines;
            if row > before {
                blank = blank.or(Some(before));
            }
            if self.record.len() == 1 && &self.record[0] == b"\r" {
                blank = blank.or(Some(row));
                continue;
            }
            if self.comments && self.record.len() == 1 && &self.record[0] == MARK {
                continue;
            }
            return Ok(Some(Record { row, lines, blank }));
        }
    }
}

/// A cell of a record, without the CR of the line's end.
pub(super) fn cell(record: &ByteRecord, position: usize) -> &[u8] {
    Cells::cell(record, position)
}

fn count_lf(bytes: &[u8]) -> u64 {
    memchr_iter(b'\n', bytes).count() as u64
}
