//! Constraints on μ and Σ in code.

use crate::build::BuildError;
use crate::build::names::{Names, unknown};
use crate::model::{
    CovarianceKind, CovarianceStructure, Expression, FixedElement, MeanElement, MeanStructure, Regression,
};

/// Constraints on μ and Σ, by names of states.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Constraints {
    pub(super) means: Vec<(String, MeanRule)>,
    pub(super) regressions: Vec<(String, String)>,
    pub(super) kind: CovarianceForm,
    pub(super) fixed: Vec<(String, String, f64)>,
    pub(super) equal: Vec<Vec<(String, String)>>,
}

/// Constraint on one mean, or its start value.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum MeanRule {
    Fixed(f64),
    Start(f64),
    Tied { constant: f64, terms: Vec<(String, f64)> },
    Proportional(f64),
}

/// The form of Σ.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) enum CovarianceForm {
    #[default]
    Full,
    Diagonal,
    Blocks(Vec<Vec<String>>),
}

/// Names of the estimated states, and for each of the states, whether x_0 differs from test to test.
pub(super) struct Elements<'a> {
    pub(super) names: &'a [String],
    pub(super) random: &'a [bool],
}

impl Elements<'_> {
    fn find(&self, name: &str, place: &str) -> Result<usize, BuildError> {
        let index = self.names.iter().position(|known| known == name);
        index.ok_or_else(|| unknown("estimated state", name, place, self.names))
    }

    fn pair(&self, (a, b): (&str, &str), place: &str) -> Result<(usize, usize), BuildError> {
        let (a, b) = (self.find(a, place)?, self.find(b, place)?);
        Ok((a.max(b), a.min(b)))
    }
}

impl Constraints {
    pub(super) fn mean(&self, elements: &Elements<'_>, names: &mut Names) -> Result<MeanStructure, BuildError> {
        let mut mean = MeanStructure::free(elements.names.len());
        for (name, rule) in &self.means {
            let place = format!("the mean of `{name}`");
            let i = elements.find(name, "a constraint on a mean")?;
            let element = match rule {
                MeanRule::Start(start) => {
                    mean.start[i] = Some(finite(*start, &place)?);
                    continue;
                }
                MeanRule::Fixed(value) => MeanElement::Fixed(finite(*value, &place)?),
                MeanRule::Proportional(weight) => MeanElement::Proportional(finite(*weight, &place)?),
                MeanRule::Tied { constant, terms } => MeanElement::Tied {
                    constant: finite(*constant, &place)?,
                    terms: terms
                        .iter()
                        .map(|(other, weight)| Ok((elements.find(other, &place)?, finite(*weight, &place)?)))
                        .collect::<Result<_, BuildError>>()?,
                },
            };
            if mean.elements[i] != MeanElement::Free {
                let (first, second) = (format!("one constraint on {place}"), "another".to_owned());
                return Err(BuildError::Contradiction { first, second });
            }
            mean.elements[i] = element;
        }
        for (i, element) in mean.elements.iter().enumerate() {
            let MeanElement::Tied { terms, .. } = element else { continue };
            if let Some((k, _)) = terms.iter().find(|(k, _)| matches!(mean.elements[*k], MeanElement::Tied { .. })) {
                let first = format!("a tie of the mean of `{}`", elements.names[i]);
                let second = format!("one of `{}`, which is tied itself", elements.names[*k]);
                return Err(BuildError::Contradiction { first, second });
            }
        }
        for (state, column) in &self.regressions {
            let place = format!("regression of the mean of `{state}`");
            let element = elements.find(state, "a regression")?;
            mean.regression.push(Regression { element, column: names.column(column, &place) });
        }
        Ok(mean)
    }

    pub(super) fn covariance(&self, elements: &Elements<'_>) -> Result<CovarianceStructure, BuildError> {
        let mut covariance = CovarianceStructure::full();
        covariance.kind = match &self.kind {
            CovarianceForm::Full => CovarianceKind::Full,
            CovarianceForm::Diagonal => CovarianceKind::Diagonal,
            CovarianceForm::Blocks(blocks) => CovarianceKind::Blocks(all_blocks(blocks, elements)?),
        };
        let common = (0..elements.names.len()).filter(|&i| !elements.random[i]);
        covariance.fixed.extend(common.map(|i| FixedElement { i, j: i, value: 0.0 }));
        for (a, b, value) in &self.fixed {
            let (i, j) = elements.pair((a, b), "a fixed covariance")?;
            let what = format!("the covariance of `{a}` and `{b}`");
            if i == j && *value < 0.0 {
                return Err(BuildError::OutOfRange { what, found: *value, expected: "0 or more".to_owned() });
            }
            finite(*value, &what)?;
            if covariance.fixed.iter().any(|e| (e.i, e.j) == (i, j) && e.value != *value) {
                let second = "another value of it".to_owned();
                return Err(BuildError::Contradiction { first: format!("one value of {what}"), second });
            }
            if !covariance.fixed.iter().any(|e| (e.i, e.j) == (i, j)) {
                covariance.fixed.push(FixedElement { i, j, value: *value });
            }
        }
        for group in &self.equal {
            let pairs = group.iter().map(|(a, b)| elements.pair((a, b), "a group of equal covariances"));
            covariance.equal.push(pairs.collect::<Result<_, _>>()?);
        }
        Ok(covariance)
    }
}

/// Indices of the estimated states of each block; each state that no block names is a separate block.
fn all_blocks(blocks: &[Vec<String>], elements: &Elements<'_>) -> Result<Vec<Vec<usize>>, BuildError> {
    let mut listed = vec![false; elements.names.len()];
    let mut all = Vec::new();
    for block in blocks.iter().filter(|block| !block.is_empty()) {
        let mut members = Vec::new();
        for name in block {
            let i = elements.find(name, "a block of the covariance")?;
            if std::mem::replace(&mut listed[i], true) {
                return Err(BuildError::Twice { what: "two members of blocks of the covariance", name: name.clone() });
            }
            members.push(i);
        }
        all.push(members);
    }
    all.extend((0..listed.len()).filter(|&i| !listed[i]).map(|i| vec![i]));
    Ok(all)
}

pub(super) fn finite(found: f64, what: &str) -> Result<f64, BuildError> {
    if found.is_finite() {
        return Ok(found);
    }
    Err(BuildError::OutOfRange { what: what.to_owned(), found, expected: "a finite number".to_owned() })
}

/// The elements of a known matrix as expressions, row by row.
pub(super) fn as_expressions(matrix: &nalgebra::DMatrix<f64>) -> Vec<Vec<Expression>> {
    matrix.row_iter().map(|row| row.iter().map(|&x| Expression::Number(x)).collect()).collect()
}
