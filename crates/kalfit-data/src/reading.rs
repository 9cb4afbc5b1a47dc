//! The one thing this crate does.

use std::io::Read;

use kalfit::{Labels, Layout, PhasedModel, TestKey};

use crate::error::DataError;
use crate::gather::Gather;
use crate::input::{Input, test_ids};
use crate::pass::{Ended, Job, run};
use crate::sink::{ReadError, Reading, Sink};
use crate::spool::Spool;
use crate::wanted::Wanted;

/// Id of the test when all rows are one.
pub const SINGLE_TEST: &str = "all";

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
    Gather::new(holds, (wanted.numbers, wanted.texts), model.column)
}
