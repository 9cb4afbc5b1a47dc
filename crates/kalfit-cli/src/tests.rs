//! Data that are kept whole: what the filters run over again and again, or what others are drawn like.

use kalfit::reduce::SplitError;
use kalfit::{Labels, PhasedModel, PhasedTest, Test};
use kalfit_data::{ReadError, Reading, Sink};
use kalfit_spec::Spec;

use crate::evidence::Given;
use crate::failure::Failure;
use crate::progress::Line;

struct Keep<'a> {
    model: &'a PhasedModel,
    tests: Vec<PhasedTest>,
    line: &'a mut Line,
}

impl Sink for Keep<'_> {
    type Error = SplitError;

    fn tests(&mut self, tests: Vec<Test>, labels: &Labels) -> Result<(), SplitError> {
        for test in tests {
            self.tests.push(self.model.split(test, labels)?);
        }
        let done = self.tests.len();
        self.line.say(|| format!("reading: {done} tests"));
        Ok(())
    }

    fn restart(&mut self) {
        self.tests.clear();
    }
}

/// Reads all tests.
pub(crate) fn read(spec: &Spec, given: &Given, line: &mut Line) -> Result<(Vec<PhasedTest>, Reading), Failure> {
    read_for(spec, &spec.model, given, line)
}

/// Reads all tests for a model that has the columns of the file's, and perhaps more texts.
pub(crate) fn read_for(
    spec: &Spec,
    model: &PhasedModel,
    given: &Given,
    line: &mut Line,
) -> Result<(Vec<PhasedTest>, Reading), Failure> {
    if !given.is_rows() {
        return given.tests(spec, model, line);
    }
    let mut keep = Keep { model, tests: Vec::new(), line };
    let reading = kalfit_data::read_from(model, &spec.layout, &given.inputs, &mut keep, &mut given.stdin());
    let reading = reading.map_err(|error| match error {
        ReadError::Data(error) => Failure::data(error, spec),
        ReadError::Sink { error, reading } => Failure::Split { error, reading },
    })?;
    Ok((keep.tests, reading))
}
