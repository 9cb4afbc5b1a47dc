//! `[parameters]`: the numbers that equations name.

use std::collections::BTreeMap;

use kalfit::model::{Parameter, Value};

use crate::error::{Problem, Result, Span, SpecError};
use crate::figure::figure;
use crate::names::{Context, Role, check_name};
use crate::suggest::nearest;
use crate::table::{Field, Section};

const KEYS: [&str; 7] = ["value", "start", "unit", "lower", "upper", "per", "fixed"];

/// Parameters of one model; what is found of them grows with its square.
const MAX_PARAMETERS: usize = 1_000;

/// A parameter with the places of its numbers, for checks that need all of the model.
#[derive(Debug)]
pub(crate) struct Declared {
    pub(crate) parameter: Parameter,
    spans: Spans,
}

#[derive(Debug, Default)]
struct Spans {
    value: Span,
    start: Span,
    lower: Span,
    upper: Span,
    levels: BTreeMap<usize, Span>,
}

/// Reads all parameters, in file order, and makes their names known.
pub(crate) fn read(context: &mut Context<'_>, field: Option<Field<'_>>) -> Result<Vec<Declared>> {
    let Some(field) = field else { return Ok(Vec::new()) };
    let section = field.section("`[parameters]`")?;
    let found = section.len();
    if found > MAX_PARAMETERS {
        let problem = Problem::Count { what: "parameters", found, expected: format!("at most {MAX_PARAMETERS}") };
        return Err(SpecError::new(problem).at(field.key_span));
    }
    let mut all = Vec::with_capacity(found);
    for field in section.fields() {
        check_name("parameter", field.key, &field.key_span)?;
        context.parameters.add(field.key, field.key_span.clone());
        let declared = one(context, &field)?;
        context.levels.push(declared.parameter.per);
        context.roles.push(None);
        all.push(declared);
    }
    Ok(all)
}

fn one(context: &mut Context<'_>, field: &Field<'_>) -> Result<Declared> {
    let mut parameter = Parameter {
        name: field.key.to_owned(),
        unit: None,
        value: Value::Free { start: None },
        per: None,
        fixed_levels: BTreeMap::new(),
        lower: None,
        upper: None,
        positive: false,
    };
    let mut spans = Spans::default();
    if !field.is_table() {
        parameter.value = Value::Fixed(field.number_or("a number or a table such as `{ start = 1 }`")?);
        spans.value = field.span.clone();
        return Ok(Declared { parameter, spans });
    }
    let mut section = field.section(format!("parameter `{}`", field.key))?.only(&KEYS)?;
    parameter.unit = section.take("unit").map(|unit| unit.text().map(str::to_owned)).transpose()?;
    let value = bound(&mut section, "value", &mut spans.value)?;
    let start = bound(&mut section, "start", &mut spans.start)?;
    parameter.lower = bound(&mut section, "lower", &mut spans.lower)?;
    parameter.upper = bound(&mut section, "upper", &mut spans.upper)?;
    parameter.value = match (value, start) {
        (Some(value), None) => Value::Fixed(value),
        (None, start) => Value::Free { start },
        (Some(_), Some(_)) => {
            let (first, second) = ("value".to_owned(), "start".to_owned());
            let problem = Problem::Both { place: section.place.clone(), first, second };
            let hint = "`value` fixes a parameter, `start` leaves it free";
            return Err(SpecError::new(problem).at(spans.start).hint(hint));
        }
    };
    read_levels(context, &mut section, &mut parameter, &mut spans)?;
    section.finish("here", None)?;
    Ok(Declared { parameter, spans })
}

fn bound(section: &mut Section<'_>, key: &str, span: &mut Span) -> Result<Option<f64>> {
    let Some(field) = section.take(key) else { return Ok(None) };
    *span = field.span.clone();
    field.number().map(Some)
}

fn read_levels(
    context: &mut Context<'_>,
    section: &mut Section<'_>,
    parameter: &mut Parameter,
    spans: &mut Spans,
) -> Result<()> {
    let fixed = section.take("fixed");
    let Some(per) = section.take("per") else {
        return match fixed {
            None => Ok(()),
            Some(fixed) => Err(fixed
                .no_effect("without `per`")
                .hint("`per` names the column whose levels have a value each; `value` fixes a parameter as a whole")),
        };
    };
    let place = format!("`per` of {}", section.place);
    parameter.per = Some(context.text_column(per.text()?, per.span.clone(), &place));
    if let Some(fixed) = fixed {
        for level in fixed.section(format!("`fixed` of {}", section.place))?.fields() {
            let literal = context.literals.add(level.key);
            parameter.fixed_levels.insert(literal, level.number()?);
            spans.levels.insert(literal, level.span.clone());
        }
    }
    if matches!(parameter.value, Value::Fixed(_)) && parameter.fixed_levels.is_empty() {
        return Err(per.no_effect("on a parameter whose levels all have the same `value`"));
    }
    Ok(())
}

