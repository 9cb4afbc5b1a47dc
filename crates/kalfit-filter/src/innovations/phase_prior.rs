//! The prior of a phase: the mean and the covariance that a phase adds to the inherited state.

use nalgebra::{DMatrix, DVector};

use crate::innovations::law::EnteringLaw;

/// The mean and the covariance that a phase adds to the inherited state.
#[derive(Debug)]
pub(super) struct PhasePrior {
    pub(super) mean: Vec<f64>,
    /// (element of μ, coefficient), in the order of the covariates.
    pub(super) regressions: Vec<(usize, f64)>,
    /// L with LL' = Σ, p × p.
    pub(super) root: DMatrix<f64>,
    /// Σ, p × p.
    pub(super) covariance: DMatrix<f64>,
    pub(super) time: Option<usize>,
    /// True if the phase has a given filter: the filter's estimates are evidence, the measurements are not.
    pub(super) filtered: bool,
}

impl PhasePrior {
    /// μ plus regressions on the covariates: the phase's addition to the mean of σ, q numbers.
    pub(super) fn mean_with_covariates(&self, covariates: &[f64], q: usize) -> DVector<f64> {
        let mut mean = DVector::from_fn(q, |i, _| self.mean.get(i).copied().unwrap_or(0.0));
        for (&(element, coefficient), covariate) in self.regressions.iter().zip(covariates) {
            mean[element] += coefficient * covariate;
        }
        mean
    }

    /// The law of σ of a phase, q numbers, given all earlier phases; `inherited`: (mean, root of the covariance) of
    /// T x_K + t from the phase before.
    pub(super) fn law(
        &self,
        covariates: &[f64],
        q: usize,
        inherited: Option<(DVector<f64>, DMatrix<f64>)>,
    ) -> EnteringLaw {
        let p = self.mean.len();
        let mut mean = self.mean_with_covariates(covariates, q);
        let prior_root = self.root.clone().resize_vertically(q, 0.0);
        let Some((inherited_mean, carried)) = inherited else { return EnteringLaw::new(mean, &prior_root) };
        mean += inherited_mean;
        let mut joint_root = DMatrix::zeros(q, p + carried.ncols());
        joint_root.columns_mut(0, p).copy_from(&prior_root);
        joint_root.columns_mut(p, carried.ncols()).copy_from(&carried);
        EnteringLaw::new(mean, &joint_root)
    }
}
