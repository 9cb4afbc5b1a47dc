//! Data that are kept whole: what the filters run over again and again, or what others are drawn like.

use std::convert::Infallible;

use kalfit::{Labels, PhasedModel, Test};
use kalfit_data::{Input, ReadError, Reading, Sink};
use kalfit_spec::Spec;

use crate::failure::Failure;
use crate::progress::Line;

struct Keep<'a>(Vec<Test>, &'a mut Line);

impl Sink for Keep<'_> {
    type Error = Infallible;

    fn tests(&mut self, tests: Vec<Test>, _: &Labels) -> Result<(), Infallible> {
        self.0.extend(tests);
        let done = self.0.len();
        self.1.say(|| format!("reading: {done} tests"));
        Ok(())
    }

    fn restart(&mut self) {
        self.0.clear();
    }
}

/// Reads all tests.
pub(crate) fn read(spec: &Spec, inputs: &[Input], line: &mut Line) -> Result<(Vec<Test>, Reading), Failure> {
    read_for(spec, &spec.model, inputs, line)
}

/// Reads all tests for a model that has the columns of the file's, and perhaps more texts.
pub(crate) fn read_for(
    spec: &Spec,
    model: &PhasedModel,
    inputs: &[Input],
    line: &mut Line,
) -> Result<(Vec<Test>, Reading), Failure> {
    let mut keep = Keep(Vec::new(), line);
    let reading = kalfit_data::read(model, &spec.layout, inputs, &mut keep).map_err(|error| match error {
        ReadError::Data(error) => Failure::data(error, spec),
        ReadError::Sink { error, .. } => match error {},
    })?;
    Ok((keep.0, reading))
}
