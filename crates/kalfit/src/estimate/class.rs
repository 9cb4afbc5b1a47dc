//! Tests that share R and covariates.

use crate::estimate::chained::Kept;

/// Tests that share R and covariates, in η: log p(z_j | η) = constant_j - ½ ‖d_j - R η‖².
#[derive(Debug, Clone)]
pub(crate) struct Class<T = f64> {
    /// n, the number of tests.
    pub(crate) count: T,
    /// Σ_j constant_j.
    pub(crate) constant: T,
    /// R, p × p by rows, upper triangular.
    pub(crate) factor: Vec<T>,
    /// Mean of d_j.
    pub(crate) mean: Vec<T>,
    /// Vectors whose outer products add up to Σ_j (d_j - mean)(d_j - mean)', one after the other; no more of them than p, and none
    /// for a single test.
    pub(crate) scatter: Vec<T>,
    /// Scaled covariates of the regressions.
    pub(crate) covariates: Vec<T>,
    /// Some test of it needs square-root arithmetic.
    pub(crate) square_root: bool,
    /// The same phase by phase; R, d and their scatter are then empty.
    pub(crate) chain: Option<Kept>,
}

impl Class {
    /// For each element i, Σ (y - Jμ)_i² - J_ii over the tests and J_ii of one of them, where d is so many times as large.
    pub(super) fn excess(&self, mean: &[f64], unit: f64) -> Vec<(f64, f64)> {
        let p = mean.len();
        let rows = || self.factor.chunks_exact(p.max(1));
        let dot = |row: &[f64], x: &[f64]| row.iter().zip(x).map(|(r, x)| r * x).sum::<f64>();
        let left: Vec<f64> = rows().zip(&self.mean).map(|(row, d)| d * unit - dot(row, mean)).collect();
        // R'x at i
        let at = |i: usize, x: &[f64]| rows().zip(x).map(|(row, x)| row[i] * x).sum::<f64>();
        let one = |i: usize| {
            let spread: f64 = self.scatter.chunks_exact(p).map(|x| (unit * at(i, x)).powi(2)).sum();
            let own = rows().map(|row| row[i] * row[i]).sum::<f64>();
            (self.count * (at(i, &left).powi(2) - own) + spread, own)
        };
        (0..p).map(one).collect()
    }
}
