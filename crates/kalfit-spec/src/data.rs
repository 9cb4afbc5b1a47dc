//! `[data]`: what tells tests apart, and where steps and times come from.

use kalfit::model::{Clock, Expression, Model, Motion};
use kalfit::{Layout, TestKey};

use crate::error::{Problem, Result, Span, SpecError};
use crate::names::Context;
use crate::suggest::suggest;
use crate::table::{Field, Section};

const KEYS: [&str; 9] =
    ["test", "time", "time_unit", "initial_time", "step_first", "inputs", "group", "missing", "phase"];
const PLACE: &str = "`[data]`";

/// What `[data]` says.
#[derive(Debug, Default)]
pub(crate) struct Data {
    pub(crate) layout: Layout,
    pub(crate) clock: Clock,
    pub(crate) group: Option<usize>,
    initial_time: Option<Span>,
    step_first: Option<Span>,
    previous_inputs: Option<Span>,
}

/// Reads `[data]`; without it all rows are one test.
pub(crate) fn read(context: &mut Context<'_>, field: Option<Field<'_>>) -> Result<Data> {
    let Some(field) = field else { return Ok(Data::default()) };
    let mut section = field.section(PLACE)?.only(&KEYS)?;
    if let Some(phase) = section.peek("phase") {
        let problem = Problem::Unsupported { what: "`phase` in `[data]`".to_owned() };
        return Err(SpecError::new(problem).at(phase.key_span));
    }
    let mut data = Data::default();
    if let Some(test) = section.take("test") {
        data.layout.test = test_key(context, &test)?;
    }
    if let Some(missing) = section.take("missing") {
        data.layout.missing = missing.texts()?.into_iter().map(|(text, _)| text.to_owned()).collect();
    }
    if let Some(group) = section.take("group") {
        data.group = Some(context.text_column(group.text()?, group.span.clone(), "`group` in `[data]`"));
    }
    read_clock(context, &mut section, &mut data)?;
    section.finish("here", None)?;
    Ok(data)
}

fn test_key(context: &mut Context<'_>, field: &Field<'_>) -> Result<TestKey> {
    let text = field.text()?;
    if text == "@file" {
        return Ok(TestKey::File);
    }
    if text.starts_with('@') {
        let problem = Problem::UnknownWord {
            what: "test".to_owned(),
            place: PLACE.to_owned(),
            found: text.to_owned(),
            expected: "`@file` or the name of a column".to_owned(),
        };
        return Err(SpecError::new(problem).at(field.span.clone()).maybe_hint(suggest(text, ["@file"])));
    }
    context.see_column(text, field.span.clone());
    Ok(TestKey::Column(text.to_owned()))
}

fn read_clock(context: &mut Context<'_>, section: &mut Section<'_>, data: &mut Data) -> Result<()> {
    let clock = &mut data.clock;
    if let Some(time) = section.take("time") {
        clock.time = Some(context.column(time.text()?, time.span.clone(), "`time` in `[data]`"));
    }
    context.time = clock.time.is_some();
    for key in ["time_unit", "initial_time"] {
        if let Some(field) = section.peek(key)
            && clock.time.is_none()
        {
            return Err(field.no_effect("without `time`").hint("`time` names the column with the time of each row"));
        }
    }
    if let Some(unit) = section.take("time_unit") {
        clock.unit = Some(unit.text()?.to_owned());
    }
    if let Some(initial) = section.take("initial_time") {
        clock.initial_time = Some(initial_time(context, &initial)?);
        data.initial_time = Some(initial.key_span);
    }
    if let Some(first) = section.take("step_first") {
        clock.step_first = first.truth()?;
        if clock.step_first && clock.initial_time.is_some() {
            return Err(first
                .no_effect("beside `initial_time`")
                .hint("with `initial_time` a step from x_0 precedes the first row anyway"));
        }
        data.step_first = clock.step_first.then_some(first.key_span);
    }
    if let Some(inputs) = section.take("inputs") {
        clock.previous_inputs = inputs.word(&["previous", "current"])? == 0;
        data.previous_inputs = clock.previous_inputs.then_some(inputs.key_span);
    }
    Ok(())
}

fn initial_time(context: &mut Context<'_>, field: &Field<'_>) -> Result<Expression> {
    let expected = "a number or the name of a column";
    let Some(text) = field.as_text() else { return Ok(Expression::Number(field.number_or(expected)?)) };
    if text.trim().parse::<f64>().is_ok() {
        return Err(field.wrong_type(expected).hint(format!("write the number without quotes: {}", text.trim())));
    }
    let column = context.column(text, field.span.clone(), "`initial_time` in `[data]`");
    Ok(Expression::Column(column))
}

impl Data {
    /// Refuses what has no effect on this model, and steps of unknown length.
    pub(crate) fn check(&self, model: &Model) -> Result<()> {
        let moves = model.states.iter().any(|state| state.motion != Motion::Constant);
        let uses_step = uses(model, &mut |part| matches!(part, Expression::Step));
        if let Some(span) = &self.step_first {
            if !moves {
                return Err(idle("step_first", "when no state moves", span));
            }
            let needs_length = model.states.iter().find(|state| needs_length(&state.motion));
            if let Some(state) = needs_length {
                let what = format!("the motion of state `{}`", state.name);
                return Err(SpecError::new(Problem::FirstStepWithoutLength { what })
                    .at(span.clone())
                    .hint("`initial_time` says when the first step begins"));
            }
        }
        if let Some(span) = &self.initial_time
            && !moves
            && !uses_step
        {
            return Err(idle("initial_time", "when no state moves", span));
        }
        if let Some(span) = &self.previous_inputs {
            let mut from_row = |part: &Expression| match part {
                Expression::Column(_) | Expression::TextEquals { .. } => true,
                Expression::Parameter(index) => model.parameters[*index].per.is_some(),
                _ => false,
            };
            let covariances = model.process_noise_covariance.iter().any(|(_, _, q)| q.any(&mut from_row));
            if !covariances && !model.states.iter().any(|state| in_motion(&state.motion, &mut from_row)) {
                return Err(idle("inputs", "when no motion uses a column", span));
            }
        }
        Ok(())
    }
}

fn idle(key: &str, why: &str, span: &Span) -> SpecError {
    SpecError::new(Problem::NoEffect { key: key.to_owned(), why: why.to_owned() }).at(span.clone())
}

fn needs_length(motion: &Motion) -> bool {
    matches!(motion, Motion::Continuous { .. }) || in_motion(motion, &mut |part| matches!(part, Expression::Step))
}

/// True when `test` holds for a part of a motion.
fn in_motion(motion: &Motion, test: &mut dyn FnMut(&Expression) -> bool) -> bool {
    match motion {
        Motion::Constant => false,
        Motion::Continuous { derivative: linear, noise_variance }
        | Motion::Discrete { next: linear, noise_variance } => {
            linear.terms.iter().any(|(_, a)| a.any(test)) || linear.constant.any(test) || noise_variance.any(test)
        }
    }
}

/// True when `test` holds for a part of a motion or measurement.
fn uses(model: &Model, test: &mut dyn FnMut(&Expression) -> bool) -> bool {
    model.states.iter().any(|state| in_motion(&state.motion, test))
        || model.measurements.iter().any(|measurement| {
            measurement.equation.terms.iter().any(|(_, a)| a.any(test))
                || measurement.equation.constant.any(test)
                || measurement.noise_variance.any(test)
                || measurement.filter.as_ref().is_some_and(|filter| filter.any(test))
        })
        || model.noise_covariance.iter().any(|(_, _, r)| r.any(test))
}
