//! A chunk of a CSV file into a block.

use std::borrow::Cow;
use std::io::{Chain, Read};

use csv::{ByteRecord, ReaderBuilder, Terminator};
use memchr::memchr_iter;

use super::comment::MARK;
use super::cut::CsvChunk;
use super::scan::{CsvCuts, cuts};
use crate::block::RowBlock;
use crate::error::DataError;
use crate::fill::{BadRow, BlockFiller, ColumnwiseRows, change};
use crate::moment::Moment;
use crate::numbering::RowNumbering;
use crate::wanted::WantedColumns;

/// What must be known of a file to read its rows.
#[derive(Clone, Copy)]
pub(super) struct CsvForm<'a> {
    pub(super) file: &'a str,
    pub(super) wanted: &'a WantedColumns,
    pub(super) delimiter: u8,
    /// Number of cells of the header.
    pub(super) width: usize,
    /// The line after the header.
    pub(super) first: u64,
}

/// The rows of a chunk. `positions`: of each wanted column.
pub(super) fn block(form: CsvForm<'_>, positions: &[usize], chunk: &CsvChunk) -> RowBlock {
    let (bytes, numbering) = (Cow::Borrowed(&[][..]), RowNumbering::default());
    let mut grid = CsvGrid { form, positions, bytes, starts: vec![0], rows: Vec::new(), numbering, blank: chunk.blank };
    let mut end = if chunk.quotes { grid.quoted(chunk) } else { grid.plain(chunk) }.err();
    let mut filler = BlockFiller::new(form.wanted, grid.rows.len());
    if let Err((row, error)) = filler.fill(&grid) {
        end = Some(if row == 0 && chunk.line == form.first { grid.units(error) } else { error });
    }
    filler.finish(grid.numbering, end)
}

/// Cells of rows that have as many as the header.
struct CsvGrid<'a> {
    form: CsvForm<'a>,
    positions: &'a [usize],
    /// The cells, one byte between each and the next.
    bytes: Cow<'a, [u8]>,
    /// Where each cell begins, and where one after the last would.
    starts: Vec<u32>,
    /// The first cell of each row.
    rows: Vec<u32>,
    /// The first lines of the rows.
    numbering: RowNumbering,
    /// First of the blank lines right before the next row.
    blank: Option<u64>,
}

impl<'a> CsvGrid<'a> {
    /// Without quotes, every line is a row.
    fn plain(&mut self, chunk: &'a CsvChunk) -> Result<(), DataError> {
        let CsvCuts { starts, rows } = cuts(&chunk.bytes, self.form.delimiter);
        (self.bytes, self.starts) = (Cow::Borrowed(&chunk.bytes[..]), starts);
        self.rows.reserve(rows.len());
        let (mut first, comments) = (0, self.form.wanted.comment.is_some());
        for (line, next) in (chunk.line..).zip(rows) {
            let cells = (next - first) as usize;
            match self.bytes_of(first as usize) {
                b"" | b"\r" if cells == 1 => self.blank = self.blank.or(Some(line)),
                MARK if cells == 1 && comments => {}
                _ => self.row(first, cells, (line, 1))?,
            }
            first = next;
        }
        Ok(())
    }

    /// With quotes the csv library finds the cells.
    fn quoted(&mut self, chunk: &CsvChunk) -> Result<(), DataError> {
        let mut records = CsvRecords::new(&chunk.bytes, self.form, chunk.line);
        while let Some(RecordPlace { row, lines, blank }) = records.next(self.form.file)? {
            let first = self.starts.len() as u32 - 1;
            for cell in &records.record {
                let bytes = self.bytes.to_mut();
                bytes.extend_from_slice(cell);
                bytes.push(b'\n');
                self.starts.push(bytes.len() as u32);
            }
            self.blank = self.blank.or(blank);
            self.row(first, records.record.len(), (row, lines))?;
        }
        Ok(())
    }

    /// Takes a row that is not blank: its first cell, the number of its cells, its first line and the number of its lines.
    fn row(&mut self, first: u32, cells: usize, (line, lines): (u64, u64)) -> Result<(), DataError> {
        let CsvForm { file, width, .. } = self.form;
        if let Some(row) = self.blank.take().filter(|_| width == 1) {
            return Err(DataError::BlankRow { file: file.to_owned(), row });
        }
        if cells != width {
            let begins = std::str::from_utf8(self.bytes_of(first as usize)).ok();
            return Err(DataError::RowLength {
                file: file.to_owned(),
                row: line,
                found: cells,
                expected: width,
                lines,
                begins: begins.and_then(|text| text.trim_start().chars().next()),
            });
        }
        self.numbering.push(self.rows.len(), line);
        self.rows.push(first);
        Ok(())
    }

    #[inline]
    fn bytes_of(&self, cell: usize) -> &[u8] {
        &self.bytes[self.starts[cell] as usize..self.starts[cell + 1] as usize - 1]
    }

    /// A cell of a row, without the CR of the line's end.
    #[inline]
    fn cell(&self, row: usize, position: usize) -> &[u8] {
        let cell = self.bytes_of(self.rows[row] as usize + position);
        if position + 1 == self.form.width { without_cr(cell) } else { cell }
    }

