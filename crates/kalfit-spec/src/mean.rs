//! `[mean]`: the structure of μ.

use std::collections::BTreeSet;

use kalfit::model::{MeanElement, MeanStructure, Regression};

use crate::elements::NamedElements;
use crate::error::{Result, SpecError, SpecProblem, StructureProblem};
use crate::expression::{self, ExpressionScope};
use crate::keys;
use crate::names::NameContext;
use crate::table::{TomlField, TomlTable};

/// Regression coefficients of one model; what is found of them grows with its square.
const MAX_REGRESSION: usize = 1_000;

struct MeanReader<'r, 't> {
    context: &'r mut NameContext<'t>,
    /// The table in words.
    place: String,
    /// Indices of the estimated states.
    estimated: &'r [usize],
    elements: &'r NamedElements,
    mean: MeanStructure,
}

/// Reads `[mean]`; without it all elements are free.
pub(crate) fn read(
    context: &mut NameContext<'_>,
    field: Option<&TomlField<'_>>,
    estimated: &[usize],
    elements: &NamedElements,
) -> Result<MeanStructure> {
    let mean = MeanStructure::free(elements.len());
    let Some(field) = field else { return Ok(mean) };
    let place = context.phase.table("mean");
    let mut section = field.section(place.as_str())?.with_keys(keys::MEAN)?;
    let mut reader = MeanReader { context, place, estimated, elements, mean };
    if let Some(field) = section.take("fixed") {
        reader.fixed(&field)?;
    }
    if let Some(field) = section.take("proportional_to") {
        reader.proportional(&field)?;
    }
    if let Some(field) = section.take("tied") {
        reader.tied(&field)?;
    }
    if let Some(field) = section.take("start") {
        reader.start(&field)?;
    }
    if let Some(field) = section.take("regression") {
        reader.regression(&field)?;
    }
    section.finish("here", None)?;
    Ok(reader.mean)
}

/// What was said of an element, in words; `None` when it is free.
fn said(element: &MeanElement) -> Option<&'static str> {
    match element {
        MeanElement::Free => None,
        MeanElement::Fixed(_) => Some("fixed"),
        MeanElement::Tied { .. } => Some("tied"),
        MeanElement::Proportional(_) => Some("proportional"),
    }
}

impl MeanReader<'_, '_> {
    fn find(&self, field: &TomlField<'_>) -> Result<usize> {
        self.elements.find(field.key, &field.place, &field.key_span)
    }

