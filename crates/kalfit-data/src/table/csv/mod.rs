//! CSV files.

mod comment;
mod cut;
mod rows;
mod scan;

use std::io::{self, Cursor, Read};

use self::comment::UncommentedBytes;
use self::cut::{CsvChunk, CsvCutter};
use self::rows::{CsvForm, CsvRecords, RecordPlace};
use super::ahead::{BlockTask, BlockTasks, TableProgress};
use crate::error::DataError;
use crate::wanted::WantedColumns;

/// A CSV file, in chunks of rows.
pub(crate) struct CsvTable<'a> {
    form: CsvForm<'a>,
    cutter: CsvCutter<'a>,
    /// Position of each wanted column.
    positions: Vec<usize>,
    /// The rows after the header.
    first: Option<CsvChunk>,
    /// Bytes of the next chunk.
    size: usize,
}

/// Longest part of the header line that is looked at for the delimiter.
const SNIFF_LIMIT: usize = 1 << 20;

/// Bytes of the first chunk and of the largest, which stays in a processor's own memory while it is parsed; each is twice as
/// large as the one before.
const FIRST_CHUNK: usize = 1 << 16;
const LARGEST_CHUNK: usize = 1 << 18;

impl<'a> CsvTable<'a> {
    /// Reads the header. With `tab` the delimiter is known to be the tab.
    pub(super) fn open(
        file: &'a str,
        bytes: impl Read + 'a,
        tab: bool,
        wanted: &'a WantedColumns,
    ) -> Result<CsvTable<'a>, DataError> {
        let failed = |source| DataError::Io { file: file.to_owned(), source };
        let mut bytes: Box<dyn Read + 'a> = match &wanted.comment {
            None => Box::new(bytes),
            Some(comment) => Box::new(UncommentedBytes::new(unmarked(bytes).map_err(failed)?, comment)),
        };
        let start = header_line(&mut bytes).map_err(failed)?;
        if start.starts_with(b"\xff\xfe") || start.starts_with(b"\xfe\xff") {
            return Err(DataError::NotUtf8 { file: file.to_owned(), row: 1, column: None });
        }
        let start = start.strip_prefix(b"\xef\xbb\xbf").map(<[u8]>::to_vec).unwrap_or(start);
        let delimiter = if tab { b'\t' } else { sniff(&start) };
        let cutter = CsvCutter::new(file, Box::new(Cursor::new(start).chain(bytes)), delimiter);
        let form = CsvForm { file, wanted, delimiter, width: 0, first: 0 };
        let mut table = CsvTable { form, cutter, positions: Vec::new(), first: None, size: FIRST_CHUNK };
        table.read_header()?;
        Ok(table)
    }

    fn read_header(&mut self) -> Result<(), DataError> {
        let file = self.form.file;
        while let Some(mut chunk) = self.cutter.next(self.size)? {
            let mut records = CsvRecords::new(&chunk.bytes, self.form, chunk.line);
            let Some(RecordPlace { row, .. }) = records.next(file)? else { continue };
            let mut names = Vec::with_capacity(records.record.len());
            for (position, cell) in records.record.iter().enumerate() {
                let is_last = position + 1 == records.record.len();
                let name = std::str::from_utf8(if is_last { rows::without_cr(cell) } else { cell })
                    .map_err(|_| DataError::NotUtf8 { file: file.to_owned(), row, column: None })?;
                if name.contains('\r') {
                    return Err(DataError::CarriageReturns { file: file.to_owned() });
                }
                names.push(name);
            }
            self.form.width = names.len();
            self.positions = self.form.wanted.positions(file, &names)?;
            let (read, line) = (records.read(), records.next_line());
            self.form.first = line;
            chunk.bytes.drain(..read.min(chunk.bytes.len()));
            self.first = Some(CsvChunk { line, blank: None, ..chunk });
            return Ok(());
        }
        Err(DataError::Empty { file: file.to_owned() })
    }
}

impl<'a> BlockTasks<'a> for CsvTable<'a> {
    fn next(&mut self) -> Result<Option<BlockTask<'a>>, DataError> {
        let chunk = match self.first.take() {
            Some(first) => Some(first),
            None => {
                self.size = (2 * self.size).min(LARGEST_CHUNK);
                self.cutter.next(self.size)?
            }
        };
        let (form, positions) = (self.form, self.positions.clone());
        Ok(chunk.map(|chunk| BlockTask {
            done: TableProgress::Bytes(chunk.end),
            make: Box::new(move || rows::block(form, &positions, &chunk)),
        }))
    }

    fn alone(&self) -> usize {
        (LARGEST_CHUNK / FIRST_CHUNK).ilog2() as usize
    }
}

