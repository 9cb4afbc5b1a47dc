//! Effects of the errors of estimates on the expectation of a sum of squares.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::apply::tree::Weights;
use kalfit_filter::reduce::ReductionRef;
use kalfit_infer::{Estimand, Estimated, Knowledge};
use kalfit_model::{Phase, PhasedModel};

/// Uncertainty of the parameters that tests are compared with.
#[derive(Debug, Clone, Copy)]
pub enum Trust<'a> {
    /// The covariance of all estimates is known; [`Knowledge::exact`] where nothing was estimated.
    Estimates(&'a Knowledge),
    /// Only the number of tests, or of groups of the outermost level, that the parameters were estimated from is known.
    /// Each test or group is assumed to have determined all states exactly, and dynamic parameters count as known.
    Tests(usize),
}

/// Covariance of all estimates, and separately the covariance of the means and regression coefficients.
pub(super) struct EstimateErrors<'a> {
    pub(super) knowledge: &'a Knowledge,
    /// Number of states p.
    states: usize,
    /// Estimated means and regression coefficients: (index among the estimates, element of μ, index of the coefficient;
    /// `None` for a mean).
    of_means: Vec<(usize, usize, Option<usize>)>,
    covariance_of_means: DMatrix<f64>,
    /// Whether each entry of `of_means` is the mean of a state that is identical in all tests.
    is_fixed: Vec<bool>,
    /// Number of columns that means are regressed on.
    columns: usize,
}

/// Derivatives of the expectations of sums of squares with respect to one estimated parameter.
pub(super) struct ParameterEffect {
    /// Index among the estimates; `None` for a parameter that the data do not determine.
    pub(super) index: Option<usize>,
    /// Derivative of E[sum of all distances].
    pub(super) all: f64,
    /// Derivative of E[distance] for each test.
    pub(super) tests: Vec<f64>,
    /// Derivative of E[distance] for each group of each level, the innermost level first.
    pub(super) groups: Vec<Vec<f64>>,
    /// Derivative of E[residual] for each test.
    pub(super) residuals: Vec<f64>,
}

/// Smallest relative difference of E tr X² and Var[tr X] (see `dimension`) at which several states count as sharing one
/// variance.
const EQUAL_VARIANCE_GAP: f64 = 0.1;
/// Smallest fraction of the increase by errors of all means at which the mean of a state that is identical in all tests
/// counts as estimated.
const NOTICEABLE_SHARE: f64 = 0.01;
/// Fraction of the scale of a derivative below which the derivative counts as zero.
const NEGLIGIBLE_SLOPE: f64 = 1e-9;

