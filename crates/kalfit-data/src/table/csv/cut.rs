//! A CSV file cut into chunks at ends of rows, so that they can be parsed apart from each other.

use std::io::Read;

use memchr::{memchr, memchr_iter, memrchr};

use crate::error::DataError;

/// Longest row that is read.
const ROW_LIMIT: usize = 64 << 20;

/// Whole rows, of which the first begins at `line`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct CsvChunk {
    pub(super) bytes: Vec<u8>,
    pub(super) line: u64,
    /// The first of the blank lines right before it, if there are any.
    pub(super) blank: Option<u64>,
    /// Some cells are quoted, or look like it.
    pub(super) quotes: bool,
    /// Bytes of the file up to its end.
    pub(super) end: u64,
}

/// Cuts bytes after line feeds that are not in quotes. A quote opens a quoted cell where the cell begins, and closes it where no
/// other quote follows; elsewhere it is a character like others.
pub(super) struct CsvCutter<'a> {
    file: &'a str,
    bytes: Box<dyn Read + 'a>,
    delimiter: u8,
    /// What is not handed out; it begins with a row.
    pending: Vec<u8>,
    /// So many of them were looked at, and the last of those were inside a quoted cell.
    scanned: usize,
    quoted: bool,
    /// Where the last row that is whole ends.
    whole: usize,
    /// Some of them are quotes.
    quotes: bool,
    ended: bool,
    line: u64,
    blank: Option<u64>,
    /// Bytes handed out.
    given: u64,
}

impl<'a> CsvCutter<'a> {
    pub(super) fn new(file: &'a str, bytes: Box<dyn Read + 'a>, delimiter: u8) -> CsvCutter<'a> {
        CsvCutter {
            file,
            bytes,
            delimiter,
            pending: Vec::new(),
            scanned: 0,
            quoted: false,
            whole: 0,
            quotes: false,
            ended: false,
            line: 1,
            blank: None,
            given: 0,
        }
    }

    /// The same, of bytes that begin at a line; for tests.
    #[cfg(test)]
    pub(super) fn starting(file: &'a str, bytes: Box<dyn Read + 'a>, delimiter: u8, line: u64) -> CsvCutter<'a> {
        CsvCutter { line, ..CsvCutter::new(file, bytes, delimiter) }
    }

    /// The next rows, of about `size` bytes; `None` at the end.
    pub(super) fn next(&mut self, size: usize) -> Result<Option<CsvChunk>, DataError> {
        let mut wanted = size.max(1);
        loop {
            self.fill(wanted)?;
            self.scan();
            if self.ended && self.quoted {
                // what is whole comes first
                return if self.whole > 0 { Ok(Some(self.cut())) } else { Err(self.open_quote()) };
            }
            if self.ended {
                self.whole = self.pending.len();
                return Ok((self.whole > 0).then(|| self.cut()));
            }
            if self.whole > 0 {
                return Ok(Some(self.cut()));
            }
            if self.pending.len() > ROW_LIMIT {
                let (file, row) = (self.file.to_owned(), self.line);
                return Err(DataError::LongRow { file, row, limit: ROW_LIMIT as u64 });
            }
            wanted = self.pending.len() + size.max(1);
        }
    }

    /// Reads until so many bytes are pending.
    fn fill(&mut self, wanted: usize) -> Result<(), DataError> {
        let Some(missing) = wanted.checked_sub(self.pending.len()).filter(|missing| *missing > 0) else {
            return Ok(());
        };
        if self.ended {
            return Ok(());
        }
        self.pending.reserve(missing);
        let read = self.bytes.by_ref().take(missing as u64).read_to_end(&mut self.pending);
        let read = read.map_err(|source| DataError::Io { file: self.file.to_owned(), source })?;
        self.ended = read < missing;
        Ok(())
    }

    /// Looks at the bytes that were not looked at.
    fn scan(&mut self) {
        let bytes = &self.pending[..];
        let mut at = self.scanned;
        while at < bytes.len() {
            let quote = memchr(b'"', &bytes[at..]).map_or(bytes.len(), |found| at + found);
            if !self.quoted {
                self.whole = memrchr(b'\n', &bytes[at..quote]).map_or(self.whole, |found| at + found + 1);
            }
            if quote == bytes.len() {
                at = quote;
                break;
            }
            self.quotes = true;
            if !self.quoted {
                let before = quote.checked_sub(1).map(|before| bytes[before]);
                self.quoted = before.is_none_or(|before| before == b'\n' || before == self.delimiter);
                at = quote + 1;
                continue;
            }
            match bytes.get(quote + 1) {
                Some(b'"') => at = quote + 2,
                None if !self.ended => {
                    at = quote; // the next byte says what it is
                    break;
                }
                _ => (self.quoted, at) = (false, quote + 1),
            }
        }
        self.scanned = at;
    }

    /// Hands out what is whole.
    fn cut(&mut self) -> CsvChunk {
        let rest = self.pending.split_off(self.whole);
        let bytes = std::mem::replace(&mut self.pending, rest);
        let quotes = self.quotes && memchr(b'"', &bytes).is_some();
        self.scanned -= self.whole.min(self.scanned);
        self.whole = 0;
        self.quotes = memchr(b'"', &self.pending[..self.scanned]).is_some();
        self.given += bytes.len() as u64;
        let (line, blank) = (self.line, self.blank);
        self.line += memchr_iter(b'\n', &bytes).count() as u64;
        self.blank = match blank_lines(&bytes) {
            (lines, true) => blank.or((lines > 0).then_some(line)),
            (lines, false) => (lines > 0).then(|| self.line - lines),
        };
        CsvChunk { bytes, line, blank, quotes, end: self.given }
    }

    /// The row that is pending has a quote that nothing closes.
    fn open_quote(&self) -> DataError {
        DataError::OpenQuote { file: self.file.to_owned(), row: self.line }
    }
}

