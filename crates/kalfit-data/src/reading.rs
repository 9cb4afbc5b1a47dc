//! The one thing this crate does.

use std::io::Read;

use kalfit::{Labels, Layout, PhasedModel, Source, Test, TestKey};

use crate::error::{DataError, ReadError};
use crate::gather::Gather;
use crate::input::{Input, test_ids};
use crate::pass::{Ended, Job, run};
use crate::spool::Spool;
use crate::wanted::Wanted;

/// Id of the test when all rows are one.
pub const SINGLE_TEST: &str = "all";

/// What takes the tests as they are completed.
pub trait Sink {
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

    /// Forget all tests taken so far: rows of one of them came later, and everything is read again from the start.
    fn restart(&mut self);
}

/// What was read, beside the tests.
#[derive(Debug, Clone, Default)]
pub struct Reading {
    /// The texts of the data; those that the model names come first.
    pub labels: Labels,
    /// Names of the files, by [`Source::file`].
    pub files: Vec<String>,
    /// Number of rows.
    pub rows: u64,
    /// Number of tests.
    pub tests: usize,
}

impl Reading {
    /// Where a row came from, in words: "bench.csv, row 12".
    pub fn place(&self, source: Source) -> String {
        place(&self.files, source)
    }
}

/// Where a row came from, in words.
pub(crate) fn place(files: &[String], source: Source) -> String {
    let file = files.get(source.file as usize).map_or("unknown file", String::as_str);
    format!("{file}, row {}", source.row)
}

/// Reads the inputs and hands their tests to the sink, rows of all phases together; see the [crate's documentation](crate) for
/// what is read how.
///
/// # Errors
/// [`ReadError::Data`] when the data are wrong, [`ReadError::Sink`] when the sink refuses a test.
pub fn read<S: Sink>(
    model: &PhasedModel,
    layout: &Layout,
    inputs: &[Input],
    sink: &mut S,
) -> Result<Reading, ReadError<S::Error>> {
    read_from(model, layout, inputs, sink, &mut std::io::stdin().lock())
}

/// [`read`], with something else in the place of standard input.
///
/// # Errors
/// As [`read`].
pub fn read_from<S: Sink>(
    model: &PhasedModel,
    layout: &Layout,
    inputs: &[Input],
    sink: &mut S,
    stdin: &mut dyn Read,
) -> Result<Reading, ReadError<S::Error>> {
    if inputs.is_empty() {
        return Err(DataError::NoInput.into());
    }
    let mut reading =
        Reading { labels: Labels::new(&model.shared().literals), files: names(inputs), ..Reading::default() };
    let wanted = Wanted::new(model.shared(), layout);
    let ids = match &layout.test {
        TestKey::Single => vec![SINGLE_TEST.to_owned(); inputs.len()],
        TestKey::File => test_ids(inputs)?,
        TestKey::Column(_) => Vec::new(),
    };
    let job = Job::new(inputs, &wanted, ids, model);
    let mut spool = Spool::new(stdin, matches!(layout.test, TestKey::Column(_)));
    if run(&job, gather(model, &wanted, false), &mut reading, sink, &mut spool)? == Ended::MustHold {
        sink.restart();
        spool.last_time();
        reading.rows = 0;
        run(&job, gather(model, &wanted, true), &mut reading, sink, &mut spool)?;
    }
    Ok(reading)
}

fn names(inputs: &[Input]) -> Vec<String> {
    inputs.iter().map(Input::name).collect()
}

fn gather(model: &PhasedModel, wanted: &Wanted, holds: bool) -> Gather {
    let time_cells = wanted.time().map_or_else(Vec::new, |column| column.numbers.clone());
    Gather::new(holds, (wanted.numbers, wanted.texts), time_cells, model.column)
}