impl<'a> EstimateErrors<'a> {
    /// `varies`: whether a state differs from test to test.
    pub(super) fn new(
        model: &PhasedModel,
        knowledge: &'a Knowledge,
        varies: &dyn Fn(usize) -> bool,
    ) -> EstimateErrors<'a> {
        let of_phase = |(phase, range): (&Phase, Range<usize>)| {
            let own = phase.model.mean.regression.iter();
            own.map(move |regression| (range.start + regression.element, regression.column)).collect::<Vec<_>>()
        };
        let regressions: Vec<(usize, usize)> = model.phases.iter().zip(model.ranges()).flat_map(of_phase).collect();
        let states = model.dimension();
        let of = |(index, known): (usize, &Estimand)| match *known {
            Estimand::Population(Estimated::Mean(i)) if i < states => Some((index, i, None)),
            Estimand::Population(Estimated::Coefficient(c)) => Some((index, regressions[c].0, Some(c))),
            _ => None,
        };
        let of_means: Vec<(usize, usize, Option<usize>)> =
            knowledge.quantities.iter().enumerate().filter_map(of).collect();
        let places: Vec<usize> = of_means.iter().map(|own| own.0).collect();
        let covariance_of_means = knowledge.covariance.select_rows(&places).select_columns(&places);
        let mut columns: Vec<usize> = of_means.iter().filter_map(|own| own.2).map(|c| regressions[c].1).collect();
        columns.sort_unstable();
        columns.dedup();
        let is_fixed = of_means.iter().map(|&(_, element, column)| column.is_none() && !varies(element)).collect();
        EstimateErrors { knowledge, states, of_means, covariance_of_means, is_fixed, columns: columns.len() }
    }

    /// (Index among the estimates, dynamic parameter, standard error) of each dynamic parameter; index and error are
    /// `None` where the data do not determine the parameter.
    pub(super) fn parameters(&self) -> impl Iterator<Item = (Option<usize>, &'a Estimand, Option<f64>)> {
        let knowledge = self.knowledge;
        let error = |i: usize| knowledge.covariance[(i, i)].max(0.0).sqrt();
        let own = knowledge.quantities.iter().enumerate().map(move |(i, known)| (Some(i), known, Some(error(i))));
        own.chain(knowledge.open.iter().map(|known| (None, known, None)))
            .filter(|(_, known, _)| matches!(known, Estimand::Parameter { .. }))
    }

    /// Derivatives of a test's mean with respect to the estimated means and coefficients, p × length of `of_means`.
    pub(super) fn effect(&self, reduction: ReductionRef<'_>) -> DMatrix<f64> {
        let mut effect = DMatrix::zeros(self.states, self.of_means.len());
        for (at, &(_, element, coefficient)) in self.of_means.iter().enumerate() {
            effect[(element, at)] = coefficient.map_or(1.0, |c| reduction.covariates[c]);
        }
        effect
    }

    /// Expected increase of a sum of squares by errors of the means: tr(`weights` · covariance of the means).
    pub(super) fn of_means(&self, weights: &DMatrix<f64>) -> f64 {
        weights.dot(&self.covariance_of_means).max(0.0)
    }

    /// Number of estimated means that increase a sum of squares: 1 if the mean of a state that varies was estimated, 1
    /// for each column that means are regressed on, and 1 for each state that is identical in all tests and whose
    /// errors are a noticeable part of `all`, the increase by errors of all means.
    pub(super) fn means(&self, weights: &DMatrix<f64>, all: f64) -> usize {
        let own = |at: usize| weights[(at, at)] * self.covariance_of_means[(at, at)];
        let is_noticeable = |&at: &usize| self.is_fixed[at] && own(at) > NOTICEABLE_SHARE * all;
        let has_varying_mean =
            self.of_means.iter().zip(&self.is_fixed).any(|(own, is_fixed)| own.2.is_none() && !is_fixed);
        usize::from(has_varying_mean) + self.columns + (0..self.of_means.len()).filter(is_noticeable).count()
    }

    /// Derivative of the expectation with respect to an element of Σ; zero for any other quantity.
    fn covariance_slope(&self, weights: &Weights, known: &Estimand) -> f64 {
        let Estimand::Population(Estimated::Covariance(i, j)) = *known else { return 0.0 };
        let (level, p) = (i / self.states, self.states);
        let own = weights.of_level.get(level).map_or(0.0, |of| of[(i % p, j % p)]);
        if i == j { own } else { 2.0 * own }
    }

    /// Variance of the expectation due to errors of covariances and parameters. `moved`: (parameter, derivative of the
    /// expectation).
    pub(super) fn variance(&self, weights: &Weights, moved: &[(&ParameterEffect, f64)]) -> f64 {
        let known = self.knowledge.quantities.iter().map(|known| self.covariance_slope(weights, known));
        self.variance_along(DVector::from_iterator(self.knowledge.quantities.len(), known), moved)
    }

    /// Variance of the expectation due to errors of parameters alone.
    pub(super) fn variance_by_parameters(&self, moved: &[(&ParameterEffect, f64)]) -> f64 {
        self.variance_along(DVector::zeros(self.knowledge.quantities.len()), moved)
    }

    fn variance_along(&self, mut slopes: DVector<f64>, moved: &[(&ParameterEffect, f64)]) -> f64 {
        for (one, slope) in moved {
            if let Some(index) = one.index {
                slopes[index] = *slope;
            }
        }
        slopes.dot(&(&self.knowledge.covariance * &slopes)).max(0.0)
    }

    /// Whether the expectation depends on a quantity that the data of the fit do not determine.
    pub(super) fn depends_on_open(&self, weights: &Weights, moved: &[(&ParameterEffect, f64)], degrees: f64) -> bool {
        let largest = weights.of_level.iter().map(DMatrix::amax).fold(0.0, f64::max);
        let by_sigma = self
            .knowledge
            .open
            .iter()
            .any(|known| self.covariance_slope(weights, known).abs() > NEGLIGIBLE_SLOPE * largest);
        by_sigma || self.depends_on_open_parameter(moved, degrees)
    }

    /// Whether the expectation depends on a parameter that the data of the fit do not determine.
    pub(super) fn depends_on_open_parameter(&self, moved: &[(&ParameterEffect, f64)], degrees: f64) -> bool {
        moved.iter().any(|(one, slope)| one.index.is_none() && slope.abs() > NEGLIGIBLE_SLOPE * degrees)
    }

    /// (Size of the blocks of a level's Σ that are estimated as one matrix, number of states that share one variance):
    /// (p, 1) for a full p × p matrix, (1, 1) for separate variances, (1, m) for m equal variances. With X the error of
    /// Σ̂ in units of W⁻¹, E tr X² is Var[tr X] times (p + 1)/2, 1 and 1/m in the three cases.
    pub(super) fn dimension(&self, w: &DMatrix<f64>, level: usize) -> (f64, f64) {
        let p = self.states;
        let own = |(index, known): (usize, &Estimand)| match *known {
            Estimand::Population(Estimated::Covariance(i, j)) if i / p == level => Some((index, i % p, j % p)),
            _ => None,
        };
        let elements: Vec<(usize, usize, usize)> =
            self.knowledge.quantities.iter().enumerate().filter_map(own).collect();
        let places = |i: usize, j: usize| [(i, j), (j, i)].into_iter().take(if i == j { 1 } else { 2 });
        let (mut squares, mut traces) = (0.0, 0.0);
        for &(a, i, j) in &elements {
            for &(b, k, l) in &elements {
                let covariance = self.knowledge.covariance[(a, b)];
                for (i, j) in places(i, j) {
                    for (k, l) in places(k, l) {
                        squares += covariance * w[(l, i)] * w[(j, k)];
                        traces += covariance * w[(i, j)] * w[(k, l)];
                    }
                }
            }
        }
        match traces > 0.0 {
            true if squares < (1.0 - EQUAL_VARIANCE_GAP) * traces => (1.0, traces / squares),
            true => ((2.0 * squares / traces - 1.0).max(1.0), 1.0),
            false => (1.0, 1.0),
        }
    }
}