    fn table<'d>(&self, field: &TomlField<'d>) -> Result<TomlTable<'d>> {
        field.section(format!("`{}` of {}", field.key, self.place))
    }

    /// Says something of an element that nothing was said of.
    fn say(&mut self, i: usize, element: MeanElement, field: &TomlField<'_>) -> Result<()> {
        if let (Some(first), Some(second)) = (said(&self.mean.elements[i]), said(&element)) {
            let problem = StructureProblem::MeanTwice { name: self.elements.name(i), first, second };
            return Err(SpecError::new(problem).at(field.key_span.clone()));
        }
        self.mean.elements[i] = element;
        Ok(())
    }

    fn fixed(&mut self, field: &TomlField<'_>) -> Result<()> {
        for field in self.table(field)?.fields() {
            let i = self.find(&field)?;
            self.say(i, MeanElement::Fixed(field.number()?), &field)?;
        }
        Ok(())
    }

    fn proportional(&mut self, field: &TomlField<'_>) -> Result<()> {
        let mut all_zero = true;
        for field in self.table(field)?.fields() {
            let i = self.find(&field)?;
            let weight = field.number()?;
            all_zero &= weight == 0.0;
            self.say(i, MeanElement::Proportional(weight), &field)?;
        }
        if all_zero {
            let place = format!("`proportional_to` of {}", self.place);
            return Err(SpecError::new(StructureProblem::AllZero { place }).at(field.span.clone()));
        }
        Ok(())
    }

    fn tied(&mut self, field: &TomlField<'_>) -> Result<()> {
        let section = self.table(field)?;
        let mut ties = Vec::with_capacity(section.len());
        for field in section.fields() {
            let i = self.find(&field)?;
            let (constant, terms) = self.tie(i, &field)?;
            self.say(i, MeanElement::Tied { constant, terms }, &field)?;
            ties.push((i, field));
        }
        for (i, field) in ties {
            let MeanElement::Tied { terms, .. } = &self.mean.elements[i] else { continue };
            let tied = |k: &usize| matches!(self.mean.elements[*k], MeanElement::Tied { .. });
            if let Some(other) = terms.iter().map(|(k, _)| *k).find(tied) {
                let (name, other) = (self.elements.name(i), self.elements.name(other));
                let problem = StructureProblem::TiedToTied { name, other };
                return Err(SpecError::new(problem)
                    .at(field.span)
                    .hint("write the expression of the other mean instead of its name"));
            }
        }
        Ok(())
    }

    /// constant + Σ weight × other mean.
    fn tie(&mut self, i: usize, field: &TomlField<'_>) -> Result<(f64, Vec<(usize, f64)>)> {
        let place = field.what();
        let linear = expression::linear(self.context, field, ExpressionScope::means(&place))?;
        let wrong = |problem: StructureProblem| SpecError::new(problem).at(field.span.clone());
        let number =
            |part: &kalfit::Expression| part.as_number().expect("without columns and parameters all is number");
        let mut terms = Vec::with_capacity(linear.terms.len());
        for (state, weight) in &linear.terms {
            let Some(k) = self.estimated.iter().position(|estimated| estimated == state) else {
                let name = self.context.states.name(*state).to_owned();
                return Err(self
                    .elements
                    .find(&name, &place, &field.span)
                    .expect_err("a state that is not among the estimated ones is not found among them"));
            };
            if k == i {
                return Err(wrong(StructureProblem::TiedToItself { name: self.elements.name(i) }));
            }
            terms.push((k, number(weight)));
        }
        if terms.is_empty() {
            let problem = StructureProblem::TiedToNothing { name: self.elements.name(i) };
            return Err(wrong(problem).hint("a mean that is known stands under `fixed`"));
        }
        Ok((number(&linear.constant), terms))
    }

    fn start(&mut self, field: &TomlField<'_>) -> Result<()> {
        for field in self.table(field)?.fields() {
            let i = self.find(&field)?;
            if let Some(said) = said(&self.mean.elements[i]) {
                return Err(field.no_effect(&format!("as a start value: its mean is {said}")));
            }
            self.mean.start[i] = Some(field.number()?);
        }
        Ok(())
    }

    fn regression(&mut self, field: &TomlField<'_>) -> Result<()> {
        for field in self.table(field)?.fields() {
            let element = self.find(&field)?;
            let names = field.texts()?;
            if names.is_empty() {
                let (place, found, expected) = (field.what(), "no column", "names of columns");
                return Err(SpecError::new(StructureProblem::TooFew { place, found, expected }).at(field.span));
            }
            let used_in = format!("regression of the mean of `{}`", field.key);
            let mut seen = BTreeSet::new();
            for (name, span) in names {
                let column = self.context.column(name, span.clone(), &used_in);
                if !seen.insert(column) {
                    let problem = StructureProblem::ListedTwice { name: name.to_owned(), place: used_in };
                    return Err(SpecError::new(problem).at(span));
                }
                self.mean.regression.push(Regression { element, column });
                let found = self.mean.regression.len();
                if found > MAX_REGRESSION {
                    let expected = format!("at most {MAX_REGRESSION}");
                    let problem = SpecProblem::Count { what: "regression coefficients", found, expected };
                    return Err(SpecError::new(problem).at(span));
                }
            }
        }
        Ok(())
    }
}
