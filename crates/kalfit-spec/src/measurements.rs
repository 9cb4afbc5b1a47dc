//! `[measurements]`: what is observed of the states.

use kalfit::model::{Expression, Measurement};

use crate::error::{Result, SpecError, SpecProblem, StructureProblem};
use crate::expression::{self, ExpressionScope};
use crate::keys;
use crate::motion::{deviation, squared};
use crate::names::{NameContext, NameIndex, ParameterRole, check_label};
use crate::table::{TomlField, TomlTable};

/// Measurements of one model; the covariance of a step's noises grows with its square.
const MAX_MEASUREMENTS: usize = 500;

/// Reads all measurements, and their names.
pub(crate) fn read(
    context: &mut NameContext<'_>,
    field: Option<&TomlField<'_>>,
) -> Result<(Vec<Measurement>, NameIndex)> {
    let table = context.phase.table("measurements");
    let section = field.map(|field| field.section(table.as_str())).transpose()?;
    let found = section.as_ref().map_or(0, TomlTable::len);
    if found == 0 || found > MAX_MEASUREMENTS {
        let problem = SpecProblem::Count { what: "measurements", found, expected: format!("1 to {MAX_MEASUREMENTS}") };
        let error = SpecError::new(problem).hint("a measurement is a table, as in `[measurements.gyro]`");
        return Err(field.map_or(error.clone(), |field| error.at(field.key_span.clone())));
    }
    let mut names = NameIndex::default();
    let mut all: Vec<Measurement> = Vec::with_capacity(found);
    for field in section.iter().flat_map(TomlTable::fields) {
        check_label("measurement", field.key, &field.key_span)?;
        names.add(field.key, field.key_span.clone());
        let one = one(context, &field, &all)?;
        all.push(one);
    }
    Ok((all, names))
}

fn one(context: &mut NameContext<'_>, field: &TomlField<'_>, before: &[Measurement]) -> Result<Measurement> {
    let place = context.phase.entry("measurements", "measurement", field.key);
    let mut section = field.section(place)?.with_keys(keys::MEASUREMENT)?;
    let source = section.need("column")?;
    let column = context.column(source.text()?, source.span.clone(), &source.what());
    let filter = section.take("where").map(|field| filter(context, &field)).transpose()?;
    if filter.is_none()
        && let Some(other) = before.iter().find(|other| other.column == column && other.filter.is_none())
    {
        let problem = StructureProblem::SameCells {
            first: other.name.clone(),
            second: field.key.to_owned(),
            column: context.columns[column].name.clone(),
        };
        return Err(SpecError::new(problem).at(source.span).hint("`where` says which rows a measurement is read from"));
    }
    let equation = section.need("equation")?;
    let place = equation.what();
    let equation = expression::linear(context, &equation, ExpressionScope::equation(&place))?;
    let noise_variance = noise(context, &mut section)?;
    section.finish("here", None)?;
    Ok(Measurement { name: field.key.to_owned(), column, filter, equation, noise_variance })
}

fn filter(context: &mut NameContext<'_>, field: &TomlField<'_>) -> Result<Expression> {
    let place = field.what();
    let filter = expression::condition(context, field, ExpressionScope::rows(&place))?;
    match filter.as_number() {
        None => Ok(filter),
        Some(x) => {
            let why =
                if x == 0.0 { "but to leave out every row: it is never true" } else { "because it is always true" };
            Err(field.no_effect(why))
        }
    }
}

/// Exactly one of `noise` and `variance`.
fn noise(context: &mut NameContext<'_>, section: &mut TomlTable<'_>) -> Result<Expression> {
    let (first, second) = ("noise".to_owned(), "variance".to_owned());
    let place = section.place.clone();
    match (section.take("noise"), section.take("variance")) {
        (Some(noise), None) => {
            let place = noise.what();
            let deviation = deviation(context, &noise, ExpressionScope::row(&place), ParameterRole::StandardDeviation)?;
            squared(context, deviation, &noise.span)
        }
        (None, Some(variance)) => {
            let place = variance.what();
            deviation(context, &variance, ExpressionScope::row(&place), ParameterRole::Variance)
        }
        (Some(_), Some(variance)) => {
            Err(SpecError::new(SpecProblem::Both { place, first, second }).at(variance.key_span))
        }
        (None, None) => Err(SpecError::new(SpecProblem::Neither { place, first, second })
            .at(section.span.clone())
            .hint("`noise` is a standard deviation, `variance` its square; 0 is legal")),
    }
}
