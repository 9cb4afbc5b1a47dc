//! The tests of reading and writing tables, one program.

mod errors;
mod exchange;
mod formats;
mod hostile;
mod levels;
mod memory;
mod streaming;
mod support;
mod threads;
mod times;
mod write;
