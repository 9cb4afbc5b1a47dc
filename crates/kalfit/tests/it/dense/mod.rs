//! The oracle: the joint Gaussian of all measurements of a test, built by plain stacking and evaluated by the
//! dense law of `kalfit_fixtures`. Written from the equations of the model, independently of the kernels and as naively as possible.
#![allow(dead_code, reason = "each test crate uses its own part of it")]

pub(crate) mod twofold;

use kalfit::reduce::Plain;
pub(crate) use kalfit_fixtures::dense::log_density;
use nalgebra::{DMatrix, DVector};

/// z ~ N(m + H ξ, Ω) for the measurements of a test that are not missing, and the law of its last state.
#[derive(Debug, Clone)]
pub(crate) struct Dense {
    /// The measured values z.
    pub(crate) values: DVector<f64>,
    /// m.
    pub(crate) mean: DVector<f64>,
    /// H.
    pub(crate) sensitivity: DMatrix<f64>,
    /// Ω.
    pub(crate) covariance: DMatrix<f64>,
    /// x_K = last_mean + last_sensitivity ξ + noise, given ξ but not z.
    pub(crate) last_mean: DVector<f64>,
    /// Its sensitivity to ξ.
    pub(crate) last_sensitivity: DMatrix<f64>,
    /// Its covariance.
    pub(crate) last_covariance: DMatrix<f64>,
    /// Its covariance with z.
    pub(crate) last_cross: DMatrix<f64>,
}

/// Stacks a test: every x_k is written as F_k x_0 + inputs + Σ noises, covariances between all pairs of steps included.
pub(crate) fn dense(test: &Plain) -> Dense {
    let (n, p) = (test.offset.len(), test.sensitivity.ncols());
    let (mut mean, mut psi) = (test.offset.clone(), test.sensitivity.clone());
    let mut own = test.covariance.clone();
    // For each measurement so far its covariance with the current state.
    let mut cross = DMatrix::<f64>::zeros(n, 0);
    let (mut z, mut m) = (Vec::new(), Vec::new());
    let mut h = DMatrix::<f64>::zeros(0, p);
    let mut omega = DMatrix::<f64>::zeros(0, 0);
    for step in &test.steps {
        if let Some(phi) = &step.transition {
            mean = phi * mean;
            psi = phi * psi;
            own = phi * own * phi.transpose();
            cross = phi * cross;
        }
        if let Some(input) = &step.input {
            mean += input;
        }
        if let Some(q) = &step.process_noise {
            own += q;
        }
        let measured: Vec<usize> = (0..step.values.len()).filter(|&i| !step.values[i].is_nan()).collect();
        let rows = DMatrix::from_fn(measured.len(), n, |i, j| step.measurement[(measured[i], j)]);
        let noise = DMatrix::from_fn(measured.len(), measured.len(), |i, j| step.noise[(measured[i], measured[j])]);
        let (before, count) = (z.len(), measured.len());
        for (k, &i) in measured.iter().enumerate() {
            z.push(step.values[i]);
            m.push(step.constant[i] + (rows.row(k) * &mean)[0]);
        }
        h = h.insert_rows(before, count, 0.0);
        h.view_mut((before, 0), (count, p)).copy_from(&(&rows * &psi));
        omega = omega.insert_rows(before, count, 0.0).insert_columns(before, count, 0.0);
        let with_past = &rows * &cross;
        omega.view_mut((before, 0), (count, before)).copy_from(&with_past);
        omega.view_mut((0, before), (before, count)).copy_from(&with_past.transpose());
        omega.view_mut((before, before), (count, count)).copy_from(&(&rows * &own * rows.transpose() + noise));
        cross = cross.insert_columns(before, count, 0.0);
        cross.view_mut((0, before), (n, count)).copy_from(&(&own * rows.transpose()));
    }
    Dense {
        values: DVector::from_vec(z),
        mean: DVector::from_vec(m),
        sensitivity: h,
        covariance: omega,
        last_mean: mean,
        last_sensitivity: psi,
        last_covariance: own,
        last_cross: cross,
    }
}

impl Dense {
    /// log p(z | ξ).
    pub(crate) fn log_likelihood(&self, xi: &DVector<f64>) -> f64 {
        log_density(&(&self.values - &self.mean - &self.sensitivity * xi), &self.covariance)
    }

    /// log p(z) when ξ ~ N(μ, Σ).
    pub(crate) fn marginal(&self, mu: &DVector<f64>, sigma: &DMatrix<f64>) -> f64 {
        let omega = &self.covariance + &self.sensitivity * sigma * self.sensitivity.transpose();
        log_density(&(&self.values - &self.mean - &self.sensitivity * mu), &omega)
    }

    /// (mean, covariance) of the last state given z and ξ.
    pub(crate) fn last_given(&self, xi: &DVector<f64>) -> (DVector<f64>, DMatrix<f64>) {
        let prior = &self.last_mean + &self.last_sensitivity * xi;
        if self.values.is_empty() {
            return (prior, self.last_covariance.clone());
        }
        let r = &self.values - &self.mean - &self.sensitivity * xi;
        let factor =
            self.covariance.clone().cholesky().expect("the covariance of the measurements is positive definite");
        let mean = prior + &self.last_cross * factor.solve(&r);
        (mean, &self.last_covariance - &self.last_cross * factor.solve(&self.last_cross.transpose()))
    }
}

/// log p of an ensemble: ξ_j ~ N(μ, Σ), independent.
pub(crate) fn ensemble_log_likelihood(tests: &[Plain], mu: &DVector<f64>, sigma: &DMatrix<f64>) -> f64 {
    tests.iter().map(|test| dense(test).marginal(mu, sigma)).sum()
}
