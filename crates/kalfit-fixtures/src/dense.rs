//! Laws of measurements that are jointly Gaussian, as their equations stand: the second computation of ℓ and of
//! posteriors, independent of kernels.
//!
//! Covariances are formed and factorised whole. Nothing here calls a filter or an estimator.

use kalfit_model::ReductionRef;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// log N(r; 0, Ω) = -½ (n log 2π + log |Ω| + r'Ω⁻¹r), by Cholesky of Ω scaled to unit diagonal. `residual`: r, n
/// numbers; `covariance`: Ω, n × n, positive definite.
pub fn log_density(residual: &DVector<f64>, covariance: &DMatrix<f64>) -> f64 {
    let n = residual.len();
    let scale = covariance.diagonal().map(f64::sqrt);
    let scaled = DMatrix::from_fn(n, n, |i, k| covariance[(i, k)] / (scale[i] * scale[k]));
    let factor = cholesky(scaled).l();
    let white = factor.solve_lower_triangular(&residual.component_div(&scale)).expect("its factor is not singular");
    let log_determinant: f64 = factor.diagonal().iter().zip(&scale).map(|(l, s)| 2.0 * (l * s).ln()).sum();
    -0.5 * (n as f64 * std::f64::consts::TAU.ln() + log_determinant + white.norm_squared())
}

/// Numbers that are linear in ξ: z = m + H ξ + e, e ~ N(0, Ω).
#[derive(Debug, Clone)]
pub struct Linear {
    /// z - m, n numbers.
    pub residual: DVector<f64>,
    /// H, n × p.
    pub sensitivity: DMatrix<f64>,
    /// Ω, n × n.
    pub covariance: DMatrix<f64>,
}

impl Linear {
    /// The rows of a reduction: d = R ξ + e, e ~ N(0, I).
    pub fn of(reduction: ReductionRef<'_>) -> Linear {
        let p = reduction.data.len();
        Linear {
            residual: DVector::from_column_slice(reduction.data),
            sensitivity: unpacked(reduction.factor, p),
            covariance: DMatrix::identity(p, p),
        }
    }

    /// z - m - H μ.
    pub fn error(&self, mean: &DVector<f64>) -> DVector<f64> {
        &self.residual - &self.sensitivity * mean
    }

    /// Covariance of z when ξ ~ N(μ, Σ): Ω + H Σ H'.
    pub fn total(&self, covariance: &DMatrix<f64>) -> DMatrix<f64> {
        &self.covariance + &self.sensitivity * covariance * self.sensitivity.transpose()
    }

    /// log p(z) when ξ ~ N(μ, Σ): log N(z - m - H μ; 0, Ω + H Σ H').
    pub fn log_density(&self, mean: &DVector<f64>, covariance: &DMatrix<f64>) -> f64 {
        log_density(&self.error(mean), &self.total(covariance))
    }

    /// Mean and covariance of ξ ~ N(μ, Σ) given z: μ + K (z - m - H μ) and Σ - K H Σ, K = Σ H'(Ω + H Σ H')⁻¹.
    pub fn given(&self, mean: &DVector<f64>, covariance: &DMatrix<f64>) -> (DVector<f64>, DMatrix<f64>) {
        let with_data = &self.sensitivity * covariance;
        let factor = cholesky(self.total(covariance));
        let shift = with_data.transpose() * factor.solve(&self.error(mean));
        (mean + shift, covariance - with_data.transpose() * factor.solve(&with_data))
    }
}

/// log p of the measurements of a reduction when ξ ~ N(μ, Σ): constant + ½ p log 2π + log N(d; R μ, I + R Σ R').
pub fn marginal(reduction: ReductionRef<'_>, mean: &DVector<f64>, covariance: &DMatrix<f64>) -> f64 {
    assert!(reduction.exact.is_none(), "exact values have another law");
    let half = 0.5 * mean.len() as f64 * std::f64::consts::TAU.ln();
    reduction.constant + half + Linear::of(reduction).log_density(mean, covariance)
}

/// R, p × p, of the upper triangle that is packed by columns.
pub fn unpacked(factor: &[f64], p: usize) -> DMatrix<f64> {
    DMatrix::from_fn(p, p, |i, k| if i <= k { factor[i + k * (k + 1) / 2] } else { 0.0 })
}

fn cholesky(covariance: DMatrix<f64>) -> Cholesky<f64, Dyn> {
    covariance.cholesky().expect("the covariance of the measurements is positive definite")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::near;

    /// Two measurements of one number with prior N(1, 4): z = ξ + e of variance 1, z = 2ξ + e of variance 4.
    #[test]
    fn the_law_of_two_measurements_is_that_by_hand() {
        let law = Linear {
            residual: DVector::from_vec(vec![2.0, 5.0]),
            sensitivity: DMatrix::from_vec(2, 1, vec![1.0, 2.0]),
            covariance: DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, 4.0])),
        };
        let (mean, variance) = (DVector::from_element(1, 1.0), DMatrix::from_element(1, 1, 4.0));
        near::matrices("Ω", &law.total(&variance), &DMatrix::from_row_slice(2, 2, &[5.0, 8.0, 8.0, 20.0]), 1e-15);
        // |Ω| = 36, r = (1, 3): r'Ω⁻¹r = (20 - 48 + 45) / 36
        let expected = -0.5 * (2.0 * std::f64::consts::TAU.ln() + 36f64.ln() + 17.0 / 36.0);
        near::absolute("ℓ", law.log_density(&mean, &variance), expected, 1e-14);
        // precision ¼ + 1 + 1, weighted sum ¼ + 2 + 2½
        let (mean, variance) = law.given(&mean, &variance);
        near::absolute("mean", mean[0], 4.75 / 2.25, 1e-14);
        near::absolute("variance", variance[(0, 0)], 1.0 / 2.25, 1e-14);
    }
}
