//! `kalfit check`: everything but the fit.

use kalfit::estimate::Structure;
use kalfit::model::Value;
use kalfit::record::{
    DataRecord, LevelCounts, ObservabilityRecord, UnidentifiedRecord, WeakRecord, level_notes, shortage_notes,
};
use kalfit::score::Slots;
use kalfit::{Alpha, Model, Reduction, infer};
use kalfit_data::{Input, Reading};
use kalfit_report::{CheckRecord, Checked, ParameterCounts, check_summary};
use kalfit_spec::Spec;

use crate::failure::Failure;
use crate::job::{CheckJob, Outcome};
use crate::progress::Line;
use crate::{model, reductions, terminal, tests};

pub(crate) fn run(job: &CheckJob) -> Result<Outcome, Failure> {
    let spec = model::load(&job.model)?;
    let free = model::has_free(spec.model.shared());
    let (parameters, checked) = match (job.data.is_empty(), free) {
        (true, _) => (Vec::new(), Checked::Model),
        (false, false) => (Vec::new(), known(&spec, &job.data)?),
        (false, true) => started(&spec, &job.data)?,
    };
    let (title, states) = (spec.model.shared().title.clone(), spec.model.estimated_names());
    let record = CheckRecord { title, model: spec.describe(), states, parameters, checked };
    terminal::print(&check_summary(&record, &terminal::style())).map_err(Failure::Stdout)?;
    Ok(Outcome::Done)
}

/// Reads the data and runs the filters: all parameters are known.
fn known(spec: &Spec, args: &[String]) -> Result<Checked, Failure> {
    let inputs = Input::expand(args).map_err(|error| Failure::data(error, spec))?;
    let mut line = Line::new(false);
    let alpha = model::alpha(spec);
    let reductions = reductions::reduce(spec, &alpha, &inputs, &mut line)?;
    line.clear();
    examined(spec.model.shared(), &alpha, &reductions, files(&inputs), (Vec::new(), Vec::new()))
}

/// Reads the data, counts the free values that they have use for, and runs the filters at start values if all are given.
fn started(spec: &Spec, args: &[String]) -> Result<(Vec<ParameterCounts>, Checked), Failure> {
    let inputs = Input::expand(args).map_err(|error| Failure::data(error, spec))?;
    let (model, mut line) = (spec.model.shared(), Line::new(false));
    let (tests, reading) = tests::read(spec, &inputs, &mut line)?;
    let slots = Slots::new(model, &reading.labels, &tests);
    let counts = LevelCounts::all(model, &reading.labels, &tests);
    let notes = level_notes(model, &counts);
    let parameters = parameters(model, &slots, &counts);
    let start = |slot: &kalfit::score::Slot| match model.parameters[slot.parameter].value {
        Value::Free { start } => start,
        Value::Fixed(value) => Some(value),
    };
    let starts: Option<Vec<f64>> = slots.slots().iter().map(start).collect();
    let Some(starts) = starts else {
        line.clear();
        let without = |p: &&ParameterCounts| p.free > 0 && p.start.is_none();
        let free = parameters.iter().filter(without).map(|p| p.name.clone()).collect();
        let Reading { tests, rows, .. } = reading;
        return Ok((parameters, Checked::Read { tests, rows, files: files(&inputs), free, notes }));
    };
    let alpha = slots.alpha(model, &starts);
    let reductions = reductions::of(model, &alpha, &tests, &reading)?;
    line.clear();
    let at_start_of = parameters.iter().filter(|p| p.free > 0).map(|p| p.name.clone()).collect();
    let said = (notes, at_start_of);
    let checked = examined(model, &alpha, &reductions, files(&inputs), said)?;
    Ok((parameters, checked))
}

/// What the reductions say.
fn examined(
    model: &Model,
    alpha: &Alpha,
    reductions: &[Reduction],
    files: Vec<String>,
    (mut notes, at_start_of): (Vec<String>, Vec<String>),
) -> Result<Checked, Failure> {
    let found = infer::examine_at_start(reductions, &Structure::single(&model.mean, &model.covariance, alpha))
        .map_err(Failure::Fit)?;
    notes.splice(0..0, shortage_notes(model, &found.observability));
    Ok(Checked::Reduced {
        data: DataRecord::of(reductions, files),
        observability: ObservabilityRecord::all(model, &found.observability),
        unidentified: UnidentifiedRecord::all(model, &found.unidentified, &found.explanations),
        weak: WeakRecord::all(&found.observability),
        notes,
        at_start_of,
    })
}

/// The parameters that have free values, or would have with other data.
fn parameters(model: &Model, slots: &Slots, counts: &[LevelCounts]) -> Vec<ParameterCounts> {
    let of = |(index, parameter): (usize, &kalfit::model::Parameter)| {
        let Value::Free { start } = parameter.value else { return None };
        let levels = counts.iter().find(|c| c.parameter == index).map_or(Vec::new(), |c| c.tests.clone());
        let free = slots.slots().iter().filter(|slot| slot.parameter == index).count();
        Some(ParameterCounts {
            name: parameter.name.clone(),
            per: parameter.per.map(|column| model.text_columns[column].name.clone()),
            free,
            fixed: levels.len().saturating_sub(free),
            start,
            levels,
        })
    };
    model.parameters.iter().enumerate().filter_map(of).collect()
}

fn files(inputs: &[Input]) -> Vec<String> {
    inputs.iter().map(Input::name).collect()
}
