//! Matrices in the order of μ and Σ.

use kalfit::model::Expression;

use crate::elements::{NamedElements, to_problem};
use crate::error::{Result, Span, SpecError, StructureProblem};
use crate::expression::{self, ExpressionScope, is_zero};
use crate::names::NameContext;
use crate::semidefinite::defect;
use crate::table::TomlField;

/// A symmetric matrix whose entries are expressions in parameters, and where they stand.
pub(crate) struct ExpressionMatrix {
    pub(crate) entries: Vec<Vec<Expression>>,
    spans: Vec<Vec<Span>>,
    place: String,
    span: Span,
}

impl ExpressionMatrix {
    /// Reads a p × p array of arrays; it must be symmetric, and positive semidefinite as far as its numbers are known.
    pub(crate) fn read(
        context: &mut NameContext<'_>,
        field: &TomlField<'_>,
        elements: &NamedElements,
    ) -> Result<ExpressionMatrix> {
        let place = format!("`{}` of {}", field.key, field.place);
        ExpressionMatrix::read_with(field, elements, |cell| {
            expression::scalar(context, cell, ExpressionScope::common(&place))
        })
    }

    /// As [`ExpressionMatrix::read`], with nothing but numbers.
    pub(crate) fn read_numbers(field: &TomlField<'_>, elements: &NamedElements) -> Result<ExpressionMatrix> {
        ExpressionMatrix::read_with(field, elements, |cell| cell.number().map(Expression::Number))
    }

    fn read_with(
        field: &TomlField<'_>,
        elements: &NamedElements,
        mut entry: impl FnMut(&TomlField<'_>) -> Result<Expression>,
    ) -> Result<ExpressionMatrix> {
        let place = format!("`{}` of {}", field.key, field.place);
        let rows = field.items("an array of rows")?;
        check_shape(elements, rows.len(), ["row", "rows"], "", field)?;
        let mut matrix = ExpressionMatrix { entries: Vec::new(), spans: Vec::new(), place, span: field.span.clone() };
        for row in rows {
            let cells = row.items("an array of rows")?;
            let row_words = format!(" in row {}", matrix.entries.len() + 1);
            check_shape(elements, cells.len(), ["entry", "entries"], &row_words, &row)?;
            let mut values = Vec::with_capacity(cells.len());
            for cell in &cells {
                values.push(entry(cell)?);
            }
            matrix.entries.push(values);
            matrix.spans.push(cells.into_iter().map(|cell| cell.span).collect());
        }
        matrix.check(elements)?;
        Ok(matrix)
    }

    fn check(&self, elements: &NamedElements) -> Result<()> {
        for i in 0..self.entries.len() {
            for j in 0..i {
                if self.entries[i][j] != self.entries[j][i] {
                    let element = elements.pair_name(i, j);
                    let problem = StructureProblem::NotSymmetric { place: self.place.clone(), element };
                    return Err(self.at(i, j, problem));
                }
            }
        }
        let known: Vec<Vec<Option<f64>>> =
            self.entries.iter().map(|row| row.iter().map(Expression::as_number).collect()).collect();
        match defect(&known) {
            None => Ok(()),
            Some(defect) => {
                let span = defect.element().map_or(self.span.clone(), |(i, j)| self.spans[i][j].clone());
                Err(to_problem(&defect, &self.place, &|i| elements.name(i)).at(span))
            }
        }
    }

    /// A problem of one entry.
    pub(crate) fn at(&self, i: usize, j: usize, problem: StructureProblem) -> SpecError {
        SpecError::new(problem).at(self.spans[i][j].clone())
    }

    /// States that do not vary must have no covariance, and no variance unless `unit` says that the diagonal is one.
    pub(crate) fn check_still(&self, elements: &NamedElements, unit: bool) -> Result<()> {
        for i in (0..elements.len()).filter(|&i| !elements.varies[i]) {
            for j in (0..elements.len()).filter(|&j| j != i || !unit) {
                if !is_zero(&self.entries[i][j]) {
                    let what = if i == j { "variance" } else { "covariance" };
                    return Err(self.at(i, j, elements.still(i, what, &self.place)));
                }
            }
        }
        Ok(())
    }

    /// A correlation matrix has a unit diagonal.
    pub(crate) fn check_unit_diagonal(&self, elements: &NamedElements) -> Result<()> {
        match (0..elements.len()).find(|&i| self.entries[i][i].as_number() != Some(1.0)) {
            None => Ok(()),
            Some(i) => Err(self.at(i, i, StructureProblem::NotUnitDiagonal { name: elements.name(i) })),
        }
    }

    /// A matrix that is scaled must not be zero.
    pub(crate) fn check_not_zero(&self) -> Result<()> {
        if self.entries.iter().flatten().all(is_zero) {
            return Err(SpecError::new(StructureProblem::AllZero { place: self.place.clone() }).at(self.span.clone()));
        }
        Ok(())
    }
}

fn check_shape(
    elements: &NamedElements,
    found: usize,
    [one, many]: [&str; 2],
    row: &str,
    field: &TomlField<'_>,
) -> Result<()> {
    let expected = elements.len();
    if found == expected {
        return Ok(());
    }
    let part = format!("{}{row}", if found == 1 { one } else { many });
    let problem = StructureProblem::Shape { place: field.what(), part, found, expected };
    Err(SpecError::new(problem).at(field.span.clone()).hint(elements.order()))
}
