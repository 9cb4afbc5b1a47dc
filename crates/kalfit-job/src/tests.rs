//! Data that are kept whole: what the filters run over again and again, or what others are drawn like.

use kalfit::{Labels, PhasedModel, PhasedTest, Test};
use kalfit_data::{DataReading, TestSink};
use kalfit_spec::Spec;

use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::refused::{self, SinkRefusal};
use crate::work::JobWork;

/// The end of the tests that are worked on at once, from this one on: so many rows, or one test.
pub(crate) fn batch(tests: &[PhasedTest], from: usize, most_rows: usize) -> usize {
    let mut rows = 0;
    let mut next = from;
    while next < tests.len() && (rows < most_rows || next == from) {
        rows += tests[next].row_count();
        next += 1;
    }
    next
}

struct Keep<'a, 'w> {
    model: &'a PhasedModel,
    tests: Vec<PhasedTest>,
    work: &'a mut JobWork<'w>,
    /// Whether it is asked when the tests were.
    wants_spans: bool,
}

impl TestSink for Keep<'_, '_> {
    type Error = SinkRefusal;

    fn tests(&mut self, tests: Vec<Test>, labels: &Labels) -> Result<(), SinkRefusal> {
        SinkRefusal::unless_stopped(self.work)?;
        for test in tests {
            self.tests.push(self.model.split(test, labels).map_err(SinkRefusal::Split)?);
        }
        let done = self.tests.len();
        self.work.say(|| format!("reading: {done} tests"));
        Ok(())
    }

    fn bytes(&mut self, done: u64, of: Option<u64>) -> Result<(), SinkRefusal> {
        SinkRefusal::unless_stopped_at(self.work, done, of)
    }

    fn wants_spans(&self) -> bool {
        self.wants_spans
    }

    fn restart(&mut self) {
        self.tests.clear();
    }
}

/// Reads all tests.
pub(crate) fn read(
    spec: &Spec,
    given: &CommandInputs,
    work: &mut JobWork<'_>,
) -> Result<(Vec<PhasedTest>, DataReading), Failure> {
    keep(spec, (&spec.model, false), given, work)
}

/// Reads all tests, and when each was.
pub(crate) fn read_with_spans(
    spec: &Spec,
    given: &CommandInputs,
    work: &mut JobWork<'_>,
) -> Result<(Vec<PhasedTest>, DataReading), Failure> {
    keep(spec, (&spec.model, true), given, work)
}

/// Reads all tests for a model that has the columns of the file's, and perhaps more texts.
pub(crate) fn read_for(
    spec: &Spec,
    model: &PhasedModel,
    given: &CommandInputs,
    work: &mut JobWork<'_>,
) -> Result<(Vec<PhasedTest>, DataReading), Failure> {
    keep(spec, (model, false), given, work)
}

fn keep(
    spec: &Spec,
    (model, wants_spans): (&PhasedModel, bool),
    given: &CommandInputs,
    work: &mut JobWork<'_>,
) -> Result<(Vec<PhasedTest>, DataReading), Failure> {
    if !given.is_rows() {
        return given.tests(spec, model, work);
    }
    let mut keep = Keep { model, tests: Vec::new(), work, wants_spans };
    let reading = kalfit_data::read_from(model, &spec.layout, &given.inputs, &mut keep, &mut given.stdin());
    let reading = reading.map_err(|error| refused::failure(error, spec))?;
    Ok((keep.tests, reading))
}
