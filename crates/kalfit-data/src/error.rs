//! What can be wrong with data.

use std::io;

use arrow_schema::ArrowError;
use parquet::errors::ParquetError;

use crate::columns::FileColumns;
use crate::exchange::ExchangeError;
use crate::place::CellPlace;
use crate::room::bytes_in_words;

/// What is wrong with the data. The message says where, what was found and what was expected; [`DataError::hint`] says
/// what to do, where that is known.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    /// No file was given.
    #[error("no data were given: expected a file, a pattern or `-`")]
    NoInput,
    /// A pattern cannot be read.
    #[error("`{pattern}` is not a pattern of file names: {reason} at character {position}")]
    Pattern {
        /// The pattern.
        pattern: String,
        /// Character where it goes wrong, from 1.
        position: usize,
        /// What is wrong there.
        reason: &'static str,
    },
    /// A pattern matches no file.
    #[error("no file matches `{pattern}`")]
    NoMatch {
        /// The pattern.
        pattern: String,
    },
    /// One file was given twice.
    #[error("the same data were given twice: `{first}` and `{second}`")]
    SameFile {
        /// As first given.
        first: String,
        /// As given again.
        second: String,
    },
    /// Two files would be tests with the same id.
    #[error("`{first}` and `{second}` would both be test `{id}`")]
    SameTest {
        /// The id.
        id: String,
        /// The first file.
        first: String,
        /// The second file.
        second: String,
    },
    /// A directory was given.
    #[error("`{file}` is a directory, expected a file")]
    Directory {
        /// Its path.
        file: String,
    },
    /// Rows that take more memory than there is.
    #[error(
        "{file}: after {rows} rows {} of memory are taken and {} are left, which may not be enough for more",
        bytes_in_words(*taken),
        bytes_in_words(*left)
    )]
    Memory {
        /// The file.
        file: String,
        /// Rows read, of all files.
        rows: u64,
        /// Bytes that the process takes.
        taken: u64,
        /// Bytes that may still be had.
        left: u64,
    },
    /// The system could not read.
    #[error("cannot read {file}: {source}")]
    Io {
        /// The file.
        file: String,
        /// What the system said.
        source: io::Error,
    },
    /// A kind of file that is not read.
    #[error("{file} is {found}, expected CSV, Parquet or Arrow IPC")]
    Kind {
        /// The file.
        file: String,
        /// What it is, with its article.
        found: &'static str,
    },
    /// A file of no bytes.
    #[error("{file} is empty, expected a header and rows")]
    Empty {
        /// The file.
        file: String,
    },
    /// A table of no rows.
    #[error("{file} has no rows")]
    NoRows {
        /// The file.
        file: String,
    },
    /// A column that is needed is not there.
    #[error("{file} has no column `{column}`, which is used in {used_in}")]
    MissingColumn {
        /// The file.
        file: String,
        /// Name of the column.
        column: String,
        /// What it is needed for, in words.
        used_in: String,
        /// The columns of the file, the likeliest first if one is close.
        columns: Box<FileColumns>,
    },
    /// A column that is needed is there more than once.
    #[error("{file} has two columns named `{column}`: its columns {first} and {second}")]
    DuplicateColumn {
        /// The file.
        file: String,
        /// Name of the column.
        column: String,
        /// Position of the first, from 1.
        first: usize,
        /// Position of the second, from 1.
        second: usize,
    },
    /// A column's type does not fit its use.
    #[error("{file}, column `{column}`: found values of type {found}, expected {expected} (used in {used_in})")]
    ColumnType {
        /// The file.
        file: String,
        /// Name of the column.
        column: String,
        /// What it is used for, in words.
        used_in: String,
        /// Its type, in Arrow's words.
        found: Box<str>,
        /// What would fit.
        expected: &'static str,
    },
    /// A CSV row has too few or too many cells.
    #[error("{file}, row {row}: found {found} cells, expected {expected} as in the header")]
    RowLength {
        /// The file.
        file: String,
        /// Line where the row begins.
        row: u64,
        /// Number of its cells.
        found: usize,
        /// Number of the header's cells.
        expected: usize,
        /// Number of lines of the row; above 1 a quoted cell has line ends in it.
        lines: u64,
        /// Its first character.
        begins: Option<char>,
    },
    /// A CSV quote that is never closed.
    #[error("{file}, row {row}: found a quote that is still open at the end of the file, expected another `\"`")]
    OpenQuote {
        /// The file.
        file: String,
        /// Line where the row begins.
        row: u64,
    },
    /// A blank line that may be a missing cell.
    #[error("{file}, row {row}: found a blank line in a file of one column, expected a value or `NA`")]
    BlankRow {
        /// The file.
        file: String,
        /// The line.
        row: u64,
    },
    /// A CSV row without an end in sight.
    #[error("{file}, row {row}: found a row of more than {limit} bytes")]
    LongRow {
        /// The file.
        file: String,
        /// Line where the row begins.
        row: u64,
        /// The limit.
        limit: u64,
    },
    /// A CSV file whose lines end with carriage returns alone.
    #[error("{file}, row 1: found carriage returns alone, expected lines that end with LF or CRLF")]
    CarriageReturns {
        /// The file.
        file: String,
    },
    /// Bytes that are not UTF-8.
    #[error("{file}, row {row}: found bytes that are not UTF-8 text{}", column.as_ref().map(|c| format!(" in column `{c}`")).unwrap_or_default())]
    NotUtf8 {
        /// The file.
        file: String,
        /// Line.
        row: u64,
        /// Name of the column, when it is known.
        column: Option<String>,
    },
    /// A text that is too long to name anything.
    #[error("{at}: found a text of {found} bytes, expected at most {limit}")]
    LongText {
        /// The cell.
        at: Box<CellPlace>,
        /// Its bytes.
        found: usize,
        /// The limit.
        limit: usize,
    },
    /// A cell that is not a number.
    #[error("{at}: found `{found}`, expected a number")]
    NotANumber {
        /// The cell.
        at: Box<CellPlace>,
        /// Its text, shortened.
        found: String,
        /// What the number is needed for, in words.
        used_in: Box<str>,
    },
    /// The first row after the header holds texts only.
    #[error("{file}, row {row}: found `{found}` and no number in the first row after the header, expected numbers")]
    UnitsRow {
        /// The file.
        file: String,
        /// Line of the row.
        row: u64,
        /// A cell that should be a number, shortened.
        found: String,
    },
    /// A cell that is not finite.
    #[error("{at}: found `{found}`, expected a finite number")]
    Infinite {
        /// The cell.
        at: Box<CellPlace>,
        /// Its text, shortened.
        found: String,
    },
    /// A row does not say which test it belongs to.
    #[error("{at}: found a missing cell, expected the id of the row's test")]
    MissingTest {
        /// The cell.
        at: Box<CellPlace>,
    },
    /// A row does not say of which group its test is.
    #[error("{at}: found a missing cell, expected the group of the row's test at level `{}`", at.column)]
    MissingGroup {
        /// The cell.
        at: Box<CellPlace>,
    },
    /// A test stands in two groups of one level.
    #[error("{at}: found group `{found}` in a row of test `{test}`, expected `{expected}` as in its first row")]
    TwoGroups {
        /// The cell.
        at: Box<CellPlace>,
        /// Id of the test, shortened.
        test: String,
        /// The group of the row, shortened.
        found: String,
        /// That of the first row, shortened.
        expected: String,
        /// The group is a part of the test's id.
        joined: bool,
    },
    /// A row has no time.
    #[error("{at}: found a missing cell, expected the time of the row")]
    MissingTime {
        /// The cell.
        at: Box<CellPlace>,
    },
    /// A cell of the time column that is no time.
    #[error("{at}: found `{found}`, expected a number or a date-time")]
    NotATime {
        /// The cell.
        at: Box<CellPlace>,
        /// Its text, shortened.
        found: String,
    },
    /// Times go back within a test and phase.
    #[error("{at}: found time {found} after time {previous} in {}test `{test}`, expected times that do not decrease", phase.as_ref().map(|phase| format!("phase `{phase}` of ")).unwrap_or_default())]
    TimeDecreases {
        /// The cell.
        at: Box<CellPlace>,
        /// Id of the test, shortened.
        test: String,
        /// Phase of the row, in a model of several; shortened.
        phase: Option<Box<str>>,
        /// The time.
        found: Box<str>,
        /// The time of the test's previous row.
        previous: Box<str>,
    },
    /// Date-times need a unit to be read in.
    #[error("{at}: found date-times, expected a time unit for them in the model, {}", match found {
        None => "which has none".to_owned(),
        Some(unit) => format!("whose `time_unit` is `{unit}`"),
    })]
    TimeUnit {
        /// The first such cell.
        at: Box<CellPlace>,
        /// The model's unit.
        found: Option<String>,
    },
    /// Numbers and date-times in one column.
    #[error("{at}: found {found}, expected {expected} as in {first}")]
    MixedTimes {
        /// The cell.
        at: Box<CellPlace>,
        /// What it is.
        found: &'static str,
        /// What came before.
        expected: &'static str,
        /// The first cell of all.
        first: Box<CellPlace>,
    },
    /// A compression inside a Parquet file that is not read.
    #[error("{file}, column `{column}`: found compression {found}, expected none, snappy or zstd")]
    Codec {
        /// The file.
        file: String,
        /// Name of the column.
        column: String,
        /// The compression.
        found: Box<str>,
    },
    /// A file that declares far more than its bytes can hold.
    #[error("{file}: found {declared} {what} declared by {bytes} bytes, expected at most {limit}")]
    Oversized {
        /// The file.
        file: String,
        /// What is declared.
        what: &'static str,
        /// How much.
        declared: u64,
        /// Bytes that declare it.
        bytes: u64,
        /// The most that is believed of them.
        limit: u64,
    },
    /// The Parquet library refused the file.
    #[error("{file} is not a sound Parquet file: {source}")]
    Parquet {
        /// The file.
        file: String,
        /// What it said.
        source: Box<ParquetError>,
    },
    /// The file, or a column of it, is encrypted.
    #[error("{file} is encrypted, and encrypted Parquet files are not read")]
    Encrypted {
        /// The file.
        file: String,
    },
    /// The times of a column are in a zone that nobody knows.
    #[error("{file}, column `{column}`: the time zone `{found}` is not known")]
    TimeZone {
        /// The file.
        file: String,
        /// The column.
        column: String,
        /// The zone.
        found: String,
    },
    /// The Arrow library refused what is in the file.
    #[error("{file} is not a sound {format} file: {source}")]
    Arrow {
        /// The file.
        file: String,
        /// The kind of file.
        format: &'static str,
        /// What it said.
        source: Box<ArrowError>,
    },
    /// An exchange file is wrong, or does not go with the model or the other files.
    #[error(transparent)]
    Exchange(Box<ExchangeError>),
    /// A library panicked on broken bytes.
    #[error("{file} is not a sound {format} file: its contents contradict each other")]
    Crashed {
        /// The file.
        file: String,
        /// The kind of file.
        format: &'static str,
    },
}

impl From<ExchangeError> for DataError {
    fn from(error: ExchangeError) -> DataError {
        DataError::Exchange(Box::new(error))
    }
}