/// Number of the blank lines at the end, and whether there is nothing else.
fn blank_lines(bytes: &[u8]) -> (u64, bool) {
    let (mut rest, mut lines) = (bytes, 0);
    loop {
        let Some(line) = rest.strip_suffix(b"\n") else { return (lines, rest.is_empty()) };
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        if !line.is_empty() && !line.ends_with(b"\n") {
            return (lines, false);
        }
        (rest, lines) = (line, lines + 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NASTY: &str =
        "a,\"b\nc\",d\r\n\n\r\n\"\"\"x\"\"\n\",y\"z,\"\"\n1,2\"\",3\"\n\"q\"r\"\n,s,\"\"\n\n\nlast,\"\r\n\"";

    fn chunks(text: &str, size: usize) -> Result<Vec<CsvChunk>, DataError> {
        let mut cutter = CsvCutter::new("f", Box::new(text.as_bytes()), b',');
        std::iter::from_fn(|| cutter.next(size).transpose()).collect()
    }

    #[test]
    fn chunks_of_any_size_are_whole_rows_that_follow_each_other() {
        // where the csv library ends a row
        let mut reader = csv::ReaderBuilder::new();
        reader.has_headers(false).flexible(true).terminator(csv::Terminator::Any(b'\n'));
        let mut reader = reader.from_reader(NASTY.as_bytes());
        let (mut ends, mut record) = (vec![0], csv::ByteRecord::new());
        while reader.read_byte_record(&mut record).unwrap() {
            ends.push(reader.position().byte());
        }
        for size in 1..NASTY.len() + 2 {
            let chunks = chunks(NASTY, size).unwrap();
            let joined: Vec<u8> = chunks.iter().flat_map(|chunk| chunk.bytes.clone()).collect();
            assert_eq!(joined, NASTY.as_bytes(), "size {size}");
            let mut line = 1;
            for chunk in &chunks {
                // blank lines belong to the row after them in the library's eyes
                let trimmed = chunk.end - blank_lines(&chunk.bytes).0;
                let at_end = |end: &u64| *end <= chunk.end && *end >= trimmed.min(chunk.end).saturating_sub(2);
                assert!(ends.iter().any(at_end) || blank_lines(&chunk.bytes).1, "size {size}: {chunk:?} {ends:?}");
                assert_eq!(chunk.line, line, "size {size}: {chunk:?}");
                assert_eq!(chunk.quotes, chunk.bytes.contains(&b'"'), "size {size}: {chunk:?}");
                line += chunk.bytes.iter().filter(|byte| **byte == b'\n').count() as u64;
            }
        }
    }

    #[test]
    fn blank_lines_before_a_chunk_are_remembered_across_chunks() {
        for size in 1..6 {
            let chunks = chunks("a\n\n\r\n\nb\n\n", size).unwrap();
            let of_b = chunks.iter().find(|chunk| chunk.bytes.contains(&b'b')).unwrap();
            let own = of_b.bytes.starts_with(b"\n") || of_b.bytes.starts_with(b"\r");
            let with_a = of_b.bytes.contains(&b'a');
            assert!(with_a || of_b.blank == Some(2) || (own && of_b.line == 2), "size {size}: {chunks:?}");
        }
    }

    #[test]
    fn an_open_quote_is_an_error_after_the_rows_before_it() {
        for size in 1..20 {
            let mut cutter = CsvCutter::new("f", Box::new("a,b\n1,2\n3,\"4\n5,6\n".as_bytes()), b',');
            let mut rows = Vec::new();
            let error = loop {
                match cutter.next(size) {
                    Ok(chunk) => rows.extend(chunk.expect("an error comes before the end").bytes),
                    Err(error) => break error,
                }
            };
            assert_eq!(rows, b"a,b\n1,2\n", "size {size}");
            assert!(matches!(error, DataError::OpenQuote { row: 3, .. }), "size {size}: {error}");
        }
    }
}
