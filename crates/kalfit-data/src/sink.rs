//! What takes the tests, and what a reading says beside them.

use kalfit::{Labels, Source, Test};

use crate::error::DataError;
use crate::place::place;

/// What takes the tests as they are completed.
pub trait TestSink {
    /// Why it may refuse one.
    type Error;

    /// Takes complete tests, in order of first appearance. `labels` has every text in them.
    ///
    /// # Errors
    /// Whatever it cannot take; the reading then ends with [`ReadError::Sink`].
    fn tests(&mut self, tests: Vec<Test>, labels: &Labels) -> Result<(), Self::Error>;

    /// Hears now and then how many bytes are read, and of how many, when all inputs are files.
    ///
    /// # Errors
    /// The reading ends with [`ReadError::Sink`].
    fn bytes(&mut self, _done: u64, _of: Option<u64>) -> Result<(), Self::Error> {
        Ok(())
    }

    /// Whether the reading is to say when each test was: [`DataReading::spans`].
    fn wants_spans(&self) -> bool {
        false
    }

    /// Forget all tests taken so far: rows of one of them came later, and everything is read again from the start.
    fn restart(&mut self);
}

/// What was read, beside the tests.
#[derive(Debug, Clone, Default)]
pub struct DataReading {
    /// The texts of the data; those that the model names come first.
    pub labels: Labels,
    /// Names of the files, by [`Source::file`].
    pub files: Vec<String>,
    /// Number of rows.
    pub rows: u64,
    /// Number of tests.
    pub tests: usize,
    /// First and last time of each test, since the first row of all, in the unit of times; NaN without times. Empty
    /// unless it was asked for.
    pub spans: Vec<[f64; 2]>,
}

impl DataReading {
    /// Where a row came from, in words: "bench.csv, row 12".
    pub fn place(&self, source: Source) -> String {
        place(&self.files, source)
    }
}

/// Why reading ended early.
#[derive(Debug, thiserror::Error)]
pub enum ReadError<E> {
    /// The data are wrong.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The sink refused a test.
    #[error("{error}")]
    Sink {
        /// What it said.
        error: E,
        /// What was read so far: [`DataReading::place`] turns the sources of the error into files and rows.
        reading: Box<DataReading>,
    },
}
