//! Posterior moments of ξ as the backward pass wants them.

use nalgebra::{DMatrix, DVector};

use crate::estimate::InitialLaw;
use crate::linalg::posterior_root;
use crate::reduce::{Reduction, unpack};

/// E[ξ | z] and a root C of Var[ξ | z] = CC'.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Moments {
    /// x̂ (p).
    pub(crate) mean: Vec<f64>,
    /// C, p × columns, by rows.
    pub(crate) root: Vec<f64>,
    pub(crate) columns: usize,
}

impl Moments {
    /// From x̂ and C.
    pub(crate) fn of(mean: &DVector<f64>, root: &DMatrix<f64>) -> Moments {
        Moments { mean: mean.as_slice().to_vec(), root: root.transpose().as_slice().to_vec(), columns: root.ncols() }
    }

    /// E‖d - Rξ‖² of a reduction: ‖d - Rx̂‖² + ‖RC‖².
    pub(crate) fn expected_square(&self, reduction: &Reduction) -> f64 {
        let line = |k: usize, x: &dyn Fn(usize) -> f64| -> f64 {
            (k..self.mean.len()).map(|i| reduction.factor[k + i * (i + 1) / 2] * x(i)).sum()
        };
        let of_row = |k: usize| {
            let left = reduction.data[k] - line(k, &|i| self.mean[i]);
            let spread = (0..self.columns).map(|c| line(k, &|i| self.root[i * self.columns + c]).powi(2));
            left * left + spread.sum::<f64>()
        };
        (0..self.mean.len()).map(of_row).sum()
    }
}

/// x̂ = μ + V(y - Jμ) and V = F(I + F'JF)⁻¹F' (10), (11).
///
/// Under the restricted likelihood the covariance of μ_j at a known Σ adds to V, as (I+ΣJ)⁻¹ of it: ℓ_R changes by
/// -½ tr((V + …) ∂J) where ℓ changes by -½ tr(V ∂J).
pub(crate) fn moments(reduction: &Reduction, law: &InitialLaw) -> Moments {
    let p = law.root.nrows();
    let factor = unpack(&reduction.factor, p);
    let mean = law.mean_of(&reduction.covariates);
    let root = posterior_root(&factor, &law.root);
    let residual = DVector::from_column_slice(&reduction.data) - &factor * &mean;
    let mean = mean + &root * (root.transpose() * (factor.transpose() * &residual));
    let mut columns: Vec<DVector<f64>> = root.column_iter().map(|c| c.into_owned()).collect();
    if let Some(extra) = law.mean_root_of(&reduction.covariates) {
        // (I+ΣJ)⁻¹X = X - VJX
        let moved = &extra - &root * (root.transpose() * (factor.transpose() * (&factor * &extra)));
        columns.extend(moved.column_iter().map(|c| c.into_owned()));
    }
    columns.retain(|c| c.amax() > 0.0);
    let entry = |i: usize, c: usize| columns[c][i];
    let root = (0..p).flat_map(|i| (0..columns.len()).map(move |c| (i, c))).map(|(i, c)| entry(i, c)).collect();
    Moments { mean: mean.as_slice().to_vec(), root, columns: columns.len() }
}