/// The bytes without a byte order mark, which is no part of the first line.
fn unmarked<R: Read>(mut bytes: R) -> io::Result<impl Read> {
    let mut start = Vec::new();
    bytes.by_ref().take(3).read_to_end(&mut start)?;
    if start == b"\xef\xbb\xbf" {
        start.clear();
    }
    Ok(Cursor::new(start).chain(bytes))
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

    /// Rows with quotes and line ends in them, blank lines, CRLF, byte order marks, texts that are quoted or look like it.
    const NASTY: &str = "id,y,lot\r\n\n\r\n\"a\",1,x\n\"a\n\",\"2\",\"y\r\n\nz\"\r\nb,,\"\"\nb,3,q\"q\n\n\n\u{feff}b,\"4\",\u{feff}\n\
        c,\"5\"  ,\"\"\"\"\n\r\nc,NA,\"a,b\"\"\n\"\n\"\u{feff}d\",6e0,x\n\n";
    const ENDS: [&str; 9] = [
        "",
        "last,7,x",
        "last,\"7\",\"x\"\r",
        "one,8\n",
        "last,x,y\n1,2\n",
        "last,1,\"open\n\n",
        "\"",
        "l,1,\n\n\r",
        "\r",
    ];

    fn wanted() -> WantedColumns {
        let columns = |names: &[&str]| -> Vec<kalfit::model::Column> {
            let named = |name: &&str| kalfit::model::Column { name: (*name).to_owned(), used_in: String::new() };
            names.iter().map(named).collect()
        };
        let model = kalfit::Model {
            title: String::new(),
            columns: columns(&["y"]),
            text_columns: columns(&["lot"]),
            literals: Vec::new(),
            parameters: Vec::new(),
            states: Vec::new(),
            process_noise_covariance: Vec::new(),
            measurements: Vec::new(),
            noise_covariance: Vec::new(),
            clock: kalfit::model::Clock::default(),
            group: None,
            estimated: Vec::new(),
            mean: kalfit::model::MeanStructure::free(0),
            covariance: kalfit::model::CovarianceStructure::full(),
        };
        let test = kalfit::TestKey::Column("id".to_owned());
        WantedColumns::new(
            &model,
            &kalfit::Layout { test, levels: Vec::new(), crossed: Vec::new(), missing: Vec::new(), comment: None },
        )
    }

    /// What is read of a text in chunks of a size: every row with its place, and what is wrong with the next.
    fn read(text: &str, size: usize) -> (Vec<String>, Option<String>) {
        let wanted = wanted();
        let mut table = CsvTable::open("f", text.as_bytes(), false, &wanted).unwrap();
        // all but the header, cut anew
        let first = table.first.take().unwrap();
        let header = "id,y,lot\r\n".len();
        let rest = text.as_bytes()[header..].to_vec();
        let mut cutter = CsvCutter::starting("f", Box::new(Cursor::new(rest)), b',', first.line);
        let (mut rows, mut labels) = (Vec::new(), kalfit::Labels::default());
        loop {
            let chunk = match cutter.next(size) {
                Ok(Some(chunk)) => chunk,
                Ok(None) => return (rows, None),
                Err(error) => return (rows, Some(error.to_string())),
            };
            let mut block = rows::block(table.form, &table.positions, &chunk);
            block.relabel(&mut labels);
            for run in 0..block.runs() {
                let (range, id) = (block.run(run).0, block.run(run).1.map(|(id, _)| id));
                rows.extend(range.map(|row| {
                    let lot = labels.text(block.texts[row]);
                    format!("line {}: {id:?} {:?} {lot:?}", block.numbering.of(row), block.numbers[row])
                }));
            }
            if let Some(error) = block.end {
                return (rows, Some(error.to_string()));
            }
        }
    }

    #[test]
    fn a_file_cut_anywhere_is_the_file_in_one_piece() {
        for end in ENDS {
            let text = format!("{NASTY}{end}");
            let whole = read(&text, 1 << 20);
            assert!(whole.0.len() >= 8, "{end:?}: {whole:#?}");
            for size in 1..text.len() + 2 {
                assert_eq!(read(&text, size), whole, "{end:?} in chunks of {size} bytes");
            }
        }
    }

    #[test]
    fn rows_are_the_same_with_and_without_a_quote_elsewhere() {
        // a quoted cell sends the whole chunk through the csv library
        let plain = "id,y,lot\r\na,1,x\r\n\r\na,,\n\nb,3, q \nb, 4 ,5\n\u{feff}c,5,NA\n";
        let (rows, error) = read(plain, 1 << 20);
        let (quoted, quoted_error) = read(&format!("{plain}z,9,\"z\"\n"), 1 << 20);
        assert_eq!((rows.len(), &error, &quoted_error), (5, &None, &None));
        assert_eq!(rows[..], quoted[..5]);
        for bad in ["a,1\n", "a,1,x,y\n", "a,one,x\n", ",1,x\n", "a,1e999,x\n"] {
            let (_, plain_error) = read(&format!("{plain}{bad}"), 1 << 20);
            let (_, quoted_error) = read(&format!("{plain}{bad}z,9,\"z\"\n"), 1 << 20);
            assert!(plain_error.is_some() && plain_error == quoted_error, "{bad:?}: {plain_error:?} {quoted_error:?}");
        }
    }
}
