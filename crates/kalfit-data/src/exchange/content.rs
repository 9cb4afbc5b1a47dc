//! What an input holds: rows, reductions or estimates.

use std::fs::File;
use std::io::{Cursor, Read};
use std::path::PathBuf;

use bytes::Bytes;
use parquet::file::metadata::ParquetMetaData;

use super::error::ExchangeError;
use super::metadata::{ExchangeMetadata, SCHEMA, value};
use super::schema::{ESTIMATES_SCHEMA, REDUCTIONS_SCHEMA};
use crate::cell::shown;
use crate::error::DataError;
use crate::input::Input;
use crate::kind::{FileKind, HEAD, detect};
use crate::memory::MemoryTable;

/// What an input holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InputContent {
    /// Rows of tests.
    Rows,
    /// Reductions.
    Reductions,
    /// Estimates.
    Estimates,
}

/// An exchange file.
#[derive(Debug, Clone)]
pub struct ExchangeFile {
    /// What messages call it.
    pub name: String,
    /// Its number, for [`kalfit::Source`]: its place among all inputs.
    pub number: u32,
    pub(super) bytes: ExchangeBytes,
}

/// Where the bytes are.
#[derive(Debug, Clone)]
pub(super) enum ExchangeBytes {
    Path(PathBuf),
    Memory(Bytes),
}

/// Inputs told apart.
pub struct SortedInputs<'a> {
    /// What each input holds, in their order.
    pub contents: Vec<InputContent>,
    /// The inputs of rows, in their order.
    pub rows: Vec<Input>,
    /// Reductions files.
    pub reductions: Vec<ExchangeFile>,
    /// Estimates files.
    pub estimates: Vec<ExchangeFile>,
    /// Names of the inputs as [`kalfit::Source::file`] numbers them: those of rows first.
    pub files: Vec<String>,
    /// Standard input from its start, when rows are read from it.
    pub stdin: Box<dyn Read + 'a>,
}

/// Runs an expression on the opened file, whatever its bytes are in.
macro_rules! opened {
    ($source:expr, |$opened:ident| $body:block) => {
        match &$source.bytes {
            $crate::exchange::content::ExchangeBytes::Path(path) => {
                let failed = |source| $crate::DataError::Io { file: $source.name.clone(), source };
                let $opened = $crate::exchange::sheet::open(&$source.name, std::fs::File::open(path).map_err(failed)?)?;
                $body
            }
            $crate::exchange::content::ExchangeBytes::Memory(bytes) => {
                let $opened = $crate::exchange::sheet::open(&$source.name, bytes.clone())?;
                $body
            }
        }
    };
}
pub(super) use opened;

impl ExchangeFile {
    /// What the file says of itself; `None` when it is not kalfit's.
    ///
    /// # Errors
    /// It cannot be read, or its metadata are wrong.
    pub fn metadata(&self) -> Result<Option<ExchangeMetadata>, DataError> {
        opened!(self, |opened| { Ok(ExchangeMetadata::read(&self.name, opened.about.metadata())?) })
    }

    /// About how many rows it has, for whoever makes room for them: never more than its bytes could fill.
    pub fn rows_hint(&self) -> usize {
        const LEAST_BYTES: u64 = 8; // of a row
        let bytes = match &self.bytes {
            ExchangeBytes::Path(path) => std::fs::metadata(path).map_or(0, |found| found.len()),
            ExchangeBytes::Memory(bytes) => bytes.len() as u64,
        };
        let rows = || -> Result<i64, DataError> {
            opened!(self, |opened| { Ok(opened.about.metadata().file_metadata().num_rows()) })
        };
        let rows = rows().ok().and_then(|rows| u64::try_from(rows).ok()).unwrap_or(0);
        usize::try_from(rows.min(bytes / LEAST_BYTES)).unwrap_or(0)
    }
}

