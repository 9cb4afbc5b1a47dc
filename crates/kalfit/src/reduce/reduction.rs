//! The reduction of a test.

use nalgebra::DMatrix;

use crate::reduce::chain::Chain;
use crate::reduce::exact_rows::ExactRows;
use crate::reduce::path::Path;

/// log p(z | ξ) = constant - ½ ‖d - R ξ‖², exactly, for every ξ: the square-root information form of (c, y, J), with
/// J = R'R, y = R'd, c = constant - ½ d'd. R may be singular; J is never inverted.
#[derive(Debug, Clone, PartialEq)]
pub struct Reduction {
    /// Id of the test.
    pub test: String,
    /// c' = c + ½ d'd: the log-likelihood at the best ξ of this test.
    pub constant: f64,
    /// The sum of squares that is left at that ξ, each measurement in units of its innovation's variance: 2 × what of the constant
    /// the data make. `None` where nothing but the constant is known.
    pub residual: Option<f64>,
    /// d, p numbers.
    pub data: Vec<f64>,
    /// R, upper triangular p × p, stored by columns without the zeros: R_ik at i + k(k+1)/2, i ≤ k. Its diagonal is not negative.
    pub factor: Vec<f64>,
    /// Values of the regression columns, one per [`Regression`](crate::model::Regression).
    pub covariates: Vec<f64>,
    /// Number of steps of the test.
    pub steps: usize,
    /// Number of scalar measurements used.
    pub observations: usize,
    /// Which arithmetic made it.
    pub path: Path,
    /// Digest of all that S, K, T, J depend on: tests with one digest are one design class.
    pub design: u128,
    /// The same phase by phase, for a test of a model with several phases. `data` and `factor` are then those of all phases
    /// together: of (ξ_1, …, ξ_I), with what lies between the phases integrated out; of phases that the test lacks, zero.
    pub chain: Option<Box<Chain>>,
    /// Rows Cξ = g that are measured without any noise: p(z | ξ) is then that of all other measurements, where Cξ = g.
    pub exact: Option<Box<ExactRows>>,
}

/// The packed R of a reduction as a matrix.
pub(crate) fn unpack(factor: &[f64], p: usize) -> DMatrix<f64> {
    DMatrix::from_fn(p, p, |i, k| if i <= k { factor[i + k * (k + 1) / 2] } else { 0.0 })
}
