//! Fixed and equal elements of Σ.

use std::collections::BTreeMap;

use crate::elements::{NamedElements, pair, pair_of, to_problem};
use crate::error::{Result, Span, SpecError, StructureProblem};
use crate::semidefinite::defect;
use crate::table::TomlField;

/// An open structure, its elements and what is needed to read their names.
pub(crate) struct OpenStructure<'s> {
    pub(crate) word: &'static str,
    pub(crate) block_of: Vec<usize>,
    pub(crate) elements: &'s NamedElements,
}

impl OpenStructure<'_> {
    /// True for elements that the structure makes zero.
    pub(crate) fn is_zero(&self, i: usize, j: usize) -> bool {
        match self.word {
            "diagonal" => i != j,
            "blocks" => self.block_of[i] != self.block_of[j],
            _ => false,
        }
    }

    /// (row, column), row ≥ column, of two names.
    fn element(&self, names: (&str, &str), place: &str, span: &Span) -> Result<(usize, usize)> {
        let find = |name| self.elements.find(name, place, span);
        let (i, j) = (find(names.0)?, find(names.1)?);
        Ok((i.max(j), i.min(j)))
    }
}

/// Fixed elements with the places where they were fixed; zeros that follow from others are left out.
#[derive(Debug, Default)]
pub(crate) struct FixedElements {
    pub(crate) values: BTreeMap<(usize, usize), (f64, Option<Span>)>,
}

impl FixedElements {
    /// The variances of states that do not vary.
    pub(crate) fn of_still(elements: &NamedElements) -> FixedElements {
        let still = (0..elements.len()).filter(|&i| !elements.varies[i]);
        FixedElements { values: still.map(|i| ((i, i), (0.0, None))).collect() }
    }

    /// The value of an element that is fixed, or zero because a variance is.
    pub(crate) fn value(&self, i: usize, j: usize) -> Option<f64> {
        if self.no_variance(i) || self.no_variance(j) {
            return Some(0.0);
        }
        self.values.get(&(i.max(j), i.min(j))).map(|(value, _)| *value)
    }

    fn no_variance(&self, i: usize) -> bool {
        self.values.get(&(i, i)).is_some_and(|(value, _)| *value == 0.0)
    }
}

/// Reads `fixed` and adds the zero variances of states that do not vary.
pub(crate) fn fixed_elements(structure: &OpenStructure<'_>, field: Option<&TomlField<'_>>) -> Result<FixedElements> {
    let elements = structure.elements;
    let mut fixed = FixedElements::of_still(elements);
    let Some(field) = field else { return Ok(fixed) };
    let place = field.what();
    for field in field.section(place.as_str())?.fields() {
        let value = field.number()?;
        let (i, j) = structure.element(pair(&field, &place)?, &place, &field.key_span)?;
        let wrong = |problem: StructureProblem| Err(SpecError::new(problem).at(field.key_span.clone()));
        if structure.is_zero(i, j) {
            if value == 0.0 {
                continue;
            }
            let (element, found) = (elements.pair_name(i, j), value.to_string());
            let place = place.clone();
            return wrong(StructureProblem::StructuralZero { element, place, found, structure: structure.word });
        }
        if i == j && value != 0.0 && !elements.varies[i] {
            return wrong(elements.still(i, "variance", &place));
        }
        match fixed.values.get(&(i, j)) {
            Some((before, Some(_))) if *before != value => {
                let (element, place) = (elements.pair_name(i, j), place.clone());
                let (first, second) = (before.to_string(), value.to_string());
                return wrong(StructureProblem::GivenTwice { element, place, first, second });
            }
            _ => fixed.values.insert((i, j), (value, Some(field.key_span.clone()))),
        };
    }
    check_fixed(structure, &fixed, field)?;
    let implied: Vec<(usize, usize)> = fixed.values.keys().copied().filter(|&(i, j)| i != j).collect();
    for (i, j) in implied {
        if fixed.no_variance(i) || fixed.no_variance(j) {
            fixed.values.remove(&(i, j));
        }
    }
    Ok(fixed)
}

/// Refuses fixed elements that no covariance has together.
fn check_fixed(structure: &OpenStructure<'_>, fixed: &FixedElements, whole: &TomlField<'_>) -> Result<()> {
    let p = structure.elements.len();
    let mut known = vec![vec![None; p]; p];
    for i in 0..p {
        for j in 0..=i {
            let said = fixed.values.get(&(i, j)).map(|(value, _)| *value);
            let implied = structure.is_zero(i, j) || (i != j && (fixed.no_variance(i) || fixed.no_variance(j)));
            known[i][j] = said.or(implied.then_some(0.0));
            known[j][i] = known[i][j];
        }
    }
    let Some(defect) = defect(&known) else { return Ok(()) };
    let span = defect.element().and_then(|element| fixed.values.get(&element)).and_then(|(_, span)| span.clone());
    let error = to_problem(&defect, &whole.what(), &|i| structure.elements.name(i));
    Err(error.at(span.unwrap_or(whole.key_span.clone())))
}

/// Reads `equal`: groups of elements that are free otherwise, no element twice.
pub(crate) fn equal_groups(
    structure: &OpenStructure<'_>,
    field: Option<&TomlField<'_>>,
    fixed: &FixedElements,
) -> Result<Vec<Vec<(usize, usize)>>> {
    let Some(field) = field else { return Ok(Vec::new()) };
    let (elements, place) = (structure.elements, field.what());
    let mut seen = std::collections::BTreeSet::new();
    let mut groups = Vec::new();
    for group in field.items("an array of arrays of elements")? {
        let mut members = Vec::new();
        for (text, span) in group.texts()? {
            let (i, j) = structure.element(pair_of(text, &span, &place)?, &place, &span)?;
            let element = elements.pair_name(i, j);
            let why = if structure.is_zero(i, j) {
                format!("0 by structure `{}`", structure.word)
            } else if let Some(value) = fixed.value(i, j) {
                format!("fixed at {value}")
            } else {
                String::new()
            };
            if !why.is_empty() {
                return Err(SpecError::new(StructureProblem::NotFree { element, why }).at(span));
            }
            if !seen.insert((i, j)) {
                let (name, place) = (element, place.clone());
                return Err(SpecError::new(StructureProblem::ListedTwice { name, place }).at(span));
            }
            members.push((i, j));
        }
        if members.len() < 2 {
            let (place, found, expected) = (place, "a group of fewer than two", "at least two elements");
            return Err(SpecError::new(StructureProblem::TooFew { place, found, expected }).at(group.span));
        }
        groups.push(members);
    }
    Ok(groups)
}
