//! Tables in, tests out: CSV, Parquet and Arrow IPC, from files and standard input, as [`Test`](kalfit::Test)s of the core.
//!
//! [`read`] goes through the inputs once, row by row, and hands complete tests to a [`TestSink`] in batches, so that an
//! ensemble whose tests stand together in the data is never held whole. When a test comes back after another one began,
//! the sink is told to [restart](TestSink::restart), and everything is read again with the rows gathered by test first.
//!
//! # What is read
//!
//! * **Columns.** Those the model names, those of the layout, no others; each file may have its own order and kind.
//! * **Tests in groups.** Where the layout has levels, the id of a test is the texts of these columns and of its own with `/`
//!   between, so that run 1 of one unit is another test than run 1 of the next; a test that is a file keeps the file's id. Every
//!   row needs its groups, and those of a test are the same in all its rows: names that hold a `/` and make one id of two tests
//!   are refused.
//! * **Kind of a file.** By its extension (`.csv .tsv .txt`, `.parquet .pq`, `.arrow .ipc .feather .arrows`), else by its
//!   first bytes, else CSV. Standard input goes by its first bytes.
//! * **CSV.** A header is required. The delimiter is whichever of comma, semicolon and tab occurs most often outside
//!   quotes in the header line (comma wins a draw); in a `.tsv` file it is the tab. Lines end with LF or CRLF, and a byte
//!   order mark is skipped. Blank lines are skipped, except between the rows of a file of one column, where a blank line
//!   could be a missing cell and is an error.
//! * **Missing cells.** Empty, `NA`, `NaN` (`nan`, `NAN`), `null` (`NULL`, `Null`), nulls of Parquet and Arrow, and what
//!   [`Layout::missing`](kalfit::Layout) adds: by its text, and in numeric columns also by its value (`-99` is `-99.0`).
//!   Spaces around a number do not count; texts are kept as they are.
//! * **Texts** of other columns than text columns: integers and whole floats print as the integer, other floats in the
//!   shortest form that reads back the same, booleans as `true` and `false`, dates and timestamps as in ISO 8601.
//! * **Times** are numbers, or date-times (ISO 8601, RFC 3339; Parquet and Arrow timestamps and dates) that are read as
//!   time since the test's first row in the model's time unit. Date-times without an offset are taken on a clock that
//!   never jumps; with and without an offset do not mix.
//!
//! # What is written
//!
//! [`TestWriter`] writes tests back to one table that [`read`] takes in again: the same ids, texts and numbers, bit for bit.
//!
//! # Exchange files
//!
//! [`exchange`] reads and writes what filters made of tests: reductions and estimates, phase by phase.
//!
//! # Hostile files
//!
//! Nothing here trusts its input: what a file declares is checked against its size before memory is asked for, and a
//! panic of the Parquet or Arrow libraries on broken bytes is caught and becomes [`DataError::Crashed`] (the panic hook
//! still runs, unless [`keep_quiet_of_broken_files`] set one). This needs unwinding: do not build with `panic = "abort"`.

mod block;
mod cell;
mod columns;
mod error;
pub mod exchange;
mod fill;
mod gather;
mod hint;
mod input;
mod kind;
mod memory;
mod moment;
mod most_rows;
mod numbering;
mod pass;
mod place;
mod reading;
mod room;
mod sink;
mod spool;
mod table;
mod wanted;
mod write;

pub use error::DataError;
pub use hint::is_total;
pub use input::{Datum, Input};
pub use memory::MemoryTable;
pub use most_rows::{MOST_ROWS, accepted_rows};
pub use place::CellPlace;
pub use reading::{SINGLE_TEST, read, read_from};
pub use room::{bytes_in_words, memory_left};
pub use sink::{DataReading, ReadError, TestSink};
pub use table::guard::keep_quiet_of_broken_files;
pub use write::{CellKind, TableCell, TableFormat, TableWriter, TestWriter, WriteError, WrittenIds, added_id_column};
