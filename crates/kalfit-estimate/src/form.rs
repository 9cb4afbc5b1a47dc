//! The structure of the Σ of one phase, from the model.

use nalgebra::DMatrix;

use crate::covariance::{Constraint, CoordinateForm, CovarianceMap, PhaseForm};
use crate::frame::Frame;
use crate::linear::LinearStructure;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::symmetric;
use kalfit_model::{Alpha, CovarianceKind, CovarianceStructure, Expression, Scope, StructureError};

impl CovarianceMap {
    /// The structure of one phase, in the frame of its states.
    pub(super) fn of_phase(
        structure: &CovarianceStructure,
        alpha: &Alpha,
        frame: &Frame,
    ) -> Result<CovarianceMap, StructureError> {
        let p = frame.scale.len();
        let zero = zero_variances(structure, p);
        let linear = match &structure.kind {
            CovarianceKind::Linear { constant, generators } => {
                Some(LinearStructure::new(structure, constant, generators, frame)?)
            }
            _ => None,
        };
        let random: Vec<usize> = match &linear {
            Some(linear) => linear.random(),
            None => (0..p).filter(|&i| !zero[i]).collect(),
        };
        let numbers = |entries: &[Vec<Expression>], what| evaluate_matrix(entries, alpha, what);
        let form = match &structure.kind {
            CovarianceKind::Full | CovarianceKind::Linear { .. } => CoordinateForm::Factor(vec![random.clone()]),
            CovarianceKind::Diagonal => CoordinateForm::Factor(random.iter().map(|&i| vec![i]).collect()),
            CovarianceKind::Blocks(blocks) => CoordinateForm::Factor(restrict(blocks, &zero)),
            CovarianceKind::Proportional(entries) => {
                let sigma = frame.covariance_in(&numbers(entries, "the matrix of the proportional covariance")?);
                CoordinateForm::Scale(symmetric::square_root(&sigma))
            }
            CovarianceKind::Correlation(entries) => {
                let root = symmetric::square_root(&numbers(entries, "the correlation matrix")?);
                CoordinateForm::StdDevs(root, random.clone())
            }
            CovarianceKind::Fixed(entries) => {
                CoordinateForm::Fixed(frame.covariance_in(&numbers(entries, "the fixed covariance")?))
            }
        };
        let form = match form {
            CoordinateForm::Factor(blocks) => CoordinateForm::Factor(split(blocks, &|i, j| match &linear {
                Some(linear) => linear.is_zero(i, j),
                None => is_fixed_zero(structure, i, j),
            })),
            other => other,
        };
        let start = structure.start.as_ref().map(|start| frame.covariance_in(start));
        let part = PhaseForm { states: 0..p, form, linear: linear.is_some(), start };
        let elements = Elements::single(p);
        let mut map =
            CovarianceMap { p, parts: vec![part], constraints: Vec::new(), random, regressors: Vec::new(), elements };
        map.constraints = match &linear {
            Some(linear) => linear.constraints(&map)?,
            None => constraints(structure, frame, &map),
        };
        Ok(map)
    }
}

/// For each state, whether its variance is held at zero.
fn zero_variances(structure: &CovarianceStructure, p: usize) -> Vec<bool> {
    let mut zero = vec![false; p];
    for element in &structure.fixed {
        if element.i == element.j && element.value == 0.0 {
            zero[element.i] = true;
        }
    }
    zero
}

/// Evaluates a matrix of expressions in parameters, and checks that the matrix is positive semidefinite.
fn evaluate_matrix(entries: &[Vec<Expression>], alpha: &Alpha, what: &str) -> Result<DMatrix<f64>, StructureError> {
    let p = entries.len();
    let scope = Scope { numbers: &[], texts: &[], step: 0.0, alpha };
    let mut values = DMatrix::zeros(p, p);
    for i in 0..p {
        for j in 0..p {
            values[(i, j)] = entries[i][j].evaluate(&scope).map_err(|source| StructureError::Entry {
                what: what.to_owned(),
                row: i,
                column: j,
                source,
            })?;
        }
    }
    if !symmetric::is_semidefinite(&values) {
        let (values, _) = symmetric::eigen(&values);
        let (least, largest) = (values[0], values[p - 1]);
        return Err(StructureError::NotSemidefinite { what: what.to_owned(), least, largest });
    }
    Ok(values)
}

fn restrict(blocks: &[Vec<usize>], zero: &[bool]) -> Vec<Vec<usize>> {
    let kept = blocks.iter().map(|b| b.iter().copied().filter(|&i| !zero[i]).collect::<Vec<_>>());
    kept.filter(|b| !b.is_empty()).collect()
}

fn is_fixed_zero(structure: &CovarianceStructure, i: usize, j: usize) -> bool {
    structure.fixed.iter().any(|e| e.value == 0.0 && (e.i, e.j) == (i.max(j), i.min(j)) && i != j)
}

/// Splits each block into connected components, states with a non-zero covariance being connected.
fn split(blocks: Vec<Vec<usize>>, is_zero: &dyn Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
    let mut result = Vec::new();
    for block in blocks {
        let mut unassigned = block;
        while !unassigned.is_empty() {
            let mut component = vec![unassigned.remove(0)];
            let mut position = 0;
            while position < component.len() {
                let from = component[position];
                let (joined, rest): (Vec<usize>, Vec<usize>) = unassigned.iter().partition(|&&j| !is_zero(from, j));
                component.extend(joined);
                unassigned = rest;
                position += 1;
            }
            component.sort_unstable();
            result.push(component);
        }
    }
    result
}

/// Constraints for fixed and equal elements that the form does not imply, in η, scaled to coefficients of order one.
fn constraints(structure: &CovarianceStructure, frame: &Frame, map: &CovarianceMap) -> Vec<Constraint> {
    if !matches!(map.parts[0].form, CoordinateForm::Factor(_)) {
        return Vec::new();
    }
    let unit = |i: usize, j: usize| frame.scale[i] * frame.scale[j];
    let free = |i: usize, j: usize| !map.is_structural_zero(i, j);
    let mut constraints = Vec::new();
    for element in structure.fixed.iter().filter(|e| free(e.i, e.j)) {
        let value = element.value / unit(element.i, element.j);
        constraints.push(Constraint { terms: vec![(element.i, element.j, 1.0)], value });
    }
    for group in &structure.equal {
        let (i, j) = group[0];
        for &(k, l) in &group[1..] {
            let size = unit(i, j).max(unit(k, l));
            let terms = vec![(i, j, unit(i, j) / size), (k, l, -unit(k, l) / size)];
            constraints.push(Constraint { terms, value: 0.0 });
        }
    }
    constraints
}
