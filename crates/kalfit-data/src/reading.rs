//! The one thing this crate does.

use std::io::Read;

use kalfit::{Labels, Layout, PhasedModel, TestKey};

use crate::error::DataError;
use crate::gather::{TestGatherer, TestSpans};
use crate::input::{Input, test_ids};
use crate::pass::{PassEnd, PassInput, run};
use crate::sink::{DataReading, ReadError, TestSink};
use crate::spool::StdinSpool;
use crate::wanted::WantedColumns;

/// Id of the test when all rows are one.
pub const SINGLE_TEST: &str = "all";

/// Reads the inputs and hands their tests to the sink, rows of all phases together; see the [crate's documentation](crate) for
/// what is read how.
///
/// # Errors
/// [`ReadError::Data`] when the data are wrong, [`ReadError::Sink`] when the sink refuses a test.
pub fn read<S: TestSink>(
    model: &PhasedModel,
    layout: &Layout,
    inputs: &[Input],
    sink: &mut S,
) -> Result<DataReading, ReadError<S::Error>> {
    read_from(model, layout, inputs, sink, &mut std::io::stdin().lock())
}

/// [`read`], with something else in the place of standard input.
///
/// # Errors
/// As [`read`].
pub fn read_from<S: TestSink>(
    model: &PhasedModel,
    layout: &Layout,
    inputs: &[Input],
    sink: &mut S,
    stdin: &mut dyn Read,
) -> Result<DataReading, ReadError<S::Error>> {
    if inputs.is_empty() {
        return Err(DataError::NoInput.into());
    }
    let mut reading =
        DataReading { labels: Labels::new(&model.shared().literals), files: names(inputs), ..DataReading::default() };
    let wanted = WantedColumns::new(model.shared(), layout);
    let ids = match &layout.test {
        TestKey::Single => vec![SINGLE_TEST.to_owned(); inputs.len()],
        TestKey::File => test_ids(inputs)?,
        TestKey::Column(_) | TestKey::Row => Vec::new(),
    };
    let job = PassInput::new(inputs, &wanted, (ids, layout.test == TestKey::Row), model);
    let mut spool = StdinSpool::new(stdin, matches!(layout.test, TestKey::Column(_)));
    let spans = sink.wants_spans();
    if run(&job, gather(model, &wanted, (false, spans)), &mut reading, sink, &mut spool)? == PassEnd::MustHold {
        sink.restart();
        spool.last_time();
        reading.rows = 0;
        run(&job, gather(model, &wanted, (true, spans)), &mut reading, sink, &mut spool)?;
    }
    Ok(reading)
}

fn names(inputs: &[Input]) -> Vec<String> {
    inputs.iter().map(Input::name).collect()
}

fn gather(model: &PhasedModel, wanted: &WantedColumns, (holds, spans): (bool, bool)) -> TestGatherer {
    let spans = spans.then(TestSpans::default);
    TestGatherer::new(holds, (wanted.numbers, wanted.texts), model.column, spans)
}
