//! Data → reductions: tests are reduced as they are read, and forgotten.

use kalfit::reduce::{ReduceError, Reducer};
use kalfit::{Alpha, Labels, Reduction, Test};
use kalfit_data::{Input, ReadError, Sink};
use kalfit_spec::Spec;

use crate::failure::Failure;
use crate::progress::Line;

struct Reducing<'a> {
    reducer: Reducer,
    reductions: Vec<Reduction>,
    line: &'a mut Line,
}

impl Sink for Reducing<'_> {
    type Error = ReduceError;

    fn tests(&mut self, tests: Vec<Test>, _: &Labels) -> Result<(), ReduceError> {
        self.reductions.extend(self.reducer.reduce(&tests)?);
        let done = self.reductions.len();
        self.line.say(|| format!("reading: {done} tests"));
        Ok(())
    }

    fn restart(&mut self) {
        self.reductions.clear();
    }
}

/// Reads the data and runs the filters over them at α.
pub(crate) fn reduce(spec: &Spec, alpha: &Alpha, inputs: &[Input], line: &mut Line) -> Result<Vec<Reduction>, Failure> {
    let reducer = Reducer::new(&spec.model, alpha).map_err(|error| Failure::Reduce { error, reading: None })?;
    let mut sink = Reducing { reducer, reductions: Vec::new(), line };
    kalfit_data::read(&spec.model, &spec.layout, inputs, &mut sink).map_err(|error| match error {
        ReadError::Data(error) => Failure::data(error, spec),
        ReadError::Sink { error, reading } => Failure::Reduce { error, reading: Some(reading) },
    })?;
    Ok(sink.reductions)
}
