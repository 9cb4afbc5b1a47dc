//! Data → reductions: tests are reduced as they are read, and forgotten.

use kalfit::reduce::{ReduceError, Reducer};
use kalfit::{Alpha, Labels, Model, Reduction, Test};
use kalfit_data::{Input, ReadError, Reading, Sink};
use kalfit_spec::Spec;

use crate::failure::Failure;
use crate::innovations::{Kept, KeptTests};
use crate::progress::Line;

struct Reducing<'a> {
    reducer: Reducer,
    reductions: Vec<Reduction>,
    kept: &'a mut KeptTests,
    line: &'a mut Line,
}

impl Sink for Reducing<'_> {
    type Error = ReduceError;

    fn tests(&mut self, tests: Vec<Test>, _: &Labels) -> Result<(), ReduceError> {
        self.reductions.extend(self.reducer.reduce(&tests)?);
        self.kept.take(tests);
        let done = self.reductions.len();
        self.line.say(|| format!("reading: {done} tests"));
        Ok(())
    }

    fn restart(&mut self) {
        self.reductions.clear();
        self.kept.restart();
    }
}

/// Reads the data and runs the filters over them at α.
pub(crate) fn reduce(spec: &Spec, alpha: &Alpha, inputs: &[Input], line: &mut Line) -> Result<Vec<Reduction>, Failure> {
    reduce_keeping(spec, alpha, inputs, line, &mut Kept::nothing())
}

/// [`reduce`], keeping what a second look at the data takes.
pub(crate) fn reduce_keeping(
    spec: &Spec,
    alpha: &Alpha,
    inputs: &[Input],
    line: &mut Line,
    kept: &mut Kept,
) -> Result<Vec<Reduction>, Failure> {
    let reducer = Reducer::new(spec.model.shared(), alpha).map_err(|error| Failure::Reduce { error, reading: None })?;
    let mut stdin = std::io::stdin().lock();
    let Kept { tests, copy } = kept;
    let mut sink = Reducing { reducer, reductions: Vec::new(), kept: tests, line };
    let mut stdin = copy.copying(&mut stdin);
    kalfit_data::read_from(&spec.model, &spec.layout, inputs, &mut sink, &mut stdin).map_err(|error| match error {
        ReadError::Data(error) => Failure::data(error, spec),
        ReadError::Sink { error, reading } => Failure::Reduce { error, reading: Some(reading) },
    })?;
    Ok(sink.reductions)
}

/// Runs the filters over tests that were kept.
pub(crate) fn of(model: &Model, alpha: &Alpha, tests: &[Test], reading: &Reading) -> Result<Vec<Reduction>, Failure> {
    Reducer::new(model, alpha)
        .and_then(|mut reducer| reducer.reduce(tests))
        .map_err(|error| Failure::Reduce { error, reading: Some(Box::new(reading.clone())) })
}
