//! The structure of μ in η: μ = offset + Q b, with the columns of Q orthonormal, and scaled regression coefficients γ.

use nalgebra::{DMatrix, DVector};

use crate::estimate::classes::Frame;
use crate::linalg::symmetric;
use crate::model::MeanStructure;

/// Free coordinates of the mean: b, then γ.
#[derive(Debug, Clone)]
pub(crate) struct MeanMap {
    /// μ in η where b = 0.
    pub(crate) offset: DVector<f64>,
    /// Q, p × q.
    pub(crate) basis: DMatrix<f64>,
    /// Elements the regression coefficients act on.
    pub(crate) regressors: Vec<usize>,
    /// γ = coefficient × this.
    pub(crate) coefficient_scale: Vec<f64>,
}

impl MeanMap {
    pub(crate) fn new(structure: &MeanStructure, frame: &Frame) -> MeanMap {
        let (m0, b) = structure.basis();
        let p = m0.len();
        let offset = DVector::from_fn(p, |i, _| (m0[i] - frame.centre[i]) / frame.scale[i]);
        let scaled = DMatrix::from_fn(p, b.ncols(), |i, c| b[(i, c)] / frame.scale[i]);
        let basis = if b.ncols() == 0 { DMatrix::zeros(p, 0) } else { scaled.qr().q() };
        let regressors: Vec<usize> = structure.regression.iter().map(|r| r.element).collect();
        let coefficient_scale =
            regressors.iter().zip(&frame.covariate_scale).map(|(&i, x)| x / frame.scale[i]).collect();
        MeanMap { offset, basis, regressors, coefficient_scale }
    }

    /// d(mean coordinates of [`Sums`](super::pass::Sums)) / d(b, γ): block diagonal (Q, I).
    pub(crate) fn jacobian(&self) -> DMatrix<f64> {
        let (p, q) = self.basis.shape();
        let r = self.regressors.len();
        let mut jacobian = DMatrix::zeros(p + r, q + r);
        jacobian.view_mut((0, 0), (p, q)).copy_from(&self.basis);
        jacobian.view_mut((p, q), (r, r)).fill_with_identity();
        jacobian
    }

    /// The paper's (20), generalised: the point of the structure nearest to the mean of the posterior means in the
    /// metric Σ⁻¹. With nothing constrained that is (8): the mean itself. `None` when Σ is singular and the mean is
    /// constrained: then the metric has no meaning and the mean needs generalised least squares instead.
    pub(crate) fn maximise(&self, posterior_mean: &DVector<f64>, sigma: &DMatrix<f64>) -> Option<DVector<f64>> {
        if self.basis.ncols() == posterior_mean.len() {
            return Some(posterior_mean.clone());
        }
        let (least, largest) = symmetric::scaled_range(sigma);
        let inverse = (least > 1e-12 * largest).then(|| sigma.clone().cholesky())?;
        let inverse = inverse?.inverse();
        let information = self.basis.transpose() * &inverse * &self.basis;
        let right = self.basis.transpose() * inverse * (posterior_mean - &self.offset);
        Some(&self.offset + &self.basis * symmetric::pseudo_solve(&information, &right))
    }
}
