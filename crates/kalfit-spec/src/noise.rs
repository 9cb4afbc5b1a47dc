//! `[process_noise_covariance]` and `[noise_covariance]`: covariances between noises, by pairs of names.

use std::collections::BTreeMap;

use kalfit::model::{Expression, Measurement, State};

use crate::elements::{pair, to_problem};
use crate::error::{Result, Span, SpecError, SpecProblem, StructureProblem};
use crate::expression::{self, ExpressionScope, is_zero};
use crate::names::{NameContext, NameIndex};
use crate::semidefinite::defect;
use crate::states::{noise, rate_of};
use crate::suggest::suggest;
use crate::table::TomlField;

/// (row, column, covariance), row > column, in file order.
pub(crate) type CovarianceEntries = Vec<(usize, usize, Expression)>;

type CovarianceSpans = BTreeMap<(usize, usize), Span>;

/// Reads `[process_noise_covariance]`.
pub(crate) fn between_states(
    context: &mut NameContext<'_>,
    field: Option<TomlField<'_>>,
    states: &[State],
) -> Result<CovarianceEntries> {
    let Some(field) = field else { return Ok(Vec::new()) };
    let place = &context.phase.table("process_noise_covariance");
    let find = |context: &NameContext<'_>, name: &str| {
        context.states.get(name).ok_or_else(|| unknown("state", name, place, suggest(name, context.states.names())))
    };
    let (covariances, spans) = read(context, &field, place, "state", &find)?;
    for (i, j, value) in &covariances {
        let span = &spans[&(*i, *j)];
        let kinds = [*i, *j].map(|state| noise(&states[state]));
        for (state, kind) in [(*i, kinds[0]), (*j, kinds[1])] {
            if kind.is_none_or(|(variance, _)| is_zero(variance)) && !is_zero(value) {
                let other = if state == *i { *j } else { *i };
                return Err(no_noise(states, state, other, place).at(span.clone()));
            }
        }
        if let [Some((_, first_kind)), Some((_, second_kind))] = kinds
            && first_kind != second_kind
        {
            let (first, second) = (states[*i].name.clone(), states[*j].name.clone());
            let problem = StructureProblem::MixedNoise { first, first_kind, second, second_kind };
            return Err(SpecError::new(problem).at(span.clone()));
        }
    }
    let of = |state: usize| {
        let variance = noise(&states[state]).map_or(Some(0.0), |(variance, _)| variance.as_number());
        (states[state].name.clone(), variance)
    };
    check(&covariances, &spans, place, &of, &field.key_span)?;
    Ok(covariances)
}

/// Reads `[noise_covariance]`.
pub(crate) fn between_measurements(
    context: &mut NameContext<'_>,
    field: Option<TomlField<'_>>,
    measurements: &[Measurement],
    names: &NameIndex,
) -> Result<CovarianceEntries> {
    let Some(field) = field else { return Ok(Vec::new()) };
    let place = &context.phase.table("noise_covariance");
    let find = |_: &NameContext<'_>, name: &str| {
        names.get(name).ok_or_else(|| unknown("measurement", name, place, suggest(name, names.names())))
    };
    let (covariances, spans) = read(context, &field, place, "measurement", &find)?;
    let of = |i: usize| (measurements[i].name.clone(), measurements[i].noise_variance.as_number());
    check(&covariances, &spans, place, &of, &field.key_span)?;
    Ok(covariances)
}

type NameLookup<'f> = dyn Fn(&NameContext<'_>, &str) -> Result<usize> + 'f;

fn read(
    context: &mut NameContext<'_>,
    field: &TomlField<'_>,
    place: &str,
    what: &'static str,
    find: &NameLookup<'_>,
) -> Result<(CovarianceEntries, CovarianceSpans)> {
    let section = field.section(place)?;
    let mut seen: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    let mut spans = CovarianceSpans::new();
    let mut all = CovarianceEntries::new();
    for field in section.fields() {
        let (first, second) = pair(&field, place)?;
        let (i, j) = (
            find(context, first).map_err(|error| error.at(field.key_span.clone()))?,
            find(context, second).map_err(|error| error.at(field.key_span.clone()))?,
        );
        if i == j {
            let problem = StructureProblem::Variance { found: field.key.to_owned(), place: place.to_owned() };
            let hint = format!("the noise of a {what} by itself is given in its own table");
            return Err(SpecError::new(problem).at(field.key_span).hint(hint));
        }
        let words = field.what();
        let value = expression::scalar(context, &field, ExpressionScope::row(&words))?;
        let key = (i.max(j), i.min(j));
        match seen.get(&key) {
            None => {
                seen.insert(key, all.len());
                spans.insert(key, field.key_span.clone());
                all.push((key.0, key.1, value));
            }
            Some(&before) if all[before].2 == value => {}
            Some(&before) => {
                let problem = StructureProblem::GivenTwice {
                    element: format!("{first}, {second}"),
                    place: place.to_owned(),
                    first: shown(&all[before].2),
                    second: shown(&value),
                };
                return Err(SpecError::new(problem).at(field.key_span));
            }
        }
    }
    Ok((all, spans))
}

fn shown(value: &Expression) -> String {
    value.as_number().map_or("an expression".to_owned(), |x| x.to_string())
}

/// Refuses covariances that no noise can have, as far as numbers are known; `of` tells the name and variance of one.
fn check(
    covariances: &CovarianceEntries,
    spans: &CovarianceSpans,
    place: &str,
    of: &dyn Fn(usize) -> (String, Option<f64>),
    whole: &Span,
) -> Result<()> {
    let mut involved: Vec<usize> = covariances.iter().flat_map(|(i, j, _)| [*i, *j]).collect();
    involved.sort_unstable();
    involved.dedup();
    let row_of = |i: usize| involved.binary_search(&i).expect("every covariance is between involved noises");
    let mut matrix = vec![vec![Some(0.0); involved.len()]; involved.len()];
    for (row, i) in involved.iter().enumerate() {
        matrix[row][row] = of(*i).1;
    }
    for (i, j, value) in covariances {
        let (i, j) = (row_of(*i), row_of(*j));
        matrix[i][j] = value.as_number();
        matrix[j][i] = matrix[i][j];
    }
    match defect(&matrix) {
        None => Ok(()),
        Some(defect) => {
            let element = defect.element().map(|(i, j)| (involved[i], involved[j]));
            let span = element.and_then(|element| spans.get(&element)).unwrap_or(whole);
            Err(to_problem(&defect, place, &|row| of(involved[row]).0).at(span.clone()))
        }
    }
}

fn no_noise(states: &[State], state: usize, other: usize, place: &str) -> SpecError {
    let problem = StructureProblem::CovarianceWithoutVariance {
        first: states[state].name.clone(),
        second: states[other].name.clone(),
        place: place.to_owned(),
    };
    let hint = match rate_of(states, state) {
        Some(rate) => format!("the noise of this process drives its hidden state `{}`", states[rate].name),
        None => format!("state `{}` has no noise", states[state].name),
    };
    SpecError::new(problem).hint(hint)
}

fn unknown(what: &'static str, name: &str, place: &str, hint: Option<String>) -> SpecError {
    let problem = SpecProblem::UnknownName { what, name: name.to_owned(), place: place.to_owned() };
    SpecError::new(problem).maybe_hint(hint)
}
