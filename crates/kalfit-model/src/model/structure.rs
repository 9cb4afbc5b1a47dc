//! Structure of μ and Σ: the constraints that an engineer imposes.

use nalgebra::DMatrix;

use crate::model::{EvaluationError, Expression};

/// Structure of the mean: μ_j = m0 + B β + Σ_r e_state(r) × covariate_jr × coefficient_r.
///
/// β has one entry for each free element and one entry for all proportional elements together; β does not contain the
/// regression coefficients.
#[derive(Debug, Clone, PartialEq)]
pub struct MeanStructure {
    /// Constraint on each element of μ.
    pub elements: Vec<MeanElement>,
    /// Start value of each element of μ, `None` where not given.
    pub start: Vec<Option<f64>>,
    /// Regressions on columns that are constant within a test.
    pub regression: Vec<Regression>,
}

/// Constraint on one element of μ.
#[derive(Debug, Clone, PartialEq)]
pub enum MeanElement {
    /// The element is estimated.
    Free,
    /// The element is known.
    Fixed(f64),
    /// The element is constant + Σ weight × other element, over other elements that are not tied.
    Tied {
        /// The constant.
        constant: f64,
        /// (index, weight) of each other element.
        terms: Vec<(usize, f64)>,
    },
    /// The element is α_μ × this weight, with one factor α_μ for all proportional elements (34).
    Proportional(f64),
}

/// One regression coefficient: the mean of `element` is linear in a column.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Regression {
    /// Index of the element of μ.
    pub element: usize,
    /// Index of a numeric column that is constant within a test.
    pub column: usize,
}

impl MeanStructure {
    /// All p elements free.
    pub fn free(p: usize) -> MeanStructure {
        MeanStructure { elements: vec![MeanElement::Free; p], start: vec![None; p], regression: Vec::new() }
    }

    /// All p elements zero.
    pub fn zero(p: usize) -> MeanStructure {
        MeanStructure { elements: vec![MeanElement::Fixed(0.0); p], ..MeanStructure::free(p) }
    }

    /// Whether element i is estimated and no other element moves with it, so that a constant multiple of a covariate can
    /// be moved between the element and the regression.
    pub fn is_free_alone(&self, i: usize) -> bool {
        let depends = |element: &MeanElement| match element {
            MeanElement::Tied { terms, .. } => terms.iter().any(|&(k, _)| k == i),
            _ => false,
        };
        matches!(self.elements[i], MeanElement::Free) && !self.elements.iter().any(depends)
    }

    /// (m0, B) of μ = m0 + Bβ without the regression: m0 has p elements, B is p × q.
    pub fn basis(&self) -> (Vec<f64>, DMatrix<f64>) {
        let p = self.elements.len();
        let mut column_of = vec![None; p];
        let mut proportional = None;
        let mut q = 0;
        for (i, element) in self.elements.iter().enumerate() {
            match element {
                MeanElement::Free => column_of[i] = Some(q),
                MeanElement::Proportional(_) if proportional.is_none() => proportional = Some(q),
                _ => continue,
            }
            q += 1;
        }
        let (mut offset, mut basis) = (vec![0.0; p], DMatrix::zeros(p, q));
        for (i, element) in self.elements.iter().enumerate() {
            match element {
                MeanElement::Free => basis[(i, column_of[i].expect("a free element has a column"))] = 1.0,
                MeanElement::Fixed(value) => offset[i] = *value,
                MeanElement::Proportional(weight) => {
                    basis[(i, proportional.expect("a proportional element has a column"))] = *weight;
                }
                MeanElement::Tied { .. } => {}
            }
        }
        for (i, element) in self.elements.iter().enumerate() {
            if let MeanElement::Tied { constant, terms } = element {
                offset[i] = *constant;
                for &(k, weight) in terms {
                    offset[i] += weight * offset[k];
                    for c in 0..q {
                        basis[(i, c)] += weight * basis[(k, c)];
                    }
                }
            }
        }
        (offset, basis)
    }
}

/// Structure of the covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct CovarianceStructure {
    /// The overall form.
    pub kind: CovarianceKind,
    /// Fixed elements, i ≥ j, each once; a variance σ_ii fixed at zero implies zeros in row i and column i.
    pub fixed: Vec<FixedElement>,
    /// Lists of elements (i, j), i ≥ j; the elements of one list are equal.
    pub equal: Vec<Vec<(usize, usize)>>,
    /// Known covariance added to the estimated Σ, p × p (29)-(30). The known covariance is part of P0, not of Σ.
    pub known: Option<Vec<Vec<Expression>>>,
    /// Start value of Σ, p × p.
    pub start: Option<DMatrix<f64>>,
}

