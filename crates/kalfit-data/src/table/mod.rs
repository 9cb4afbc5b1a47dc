//! Tables: files of any kind, in blocks of rows.

pub(crate) mod ahead;
pub(crate) mod arrays;
mod batches;
mod convert;
mod csv;
pub(crate) mod guard;
mod ipc;
pub(crate) mod parquet;
pub(crate) mod strings;

use std::fs::File;
use std::io::{self, Cursor, Read};

use ::bytes::Bytes;

use self::ahead::BlockTasks;
use self::batches::BatchTable;
use self::csv::CsvTable;
use crate::error::DataError;
use crate::input::Input;
use crate::kind::{FileKind, HEAD, detect};
use crate::memory::MemoryTable;
use crate::spool::StdinSpool;
use crate::wanted::WantedColumns;

/// Opens an input and finds the wanted columns in it.
pub(crate) fn open<'a>(
    input: &Input,
    file: &'a str,
    wanted: &'a WantedColumns,
    spool: &'a mut StdinSpool<'_>,
) -> Result<Box<dyn BlockTasks<'a> + 'a>, DataError> {
    let failed = |source: io::Error| DataError::Io { file: file.to_owned(), source };
    if let Input::Table(table) = input {
        return Ok(Box::new(memory(table, file, wanted)?));
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
    let mut all = Vec::new();
    if matches!(kind, FileKind::Parquet | FileKind::ArrowFile) && input.path().is_none() {
        bytes.read_to_end(&mut all).map_err(failed)?;
    }
    Ok(match (kind, input.path()) {
        (FileKind::Csv { tab }, _) => Box::new(CsvTable::open(file, bytes, tab, wanted)?),
        (FileKind::Parquet, Some(path)) => {
            let path = path.to_owned();
            parquet::open(file, move || File::open(&path), wanted)?
        }
        (FileKind::Parquet, None) => {
            let all = Bytes::from(all);
            parquet::open(file, move || Ok(all.clone()), wanted)?
        }
        (FileKind::ArrowFile, Some(path)) => Box::new(ipc::open_file(file, File::open(path).map_err(failed)?, wanted)?),
        (FileKind::ArrowFile, None) => Box::new(ipc::open_file(file, Cursor::new(all), wanted)?),
        (FileKind::ArrowStream, _) => Box::new(ipc::open_stream(file, Box::new(bytes), wanted)?),
    })
}

/// A table in memory: its batches one after the other.
fn memory<'a>(table: &MemoryTable, file: &'a str, wanted: &'a WantedColumns) -> Result<BatchTable<'a>, DataError> {
    let (whole, mut next) = (table.clone(), 0);
    let next = move || {
        next += 1;
        Ok(whole.batches().get(next - 1).cloned())
    };
    BatchTable::new(file, "Arrow", wanted, table.schema(), Box::new(next))
}