/// Looks into the inputs: an exchange file is a Parquet file whose metadata say so, or which has columns `estimates` and
/// `sensitivities` of lists. Standard input is read into memory when it is Parquet; other pipes are read as rows.
///
/// # Errors
/// A Parquet file that cannot be opened, or of another version of the schema.
pub fn sort<'a>(inputs: &[Input], mut stdin: Box<dyn Read + 'a>) -> Result<SortedInputs<'a>, DataError> {
    let (mut contents, mut exchanged, mut rows) = (Vec::new(), Vec::new(), Vec::new());
    for input in inputs {
        let name = input.name();
        if let Input::Table(table) = input {
            let content = of_table(table)?;
            contents.push(content);
            match content {
                InputContent::Rows => rows.push(input.clone()),
                _ => exchanged.push((
                    content,
                    ExchangeFile { name, number: 0, bytes: ExchangeBytes::Memory(table.to_parquet()?) },
                )),
            }
            continue;
        }
        let failed = |source| DataError::Io { file: name.clone(), source };
        let mut head = Vec::with_capacity(HEAD);
        let bytes = match input {
            // What comes but once must not be looked into: a pipe is read as rows.
            Input::Path(path) if !path.is_file() => ExchangeBytes::Path(path.clone()),
            Input::Path(path) => {
                File::open(path).and_then(|file| file.take(HEAD as u64).read_to_end(&mut head)).map_err(failed)?;
                ExchangeBytes::Path(path.clone())
            }
            Input::Stdin | Input::Table(_) => {
                stdin.by_ref().take(HEAD as u64).read_to_end(&mut head).map_err(failed)?;
                let mut all = head.clone();
                if is_parquet(input, &head) {
                    stdin.read_to_end(&mut all).map_err(failed)?;
                }
                let all = Bytes::from(all);
                stdin = Box::new(Cursor::new(all.clone()).chain(stdin));
                ExchangeBytes::Memory(all)
            }
        };
        let source = ExchangeFile { name, number: 0, bytes };
        let content = if is_parquet(input, &head) { source.content()? } else { InputContent::Rows };
        contents.push(content);
        match content {
            InputContent::Rows => rows.push(input.clone()),
            InputContent::Reductions | InputContent::Estimates => exchanged.push((content, source)),
        }
    }
    let mut files: Vec<String> = rows.iter().map(Input::name).collect();
    let (mut reductions, mut estimates) = (Vec::new(), Vec::new());
    for (content, mut source) in exchanged {
        source.number = u32::try_from(files.len()).expect("fewer than 2^32 files");
        files.push(source.name.clone());
        if content == InputContent::Reductions { reductions.push(source) } else { estimates.push(source) }
    }
    Ok(SortedInputs { contents, rows, reductions, estimates, files, stdin })
}

/// As the reader of rows sees it.
fn is_parquet(input: &Input, head: &[u8]) -> bool {
    !head.is_empty() && detect(input.extension().as_deref(), head) == Ok(FileKind::Parquet)
}

impl ExchangeFile {
    fn content(&self) -> Result<InputContent, DataError> {
        opened!(self, |opened| {
            if let Some(content) = by_schema(&self.name, opened.about.metadata())? {
                return Ok(content);
            }
            let is_list = |name: &str| {
                let found = opened.about.schema().column_with_name(name);
                found.is_some_and(|(_, field)| super::lists::is_numbers(field.data_type()))
            };
            Ok(if is_list("estimates") && is_list("sensitivities") {
                InputContent::Estimates
            } else {
                InputContent::Rows
            })
        })
    }
}

/// What a table in memory holds.
fn of_table(table: &MemoryTable) -> Result<InputContent, ExchangeError> {
    if let Some(content) = of_schema(table.name(), table.metadata(SCHEMA))? {
        return Ok(content);
    }
    let is_list = |name: &str| table.has(name, super::lists::is_numbers);
    Ok(if is_list("estimates") && is_list("sensitivities") { InputContent::Estimates } else { InputContent::Rows })
}

fn by_schema(file: &str, metadata: &ParquetMetaData) -> Result<Option<InputContent>, ExchangeError> {
    of_schema(file, value(metadata, SCHEMA))
}

fn of_schema(file: &str, schema: Option<&str>) -> Result<Option<InputContent>, ExchangeError> {
    match schema {
        None => Ok(None),
        Some(REDUCTIONS_SCHEMA) => Ok(Some(InputContent::Reductions)),
        Some(ESTIMATES_SCHEMA) => Ok(Some(InputContent::Estimates)),
        Some(found) => {
            let (file, found) = (file.to_owned(), shown(found.as_bytes()));
            Err(ExchangeError::Schema { file, found })
        }
    }
}
