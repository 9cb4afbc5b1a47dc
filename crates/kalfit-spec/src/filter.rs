//! `[filter]`: a filter that is not the optimal one.

use kalfit::model::{Expression, Filter, Model, Parameter, State, Value};
use nalgebra::DMatrix;

use crate::data::uses;
use crate::elements::NamedElements;
use crate::error::{Result, Span, SpecError, SpecProblem, StructureProblem};
use crate::keys;
use crate::matrix::ExpressionMatrix;
use crate::names::NameContext;
use crate::states::rate_of;
use crate::suggest::suggest;
use crate::table::{TomlField, TomlTable};

/// A filter with the places of its numbers, for checks that need all of the model.
pub(crate) struct DeclaredFilter {
    pub(crate) filter: Filter,
    /// Its key in the file.
    pub(crate) span: Span,
    /// The table in words.
    place: String,
    beliefs: Vec<FilterBelief>,
}

/// What the filter believes of a parameter.
struct FilterBelief {
    parameter: usize,
    value: f64,
    /// Of the number.
    span: Span,
}

/// Reads a filter of a phase with these states.
pub(crate) fn read(context: &NameContext<'_>, field: &TomlField<'_>, states: &[State]) -> Result<DeclaredFilter> {
    let place = context.phase.table("filter");
    let mut section = field.section(place.as_str())?.with_keys(keys::FILTER)?;
    section.need("kind")?.word(&["kalman-schmidt"])?;
    let elements = NamedElements::whole(states);
    let consider = section.take("consider").map_or(Ok(Vec::new()), |field| consider(&field, &elements, states))?;
    let mean = section.take("mean").map_or(Ok(vec![0.0; states.len()]), |field| mean(&field, &elements))?;
    let covariance = covariance(&mut section, &elements)?;
    let beliefs = section.take("parameters").map_or(Ok(Vec::new()), |field| beliefs(context, &field))?;
    section.finish("here", None)?;
    let parameters = beliefs.iter().map(|belief| (belief.parameter, belief.value)).collect();
    let filter = Filter { consider, mean, covariance, parameters };
    Ok(DeclaredFilter { filter, span: field.key_span.clone(), place, beliefs })
}

/// The states that are considered; the hidden rate of one goes with it.
fn consider(field: &TomlField<'_>, elements: &NamedElements, states: &[State]) -> Result<Vec<usize>> {
    let place = field.what();
    let mut found = vec![false; states.len()];
    for (name, span) in field.texts()? {
        let state = elements.find(name, &place, &span)?;
        if std::mem::replace(&mut found[state], true) {
            return Err(SpecError::new(StructureProblem::ListedTwice { name: name.to_owned(), place }).at(span));
        }
    }
    for state in 0..states.len() {
        if let Some(rate) = rate_of(states, state).filter(|_| found[state]) {
            found[rate] = true;
        }
    }
    Ok((0..states.len()).filter(|&state| found[state]).collect())
}

fn mean(field: &TomlField<'_>, elements: &NamedElements) -> Result<Vec<f64>> {
    let place = field.what();
    let mut mean = vec![0.0; elements.len()];
    for field in field.section(place.as_str())?.fields() {
        mean[elements.find(field.key, &place, &field.key_span)?] = field.number()?;
    }
    Ok(mean)
}

fn covariance(section: &mut TomlTable<'_>, elements: &NamedElements) -> Result<DMatrix<f64>> {
    let Some(field) = section.take("covariance") else {
        return Err(section.missing("covariance").hint(format!("the filter's own prior: {}", elements.order())));
    };
    let entries = ExpressionMatrix::read_numbers(&field, elements)?.entries;
    let n = elements.len();
    Ok(DMatrix::from_fn(n, n, |i, j| entries[i][j].as_number().expect("only numbers were read")))
}

/// What the filter believes of parameters, and where it says so.
fn beliefs(context: &NameContext<'_>, field: &TomlField<'_>) -> Result<Vec<FilterBelief>> {
    let place = field.what();
    let mut all = Vec::new();
    for field in field.section(place.as_str())?.fields() {
        let Some(parameter) = context.parameters.get(field.key) else {
            let problem = SpecProblem::UnknownName { what: "parameter", name: field.key.to_owned(), place };
            let hint = suggest(field.key, context.parameters.names());
            return Err(SpecError::new(problem).at(field.key_span).maybe_hint(hint));
        };
        all.push(FilterBelief { parameter, value: field.number()?, span: field.span });
    }
    all.sort_by_key(|belief| belief.parameter);
    Ok(all)
}

/// Whether motion, measurements or noises of a phase use each parameter: what its filter is made of.
pub(crate) fn used(model: &Model) -> Vec<bool> {
    let mut used = vec![false; model.parameters.len()];
    uses(model, &mut |part| {
        if let Expression::Parameter(index) = part {
            used[*index] = true;
        }
        false
    });
    used
}

impl DeclaredFilter {
    /// Checks the filter now that all parameters and their uses are known: `used` by this phase, `served` by any phase that has
    /// this table.
    pub(crate) fn check(&self, context: &NameContext<'_>, model: &Model, used: &[bool], served: &[bool]) -> Result<()> {
        for FilterBelief { parameter, value, span } in &self.beliefs {
            let name = &model.parameters[*parameter].name;
            if !served[*parameter] {
                let why = format!("in {}: the filter does not use it", self.place);
                return Err(SpecError::new(SpecProblem::NoEffect { key: name.clone(), why }).at(span.clone()));
            }
            let role = context.roles[*parameter].expect("a parameter without a use was refused before");
            if let Some(expected) = role.expected(*value) {
                let what = format!("{} `{name}` in {}", role.words(), self.place);
                let problem = SpecProblem::OutOfRange { what, found: *value, expected: expected.to_owned() };
                return Err(SpecError::new(problem).at(span.clone()));
            }
        }
        match model.parameters.iter().zip(used).enumerate().find(|(index, one)| *one.1 && self.lacks(*index, one.0)) {
            None => Ok(()),
            Some((_, (Parameter { name, .. }, _))) => {
                let (name, place) = (name.clone(), self.place.clone());
                let hint = format!(
                    "the estimates are data, so what the filter believed is known: write `parameters = {{ {name} = … }}` \
                     there, or fix the parameter"
                );
                Err(SpecError::new(SpecProblem::FilterWithFree { name, place }).at(self.span.clone()).hint(hint))
            }
        }
    }

    /// A parameter has no value that the filter could have used.
    fn lacks(&self, index: usize, parameter: &Parameter) -> bool {
        let free = matches!(parameter.value, Value::Free { .. });
        free && self.beliefs.binary_search_by_key(&index, |belief| belief.parameter).is_err()
    }
}
