//! Number of degrees of freedom that the variance of a value over tests lost to its mean, by maximum likelihood.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, DVector};

use kalfit_algebra::symmetric;
use kalfit_infer::{Estimand, Estimated, Knowledge};

/// Fraction of a mean's error variance below which the errors of one estimate cost no degree of freedom.
const NOTICEABLE_SHARE: f64 = 0.01;
/// Largest difference from 1 of the squared correlation of two estimated variances at which the two count as one
/// estimate.
const PERFECT_CORRELATION_GAP: f64 = 1e-6;
/// Eigenvalue of a correlation matrix of states below which the direction has no independent variation.
const LEAST_EIGENVALUE: f64 = 1e-9;

/// Inputs for one value: the errors of the estimates, and the derivatives of the value's mean and variance.
pub(super) struct LostDegrees<'a> {
    pub(super) knowledge: &'a Knowledge,
    /// Covariance of the initial state of tests.
    pub(super) covariance: &'a DMatrix<f64>,
    /// (Element of μ, column of the data) of each regression coefficient.
    pub(super) regressions: &'a [(usize, usize)],
    /// Derivatives with respect to the estimates: `by_mean` of the value's mean, `by_variance` of the value's variance
    /// by the initial state.
    pub(super) by_mean: DVector<f64>,
    pub(super) by_variance: DVector<f64>,
    /// Whether the initial value of a state affects the value.
    pub(super) affects: &'a dyn Fn(usize) -> bool,
}

impl LostDegrees<'_> {
    /// Sum of three numbers. 1 for the means of the states that affect the value, because every test determines one
    /// combination of the states; where variances were tied, the number of independent directions of the tied states. 1
    /// for each column that the means are regressed on (for each column and element where variances were tied). 1 for
    /// each parameter, and for each state that is identical in all tests, that contributes a noticeable part of the
    /// error of the value's mean.
    pub(super) fn lost(&self) -> usize {
        let tied = self.tied();
        let is_in = |element: usize| (self.affects)(element) || tied.contains(&element);
        let has_varying_mean = self.means().any(|(_, i)| self.varies(i) && (self.affects)(i));
        let coefficients = self.quantities().filter_map(|(_, known)| match *known {
            Estimand::Population(Estimated::Coefficient(c)) if is_in(self.regressions[c].0) => {
                Some(self.regressions[c])
            }
            _ => None,
        });
        let column_key = |(element, column): (usize, usize)| (if tied.len() > 1 { element } else { 0 }, column);
        let columns: BTreeSet<(usize, usize)> = coefficients.map(column_key).collect();
        usize::from(has_varying_mean).max(self.independent_directions(&tied)) + columns.len() + self.noticeable_others()
    }

    fn quantities(&self) -> impl Iterator<Item = (usize, &Estimand)> {
        self.knowledge.quantities.iter().enumerate()
    }

    fn means(&self) -> impl Iterator<Item = (usize, usize)> {
        let states = self.covariance.nrows();
        self.quantities().filter_map(move |(k, known)| match *known {
            Estimand::Population(Estimated::Mean(i)) if i < states => Some((k, i)),
            _ => None,
        })
    }

    /// Estimated variances of any level: (index among the estimates, state).
    fn variances(&self) -> impl Iterator<Item = (usize, usize)> {
        let states = self.covariance.nrows();
        self.quantities().filter_map(move |(k, known)| match *known {
            Estimand::Population(Estimated::Covariance(i, j)) if i == j => Some((k, i % states)),
            _ => None,
        })
    }

    fn varies(&self, state: usize) -> bool {
        self.covariance[(state, state)] > 0.0 || self.variances().any(|(_, i)| i == state)
    }

    /// Number of parameters, and of means of states that are identical in all tests, whose errors are a noticeable part
    /// of the error of the value's mean.
    fn noticeable_others(&self) -> usize {
        let covariances = &self.knowledge.covariance * &self.by_mean;
        let whole = self.by_mean.dot(&covariances);
        let is_noticeable = |k: usize| {
            let own = self.knowledge.covariance[(k, k)];
            own > 0.0 && (self.by_mean[k].powi(2) * own).max(covariances[k].powi(2) / own) > NOTICEABLE_SHARE * whole
        };
        let fixed_means = self.means().filter(|&(_, i)| !self.varies(i)).map(|(k, _)| k);
        let affects_mean = |k: usize| self.by_mean[k] != 0.0;
        let parameters = self.quantities().filter(|(_, known)| matches!(known, Estimand::Parameter { .. }));
        let parameters = parameters.map(|(k, _)| k).filter(|&k| affects_mean(k));
        fixed_means.chain(parameters).filter(|&k| is_noticeable(k)).count()
    }

    /// States with an estimated mean whose estimated variance is perfectly correlated with the variance of the value.
    fn tied(&self) -> BTreeSet<usize> {
        let covariances = &self.knowledge.covariance * &self.by_variance;
        let whole = self.by_variance.dot(&covariances);
        let is_tied = |k: usize| {
            covariances[k].powi(2) > (1.0 - PERFECT_CORRELATION_GAP) * whole * self.knowledge.covariance[(k, k)]
        };
        let has_mean = |state: usize| self.means().any(|(_, i)| i == state);
        self.variances().filter(|&(k, i)| whole > 0.0 && is_tied(k) && has_mean(i)).map(|(_, i)| i).collect()
    }

    /// Rank of the correlation matrix of `states`: the number of directions in which the states vary independently.
    fn independent_directions(&self, states: &BTreeSet<usize>) -> usize {
        let states: Vec<usize> = states.iter().copied().filter(|&i| self.covariance[(i, i)] > 0.0).collect();
        if states.len() < 2 {
            return states.len();
        }
        let size = |i: usize| self.covariance[(states[i], states[i])].sqrt();
        let correlations = DMatrix::from_fn(states.len(), states.len(), |i, k| {
            self.covariance[(states[i], states[k])] / (size(i) * size(k))
        });
        symmetric::eigen(&correlations).0.iter().filter(|value| **value > LEAST_EIGENVALUE).count()
    }
}
