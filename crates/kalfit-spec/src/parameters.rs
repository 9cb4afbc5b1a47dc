//! `[parameters]`: the numbers that equations name.

use std::collections::BTreeMap;

use kalfit::model::{Parameter, Value};

use crate::error::{Result, Span, SpecError, SpecProblem};
use crate::figure::figure;
use crate::keys;
use crate::names::{NameContext, ParameterRole, check_name};
use crate::suggest::nearest;
use crate::table::{TomlField, TomlTable};

/// Parameters of one model; what is found of them grows with its square.
const MAX_PARAMETERS: usize = 1_000;

/// A parameter with the places of its numbers, for checks that need all of the model.
#[derive(Debug)]
pub(crate) struct DeclaredParameter {
    pub(crate) parameter: Parameter,
    spans: ParameterSpans,
}

#[derive(Debug, Default)]
struct ParameterSpans {
    value: Span,
    start: Span,
    lower: Span,
    upper: Span,
    levels: BTreeMap<usize, Span>,
}

/// Reads all parameters, in file order, and makes their names known.
pub(crate) fn read(context: &mut NameContext<'_>, field: Option<TomlField<'_>>) -> Result<Vec<DeclaredParameter>> {
    let Some(field) = field else { return Ok(Vec::new()) };
    let section = field.section("`[parameters]`")?;
    let found = section.len();
    if found > MAX_PARAMETERS {
        let problem = SpecProblem::Count { what: "parameters", found, expected: format!("at most {MAX_PARAMETERS}") };
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

fn one(context: &mut NameContext<'_>, field: &TomlField<'_>) -> Result<DeclaredParameter> {
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
    let mut spans = ParameterSpans::default();
    if !field.is_table() {
        parameter.value = Value::Fixed(field.number_or("a number or a table such as `{ start = 1 }`")?);
        spans.value = field.span.clone();
        return Ok(DeclaredParameter { parameter, spans });
    }
    let mut section = field.section(format!("parameter `{}`", field.key))?.with_keys(keys::PARAMETER)?;
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
            let problem = SpecProblem::Both { place: section.place.clone(), first, second };
            let hint = "`value` fixes a parameter, `start` leaves it free";
            return Err(SpecError::new(problem).at(spans.start).hint(hint));
        }
    };
    read_levels(context, &mut section, &mut parameter, &mut spans)?;
    section.finish("here", None)?;
    Ok(DeclaredParameter { parameter, spans })
}

fn bound(section: &mut TomlTable<'_>, key: &str, span: &mut Span) -> Result<Option<f64>> {
    let Some(field) = section.take(key) else { return Ok(None) };
    *span = field.span.clone();
    field.number().map(Some)
}

fn read_levels(
    context: &mut NameContext<'_>,
    section: &mut TomlTable<'_>,
    parameter: &mut Parameter,
    spans: &mut ParameterSpans,
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
    context: &mut NameContext<'_>,
    declared: Vec<DeclaredParameter>,
    serve: &[kalfit::model::Role],
) -> Result<Vec<Parameter>> {
    for (used, served) in context.roles.iter_mut().zip(serve) {
        if let Some(used) = used {
            *used = (*used).max(ParameterRole::from(*served));
        }
    }
    declared.into_iter().enumerate().map(|(index, one)| checked(context, index, one)).collect()
}

fn checked(
    context: &NameContext<'_>,
    index: usize,
    DeclaredParameter { mut parameter, spans }: DeclaredParameter,
) -> Result<Parameter> {
    let role = match context.roles[index] {
        Some(role) => role,
        None if !context.reads.measurements => ParameterRole::Coefficient, // of what is not read
        None => return Err(unused(context, index, parameter.name)),
    };
    let at = |span: &Span| {
        let span = span.clone();
        move |problem: SpecProblem| SpecError::new(problem).at(span)
    };
    parameter.positive = role != ParameterRole::Coefficient;
    check_bounds(&parameter, role, &spans)?;
    match parameter.value {
        Value::Fixed(value) => check_value(&parameter, role, value).map_err(at(&spans.value))?,
        Value::Free { start: Some(start) } => {
            check_value(&parameter, role, start).map_err(at(&spans.start))?;
            if parameter.positive && start <= 0.0 {
                let what = format!("start of {} `{}`", role.words(), parameter.name);
                let problem = SpecProblem::OutOfRange { what, found: start, expected: "more than 0".to_owned() };
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
fn unused(context: &NameContext<'_>, index: usize, name: String) -> SpecError {
    let columns = context.columns.iter().map(|column| column.name.as_str());
    let hint = nearest(&name, columns)
        .and_then(|near| context.columns.iter().find(|column| column.name == near))
        .map(|column| format!("{} names `{}`, which is then a column of the data", column.used_in, column.name));
    SpecError::new(SpecProblem::Unused { name }).at(context.parameters.span(index)).maybe_hint(hint)
}

fn check_bounds(parameter: &Parameter, role: ParameterRole, spans: &ParameterSpans) -> Result<()> {
    let name = &parameter.name;
    let wrong = |key: &str, found: f64, expected: String, span: &Span| {
        let what = format!("`{key}` of {} `{name}`", role.words());
        Err(SpecError::new(SpecProblem::OutOfRange { what, found, expected }).at(span.clone()))
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
pub(crate) fn check_value(
    parameter: &Parameter,
    role: ParameterRole,
    value: f64,
) -> std::result::Result<(), SpecProblem> {
    let expected = if let Some(expected) = role.expected(value) {
        expected.to_owned()
    } else if let Some(lower) = parameter.lower.filter(|lower| value < *lower) {
        format!("at least {}, its `lower` bound", figure(lower))
    } else if let Some(upper) = parameter.upper.filter(|upper| value > *upper) {
        format!("at most {}, its `upper` bound", figure(upper))
    } else {
        return Ok(());
    };
    Err(SpecProblem::OutOfRange { what: format!("{} `{}`", role.words(), parameter.name), found: value, expected })
}
