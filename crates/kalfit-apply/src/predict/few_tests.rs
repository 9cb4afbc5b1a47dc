//! Errors and degrees of freedom of a prediction by the laws of few tests (theory §14).
//!
//! ```text
//! c = w'Cw + v               variance of the estimate of the mean: w by (μ, γ), v that of a known unit's own mean
//! ν = 2c²/(g'V_θg)           g_a = ∂c/∂θ_a                                                             (14.8)
//! h = s² + c,  ν_h = 2h²/(g_h'V_θg_h)                                                                  (14.12)
//! ```

use nalgebra::DVector;

use crate::predict::{FewTestsDegrees, Initial};
use kalfit_infer::{Estimand, Estimated, MeanAndVarianceLaw};

/// Derivatives of one value with respect to the estimates, and what else its errors depend on.
pub(super) struct FewTestsInput<'a> {
    pub(super) law: &'a MeanAndVarianceLaw<Estimand>,
    pub(super) initial: &'a Initial,
    /// Derivatives of the value with respect to ξ.
    pub(super) own: &'a DVector<f64>,
    /// Derivatives of the value's mean with respect to μ, then to the coefficients.
    pub(super) by_mean: DVector<f64>,
    /// Derivatives of (mean, variance by the initial state, variance by process noise) with respect to each element of
    /// θ.
    pub(super) by_theta: Vec<[f64; 3]>,
    /// Variance of the value over tests.
    pub(super) variance: f64,
    /// Variance of the value by `initial.left`.
    pub(super) left: f64,
}

/// Variances of the estimates of a value, with degrees of freedom.
pub(super) struct FewTestsErrors {
    /// Variance of the estimate of the mean, without `left`; `None` where parameters move the mean.
    pub(super) mean: Option<f64>,
    /// Variances of the estimates of the variance over tests, and of its part by the initial state.
    pub(super) variance: f64,
    pub(super) population: f64,
    pub(super) degrees: FewTestsDegrees,
}

impl FewTestsInput<'_> {
    /// The errors; `None` where the law says no degrees of freedom.
    pub(super) fn errors(&self) -> Option<FewTestsErrors> {
        let part =
            |of: &dyn Fn(&[f64; 3]) -> f64| DVector::from_iterator(self.by_theta.len(), self.by_theta.iter().map(of));
        let theta_variance = |g: &DVector<f64>| g.dot(&(&self.law.covariance * g)).max(0.0);
        let (by_mean, by_population) = (part(&|slopes| slopes[0]), part(&|slopes| slopes[1]));
        let by_variance = part(&|slopes| slopes[1] + slopes[2]);
        let of_mean = self.by_mean.dot(&(&self.law.mean_covariance * &self.by_mean)).max(0.0);
        let plain = self.by_mean.dot(&(&self.law.mean_covariance_plain * &self.by_mean)).max(0.0);
        let mean_slopes = self.law.mean_slopes.iter().map(|slope| self.by_mean.dot(&(slope * &self.by_mean)));
        let by_plain = DVector::from_iterator(self.by_theta.len(), mean_slopes);
        let by_known = &by_plain + self.by_left();
        let freedom = |value: f64, g: &DVector<f64>| match theta_variance(g) {
            variance if variance > 0.0 => 2.0 * value * value / variance,
            _ => f64::INFINITY,
        };
        let degrees = FewTestsDegrees {
            mean: freedom(plain + self.left, &by_known),
            new_test: freedom(self.variance + plain + self.left, &(&by_variance + &by_known)),
            seen: (self.initial.left.is_none() && plain > 0.0).then(|| freedom(plain, &by_plain)),
        };
        let moves = self
            .law
            .quantities
            .iter()
            .zip(&self.by_theta)
            .any(|(quantity, slopes)| matches!(quantity, Estimand::Parameter { .. }) && slopes[0] != 0.0);
        let found = FewTestsErrors {
            mean: (!moves).then(|| of_mean + theta_variance(&by_mean)),
            variance: theta_variance(&by_variance),
            population: theta_variance(&by_population),
            degrees,
        };
        let is_number = |x: f64| !x.is_nan() && x > 0.0;
        (found.variance.is_finite() && is_number(degrees.mean) && is_number(degrees.new_test)).then_some(found)
    }

    /// Derivatives of the variance by `initial.left` with respect to θ, for a known unit of n equal tests: the mean of
    /// the unit follows μ by the matrix D, and each of its tests by (I - D)/n. What noise adds is the rest: doubled
    /// variances of everything double this variance, too, so Σ_a θ_a ∂/∂θ_a gives it back. The rest is shared among the
    /// variances of noise. The change with a parameter that is no variance, such as a time constant, is left out: the degrees
    /// of freedom are then those at its estimate.
    fn by_left(&self) -> DVector<f64> {
        let (p, count) = (self.own.len(), self.law.quantities.len());
        if self.initial.left.is_none() {
            return DVector::zeros(count);
        }
        let group_tests = self.initial.group_tests.max(1) as f64;
        let by_unit = self.by_mean.rows(0, p);
        let by_test = self.own - by_unit;
        let of = |quantity: &Estimand| {
            let Estimand::Population(Estimated::Covariance(i, j)) = *quantity else { return 0.0 };
            let (a, b, both) = (i % p, j % p, if i == j { 1.0 } else { 2.0 });
            match self.initial.levels.contains(&(i / p)) {
                true => both * by_test[a] * by_test[b] / group_tests,
                false => both * by_unit[a] * by_unit[b],
            }
        };
        let mut by_left = DVector::from_iterator(count, self.law.quantities.iter().map(of));
        let of_spread: f64 = by_left.iter().zip(&self.law.values).map(|(slope, value)| slope * value).sum();
        let is_noise = |a: &usize| {
            matches!(self.law.quantities[*a], Estimand::Parameter { .. })
                && self.law.powers[*a] > 0.0
                && self.law.values[*a] > 0.0
        };
        let noises: Vec<usize> = (0..count).filter(is_noise).collect();
        let rest = (self.left - of_spread).max(0.0) / noises.len().max(1) as f64;
        noises.into_iter().for_each(|a| by_left[a] += self.law.powers[a] * rest / self.law.values[a]);
        by_left
    }
}