    /// The cells of a wanted column.
    fn column(&self, column: usize) -> impl Iterator<Item = &[u8]> {
        let position = self.positions[column];
        (0..self.rows.len()).map(move |row| self.cell(row, position))
    }

    /// What is wrong with the first row: it holds no number at all and tells units, most likely.
    fn units(&self, error: DataError) -> DataError {
        let texts = (0..self.form.width).map(|cell| std::str::from_utf8(self.cell(0, cell)).unwrap_or_default().trim());
        let found = match &error {
            DataError::NotANumber { found, .. } | DataError::NotATime { found, .. } => found.clone(),
            // units of columns, and none of the tests' ids
            DataError::MissingTest { .. } | DataError::MissingGroup { .. } => {
                texts.clone().find(|cell| !cell.is_empty()).unwrap_or_default().to_owned()
            }
            _ => return error,
        };
        let is_text = |text: &str| text.parse::<f64>().is_err() && !text.starts_with(|c: char| c.is_ascii_digit());
        let names_a_unit = found.chars().any(|c| c.is_alphabetic() || "%°".contains(c));
        if names_a_unit && texts.clone().all(is_text) {
            DataError::UnitsRow { file: self.form.file.to_owned(), row: self.numbering.of(0), found }
        } else {
            error
        }
    }
}

impl ColumnwiseRows for CsvGrid<'_> {
    fn rows(&self) -> usize {
        self.rows.len()
    }

    fn numbers(&self, column: usize, mut put: impl FnMut(f64)) -> Result<(), BadRow> {
        let CsvForm { file, wanted, .. } = self.form;
        for (row, cell) in self.column(column).enumerate() {
            let bad = |fault| (row, wanted.columns[column].fault(fault, file, self.numbering.of(row), cell));
            put(wanted.tokens.number(cell).map_err(bad)?);
        }
        Ok(())
    }

    fn times(&self, column: usize, mut put: impl FnMut(Moment)) -> Result<(), BadRow> {
        let CsvForm { file, wanted, .. } = self.form;
        for (row, cell) in self.column(column).enumerate() {
            match wanted.tokens.number(cell) {
                Ok(time) if !time.is_nan() => put(Moment::of_number(time, cell)),
                number => {
                    let at = (file, self.numbering.of(row));
                    put(wanted.columns[column].moment(number, at, cell).map_err(|error| (row, error))?);
                }
            }
        }
        Ok(())
    }

    fn text<'t>(&'t self, column: usize, row: usize, _: &'t mut String) -> Result<Option<&'t str>, DataError> {
        let CsvForm { file, wanted, .. } = self.form;
        let cell = self.cell(row, self.positions[column]);
        wanted.columns[column].measure(cell.len(), file, || self.numbering.of(row))?;
        let not_utf8 = |_| wanted.columns[column].not_utf8(file, self.numbering.of(row));
        let text = std::str::from_utf8(cell).map_err(not_utf8)?;
        Ok((!wanted.tokens.is_missing(cell)).then_some(text))
    }

    fn change(&self, column: usize, row: usize) -> usize {
        let position = self.positions[column];
        change(row..self.rows.len(), |row| self.cell(row, position))
    }

    fn without_id(&self, column: usize, row: usize) -> DataError {
        let CsvForm { file, wanted, .. } = self.form;
        wanted.columns[column].without_id(file, self.numbering.of(row))
    }
}

/// Bytes with something before and after them.
type EnclosedBytes<'b> = Chain<Chain<&'static [u8], &'b [u8]>, &'static [u8]>;

/// Records of bytes, by the csv library.
pub(super) struct CsvRecords<'b> {
    reader: csv::Reader<EnclosedBytes<'b>>,
    pub(super) record: ByteRecord,
    /// Line of the first byte, and the library's number of it.
    line: u64,
    own: u64,
    /// Lines that are a mark are comments.
    comments: bool,
}

/// Where a record stands: the line where it begins, the number of its lines, and the first of blank lines before it.
pub(super) struct RecordPlace {
    pub(super) row: u64,
    pub(super) lines: u64,
    pub(super) blank: Option<u64>,
}

/// A row before the others: what the library takes for a byte order mark at the start is text here.
const BEFORE: &[u8] = b"-\n";
/// Every row has its line end; a blank line at the end is none.
const AFTER: &[u8] = b"\n";

impl<'b> CsvRecords<'b> {
    /// `line`: number of the first line.
    pub(super) fn new(bytes: &'b [u8], form: CsvForm<'_>, line: u64) -> CsvRecords<'b> {
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
        CsvRecords { reader, record, line, own, comments: form.wanted.comment.is_some() }
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
    pub(super) fn next(&mut self, file: &str) -> Result<Option<RecordPlace>, DataError> {
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
            return Ok(Some(RecordPlace { row, lines, blank }));
        }
    }
}

/// The last cell of a row without the CR of the line's end.
pub(super) fn without_cr(cell: &[u8]) -> &[u8] {
    cell.strip_suffix(b"\r").unwrap_or(cell)
}

fn count_lf(bytes: &[u8]) -> u64 {
    memchr_iter(b'\n', bytes).count() as u64
}
