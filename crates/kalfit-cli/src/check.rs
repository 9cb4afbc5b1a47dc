//! `kalfit check`: everything but the fit.

use kalfit::estimate::Structure;
use kalfit::model::Value;
use kalfit::record::{DataRecord, ObservabilityRecord, UnidentifiedRecord, WeakRecord, shortage_notes};
use kalfit::{Labels, Test, infer};
use kalfit_data::{Input, ReadError, Reading, Sink};
use kalfit_report::{CheckRecord, Checked, check_summary};
use kalfit_spec::Spec;

use crate::failure::Failure;
use crate::job::{CheckJob, Outcome};
use crate::progress::Line;
use crate::{model, reductions, terminal};

pub(crate) fn run(job: &CheckJob) -> Result<Outcome, Failure> {
    let mut spec = model::load(&job.model)?;
    let (title, words) = (spec.model.title.clone(), spec.describe());
    let checked = if job.data.is_empty() { Checked::Model } else { data(&mut spec, &job.data)? };
    let record = CheckRecord { title, model: words, states: spec.model.estimated_names(), checked };
    terminal::print(&check_summary(&record, &terminal::style())).map_err(Failure::Stdout)?;
    Ok(Outcome::Done)
}

/// Reads the data and runs the filters if it can.
fn data(spec: &mut Spec, args: &[String]) -> Result<Checked, Failure> {
    let inputs = Input::expand(args).map_err(|error| Failure::data(error, spec))?;
    let at_start_of = start_values(spec)?;
    let files: Vec<String> = inputs.iter().map(Input::name).collect();
    let free = model::free_parameters(&spec.model);
    if !free.is_empty() {
        let Reading { tests, rows, .. } = count(spec, &inputs)?;
        return Ok(Checked::Read { tests, rows, files, free });
    }
    let mut line = Line::new(false);
    let alpha = model::alpha(spec)?;
    let reductions = reductions::reduce(spec, &alpha, &inputs, &mut line)?;
    line.clear();
    let found = infer::examine_at_start(&reductions, &Structure::of(&spec.model, &alpha)).map_err(Failure::Fit)?;
    let model = &spec.model;
    Ok(Checked::Reduced {
        data: DataRecord::of(&reductions, files),
        observability: ObservabilityRecord::all(model, &found.observability),
        unidentified: UnidentifiedRecord::all(model, &found.unidentified, &found.explanations),
        weak: WeakRecord::all(&found.observability),
        notes: shortage_notes(model, &found.observability),
        at_start_of,
    })
}

/// Puts free parameters at their start values, where they have one; returns their names.
fn start_values(spec: &mut Spec) -> Result<Vec<String>, Failure> {
    let mut started = Vec::new();
    for name in model::free_parameters(&spec.model) {
        let start = spec.model.parameters.iter().find(|p| p.name == name).map(|p| p.value);
        if let Some(Value::Free { start: Some(start) }) = start {
            spec.set(&format!("{name}={start}")).map_err(|error| Failure::Set { error: Box::new(error) })?;
            started.push(name);
        }
    }
    Ok(started)
}

/// Reads the data for what can be said of them when parameters have no values.
fn count(spec: &Spec, inputs: &[Input]) -> Result<Reading, Failure> {
    struct Forget;
    impl Sink for Forget {
        type Error = std::convert::Infallible;

        fn tests(&mut self, _: Vec<Test>, _: &Labels) -> Result<(), Self::Error> {
            Ok(())
        }

        fn restart(&mut self) {}
    }
    kalfit_data::read(&spec.model, &spec.layout, inputs, &mut Forget).map_err(|error| match error {
        ReadError::Data(error) => Failure::data(error, spec),
        ReadError::Sink { error, .. } => match error {},
    })
}