/// The form of Σ. Matrices are p × p, their entries expressions in parameters.
#[derive(Debug, Clone, PartialEq)]
pub enum CovarianceKind {
    /// No zeros are imposed.
    Full,
    /// Elements outside the diagonal are zero.
    Diagonal,
    /// States of different blocks are uncorrelated (26)-(28); the lists are the states of each block, and every state
    /// belongs to one block.
    Blocks(Vec<Vec<usize>>),
    /// Σ = β Σ* with this Σ*.
    Proportional(Vec<Vec<Expression>>),
    /// Σ = D R D with this R (35).
    Correlation(Vec<Vec<Expression>>),
    /// Σ is this matrix.
    Fixed(Vec<Vec<Expression>>),
    /// Σ = G0 + Σ_g θ_g G_g, a linear covariance structure (Anderson 1973), with as many free quantities as generators.
    /// Such a structure cannot be combined with `fixed` and `equal` elements: constraints on θ must be written into the
    /// generators.
    Linear {
        /// G0, p × p, symmetric; G0 need not be positive semidefinite.
        constant: DMatrix<f64>,
        /// G_g, p × p each, symmetric and linearly independent.
        generators: Vec<DMatrix<f64>>,
    },
}

/// σ_ij = value.
#[derive(Debug, Clone, PartialEq)]
pub struct FixedElement {
    /// Row of the element.
    pub i: usize,
    /// Column of the element, at most `i`.
    pub j: usize,
    /// The value.
    pub value: f64,
}

impl CovarianceStructure {
    /// A free Σ, without constraints.
    pub fn full() -> CovarianceStructure {
        CovarianceStructure {
            kind: CovarianceKind::Full,
            fixed: Vec::new(),
            equal: Vec::new(),
            known: None,
            start: None,
        }
    }
}

/// Reason why a structure is impossible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StructureError {
    /// A matrix that must be positive semidefinite has a negative eigenvalue.
    #[error("{what} is not positive semidefinite: smallest eigenvalue {least:.3e}, largest {largest:.3e}")]
    NotSemidefinite {
        /// Name of the matrix.
        what: String,
        /// Smallest eigenvalue of the matrix.
        least: f64,
        /// Largest eigenvalue of the matrix.
        largest: f64,
    },
    /// An entry of a matrix has no value at the given α.
    #[error("entry ({row}, {column}) of {what} has no value: {source}")]
    Entry {
        /// Name of the matrix.
        what: String,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// Reason why the entry has no value.
        source: EvaluationError,
    },
    /// A matrix of a linear structure has the wrong shape.
    #[error("{what} is {rows} × {columns}, expected {states} × {states}, a row and a column for each estimated state")]
    Shape {
        /// Name of the matrix.
        what: String,
        /// Number of rows of the matrix.
        rows: usize,
        /// Number of columns of the matrix.
        columns: usize,
        /// The number of estimated states.
        states: usize,
    },
    /// A matrix of a linear structure is not symmetric, or has an entry that is not a finite number.
    #[error("{what} is not symmetric: found {above} at ({row}, {column}) and {below} at ({column}, {row})")]
    Asymmetric {
        /// Name of the matrix.
        what: String,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// The entry at (row, column).
        above: f64,
        /// The entry at (column, row).
        below: f64,
    },
    /// The generators of a linear structure are linearly dependent.
    #[error("the {generators} generators of the linear covariance are dependent: they span {rank} dimensions")]
    Dependent {
        /// Number of generators.
        generators: usize,
        /// Dimension of the space that they span.
        rank: usize,
    },
    /// A linear structure is combined with fixed or equal elements.
    #[error("fixed and equal elements do not go with a linear covariance: write them into its generators")]
    NotAlone,
    /// No member of a linear structure is a covariance.
    #[error("no member of the linear covariance is positive semidefinite")]
    NoMember,
    /// No positive semidefinite Σ meets all constraints.
    #[error("no positive semidefinite covariance has these fixed and equal elements")]
    Contradiction,
}
