//! The reduction of a test.

use nalgebra::DMatrix;

use crate::evidence::chain::Chain;
use crate::evidence::exact_rows::ExactRows;
use crate::evidence::path::Path;

/// log p(z | ξ) = constant - ½ ‖d - R ξ‖², exactly, for every ξ: the square-root information form of (c, y, J), with
/// J = R'R, y = R'd, c = constant - ½ d'd. R may be singular; J is never inverted.
#[derive(Debug, Clone, PartialEq)]
pub struct Reduction {
    /// Id of the test.
    pub test: String,
    /// c' = c + ½ d'd: the log-likelihood at the best ξ of the test, where Rξ = d.
    pub constant: f64,
    /// ρ = Σ e'S⁻¹e over the innovations e at the best ξ: `constant` depends on the data through -½ρ only. `None` where
    /// only the constant is known.
    pub residual: Option<f64>,
    /// d, p numbers.
    pub data: Vec<f64>,
    /// R, upper triangular p × p, stored by columns without the zeros: R_ik at i + k(k+1)/2, i ≤ k. The diagonal of R
    /// is not negative.
    pub factor: Vec<f64>,
    /// Value of the column of each [`Regression`](crate::model::Regression) of the model.
    pub covariates: Vec<f64>,
    /// Number of steps of the test.
    pub steps: usize,
    /// Number of scalar measurements used.
    pub observations: usize,
    /// The arithmetic that made the reduction.
    pub path: Path,
    /// Digest of all that S, K, T, J depend on: tests with one digest are one design class.
    pub design: u128,
    /// The reduction phase by phase, for a model with several phases. `data` and `factor` then belong to (ξ_1, …, ξ_I)
    /// of all phases, with the states between the phases integrated out; elements of phases that the test lacks are
    /// zero.
    pub chain: Option<Box<Chain>>,
    /// Rows Cξ = g that are measured without any noise: p(z | ξ) is then the density of all measurements but these
    /// rows, for ξ with Cξ = g.
    pub exact: Option<Box<ExactRows>>,
}

/// One test of `Reductions`: references to all fields of a [`Reduction`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReductionRef<'a> {
    /// Id of the test.
    pub test: &'a str,
    /// c' = c + ½ d'd.
    pub constant: f64,
    /// Sum of squares at the best ξ, as in [`Reduction::residual`].
    pub residual: Option<f64>,
    /// d, p numbers.
    pub data: &'a [f64],
    /// R, packed in the order of [`Reduction::factor`].
    pub factor: &'a [f64],
    /// Values of the regression columns.
    pub covariates: &'a [f64],
    /// Number of steps of the test.
    pub steps: usize,
    /// Number of scalar measurements used.
    pub observations: usize,
    /// The arithmetic that made this reduction.
    pub path: Path,
    /// Digest of all that S, K, T, J depend on.
    pub design: u128,
    /// The reduction phase by phase, for a model with several phases.
    pub chain: Option<&'a Chain>,
    /// Rows Cξ = g that are measured without any noise.
    pub exact: Option<&'a ExactRows>,
}

impl Reduction {
    /// References to all fields of the reduction.
    pub fn view(&self) -> ReductionRef<'_> {
        ReductionRef {
            test: &self.test,
            constant: self.constant,
            residual: self.residual,
            data: &self.data,
            factor: &self.factor,
            covariates: &self.covariates,
            steps: self.steps,
            observations: self.observations,
            path: self.path,
            design: self.design,
            chain: self.chain.as_deref(),
            exact: self.exact.as_deref(),
        }
    }
}

impl From<ReductionRef<'_>> for Reduction {
    fn from(row: ReductionRef<'_>) -> Reduction {
        Reduction {
            test: row.test.to_owned(),
            constant: row.constant,
            residual: row.residual,
            data: row.data.to_vec(),
            factor: row.factor.to_vec(),
            covariates: row.covariates.to_vec(),
            steps: row.steps,
            observations: row.observations,
            path: row.path,
            design: row.design,
            chain: row.chain.cloned().map(Box::new),
            exact: row.exact.cloned().map(Box::new),
        }
    }
}

/// The packed R of a reduction as a matrix, p × p, upper triangular.
pub fn unpack(factor: &[f64], p: usize) -> DMatrix<f64> {
    DMatrix::from_fn(p, p, |i, k| if i <= k { factor[i + k * (k + 1) / 2] } else { 0.0 })
}
