//! Tables: files of any kind, row by row.

pub(crate) mod arrays;
mod batches;
mod csv;
pub(crate) mod guard;
mod ipc;
pub(crate) mod parquet;
pub(crate) mod strings;

use std::fs::File;
use std::io::{self, Cursor, Read};

use ::bytes::Bytes;
use kalfit::Labels;

use self::batches::BatchTable;
use self::csv::CsvTable;
use crate::error::DataError;
use crate::input::Input;
use crate::kind::{HEAD, Kind, detect};
use crate::memory::MemoryTable;
use crate::row::Row;
use crate::spool::Spool;
use crate::wanted::Wanted;

/// An open table.
pub(crate) enum Table<'a> {
    /// Text.
    Csv(Box<CsvTable<'a>>),
    /// Record batches of Parquet or Arrow IPC.
    Batches(Box<BatchTable<'a>>),
}

impl<'a> Table<'a> {
    /// Opens an input and finds the wanted columns in it.
    pub(crate) fn open(
        input: &Input,
        file: &'a str,
        wanted: &'a Wanted,
        spool: &'a mut Spool<'_>,
    ) -> Result<Table<'a>, DataError> {
        let failed = |source: io::Error| DataError::Io { file: file.to_owned(), source };
        if let Input::Table(table) = input {
            return Ok(Table::batches(memory(table, file, wanted)?));
        }
        let mut bytes: Box<dyn Read + 'a> = match input {
            Input::Path(path) => Box::new(File::open(path).map_err(failed)?),
            Input::Stdin | Input::Table(_) => Box::new(spool.rewound()),
        };
        let mut head = Vec::with_capacity(HEAD);
        bytes.by_ref().take(HEAD as u64).read_to_end(&mut head).map_err(failed)?;
        if head.is_empty() {
            return Err(DataError::Empty { file: file.to_owned() });
        }
        let kind = detect(input.extension().as_deref(), &head)
            .map_err(|found| DataError::Kind { file: file.to_owned(), found })?;
        let mut bytes = Cursor::new(head).chain(bytes);
        // Formats with a footer are read here and there: from a path opened again, or else from memory.
        let again = |path| File::open(path).map_err(failed);
        let mut all = Vec::new();
        if matches!(kind, Kind::Parquet | Kind::ArrowFile) && input.path().is_none() {
            bytes.read_to_end(&mut all).map_err(failed)?;
        }
        Ok(match (kind, input.path()) {
            (Kind::Csv { tab }, _) => Table::Csv(Box::new(CsvTable::open(file, bytes, tab, wanted)?)),
            (Kind::Parquet, Some(path)) => Table::batches(parquet::open(file, again(path)?, wanted)?),
            (Kind::Parquet, None) => Table::batches(parquet::open(file, Bytes::from(all), wanted)?),
            (Kind::ArrowFile, Some(path)) => Table::batches(ipc::open_file(file, again(path)?, wanted)?),
            (Kind::ArrowFile, None) => Table::batches(ipc::open_file(file, Cursor::new(all), wanted)?),
            (Kind::ArrowStream, _) => Table::batches(ipc::open_stream(file, Box::new(bytes), wanted)?),
        })
    }

    fn batches(table: BatchTable<'a>) -> Table<'a> {
        Table::Batches(Box::new(table))
    }

    /// How many of its so many bytes are read, as far as it is known.
    pub(crate) fn read(&self, bytes: u64) -> u64 {
        match self {
            Table::Csv(table) => table.read(),
            Table::Batches(table) => (table.share() * bytes as f64) as u64,
        }
    }

    /// Reads the next row; false at the end.
    pub(crate) fn next(&mut self, row: &mut Row, labels: &mut Labels) -> Result<bool, DataError> {
        match self {
            Table::Csv(table) => table.next(row, labels),
            Table::Batches(table) => table.next(row, labels),
        }
    }
}

/// A table in memory: its batches one after the other.
fn memory<'a>(table: &MemoryTable, file: &'a str, wanted: &'a Wanted) -> Result<BatchTable<'a>, DataError> {
    let (whole, mut next) = (table.clone(), 0);
    let next = move || {
        next += 1;
        Ok(whole.batches().get(next - 1).cloned())
    };
    BatchTable::new(file, "Arrow", wanted, table.schema(), Box::new(next))
}

/// The label of the text last seen in a column: texts are looked up only when they change.
#[derive(Default)]
struct LastLabel(Option<(String, kalfit::Label)>);

impl LastLabel {
    fn label(&mut self, text: &str, labels: &mut Labels) -> kalfit::Label {
        match &mut self.0 {
            Some((last, label)) if last == text => *label,
            Some((last, label)) => {
                last.clear();
                last.push_str(text);
                *label = labels.intern(text);
                *label
            }
            None => {
                let label = labels.intern(text);
                self.0 = Some((text.to_owned(), label));
                label
            }
        }
    }
}