/// Checks values and bounds now that all uses are known, and marks what is positive; `serve`: what each does in the whole model.
pub(crate) fn finish(
    context: &mut Context<'_>,
    declared: Vec<Declared>,
    serve: &[kalfit::model::Role],
) -> Result<Vec<Parameter>> {
    for (used, served) in context.roles.iter_mut().zip(serve) {
        if let Some(used) = used {
            *used = (*used).max(Role::from(*served));
        }
    }
    declared.into_iter().enumerate().map(|(index, one)| checked(context, index, one)).collect()
}

fn checked(context: &Context<'_>, index: usize, Declared { mut parameter, spans }: Declared) -> Result<Parameter> {
    let role = match context.roles[index] {
        Some(role) => role,
        None if !context.reads.measurements => Role::Coefficient, // of what is not read
        None => return Err(unused(context, index, parameter.name)),
    };
    let at = |span: &Span| {
        let span = span.clone();
        move |problem: Problem| SpecError::new(problem).at(span)
    };
    parameter.positive = role != Role::Coefficient;
    check_bounds(&parameter, role, &spans)?;
    match parameter.value {
        Value::Fixed(value) => check_value(&parameter, role, value).map_err(at(&spans.value))?,
        Value::Free { start: Some(start) } => {
            check_value(&parameter, role, start).map_err(at(&spans.start))?;
            if parameter.positive && start <= 0.0 {
                let what = format!("start of {} `{}`", role.words(), parameter.name);
                let problem = Problem::OutOfRange { what, found: start, expected: "more than 0".to_owned() };
                return Err(at(&spans.start)(problem).hint("to fix it at 0, write `value = 0`"));
            }
        }
        Value::Free { start: None } => {}
    }
    for (literal, value) in &parameter.fixed_levels {
        check_value(&parameter, role, *value).map_err(at(&spans.levels[literal]))?;
    }
    Ok(parameter)
}

/// A name that is misspelt where it is used has become a column.
fn unused(context: &Context<'_>, index: usize, name: String) -> SpecError {
    let columns = context.columns.iter().map(|column| column.name.as_str());
    let hint = nearest(&name, columns)
        .and_then(|near| context.columns.iter().find(|column| column.name == near))
        .map(|column| format!("{} names `{}`, which is then a column of the data", column.used_in, column.name));
    SpecError::new(Problem::Unused { name }).at(context.parameters.span(index)).maybe_hint(hint)
}

fn check_bounds(parameter: &Parameter, role: Role, spans: &Spans) -> Result<()> {
    let name = &parameter.name;
    let wrong = |key: &str, found: f64, expected: String, span: &Span| {
        let what = format!("`{key}` of {} `{name}`", role.words());
        Err(SpecError::new(Problem::OutOfRange { what, found, expected }).at(span.clone()))
    };
    if let Some(lower) = parameter.lower
        && parameter.positive
        && lower < 0.0
    {
        return wrong("lower", lower, "0 or more".to_owned(), &spans.lower);
    }
    if let Some(upper) = parameter.upper {
        if parameter.positive && upper <= 0.0 {
            return wrong("upper", upper, "more than 0".to_owned(), &spans.upper);
        }
        if let Some(lower) = parameter.lower
            && upper <= lower
        {
            return wrong("upper", upper, format!("more than `lower`, which is {}", figure(lower)), &spans.upper);
        }
    }
    Ok(())
}

/// Whether a parameter can have a value.
pub(crate) fn check_value(parameter: &Parameter, role: Role, value: f64) -> std::result::Result<(), Problem> {
    let expected = if let Some(expected) = role.expected(value) {
        expected.to_owned()
    } else if let Some(lower) = parameter.lower.filter(|lower| value < *lower) {
        format!("at least {}, its `lower` bound", figure(lower))
    } else if let Some(upper) = parameter.upper.filter(|upper| value > *upper) {
        format!("at most {}, its `upper` bound", figure(upper))
    } else {
        return Ok(());
    };
    Err(Problem::OutOfRange { what: format!("{} `{}`", role.words(), parameter.name), found: value, expected })
}
