//! What errors of the estimates do to the expectation of a sum of squares.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::apply::tree::Weights;
use kalfit_filter::reduce::ReductionRef;
use kalfit_infer::{Estimand, Estimated, Knowledge};
use kalfit_model::{Phase, PhasedModel};

/// How far the parameters that tests are compared with can be trusted.
#[derive(Debug, Clone, Copy)]
pub enum Trust<'a> {
    /// As the covariance of all estimates says; exactly, where nothing was estimated.
    Estimates(&'a Knowledge),
    /// It is only known that so many tests, or groups of the outermost level, told them: as if each had told all of its states exactly, and with
    /// dynamic parameters known.
    Tests(usize),
}

/// What is known, by what it is of.
pub(super) struct Doubt<'a> {
    pub(super) knowledge: &'a Knowledge,
    /// Number of states p.
    states: usize,
    /// Means and regression coefficients among what was estimated: their places, and (element, regression column) of each.
    of_means: Vec<(usize, usize, Option<usize>)>,
    covariance_of_means: DMatrix<f64>,
    /// Of each of them, whether it is that of a state that is the same in all tests.
    is_fixed: Vec<bool>,
    /// Columns that means are regressed on.
    columns: usize,
}

/// How a parameter that was estimated moves what is expected of sums of squares, as long as its value is small.
pub(super) struct ValueEffect {
    /// Its place among what was estimated; `None` of one that the data do not determine.
    pub(super) place: Option<usize>,
    /// Of all distances together.
    pub(super) all: f64,
    /// Of the distance of each test.
    pub(super) tests: Vec<f64>,
    /// Of that of each group, the innermost level first.
    pub(super) groups: Vec<Vec<f64>>,
    /// Of each test's residual.
    pub(super) residuals: Vec<f64>,
}

/// Estimates of variances by themselves that go together by less than this are not tied.
const TIED: f64 = 0.1;
/// A mean that is the same in all tests took none of their variances where its errors are less than this part of all means'.
const SHARE: f64 = 0.01;
/// What hangs on something that is not determined by less than this part does not hang on it.
const FAINT: f64 = 1e-9;

impl<'a> Doubt<'a> {
    /// `varies`: whether a state differs from test to test.
    pub(super) fn new(model: &PhasedModel, knowledge: &'a Knowledge, varies: &dyn Fn(usize) -> bool) -> Doubt<'a> {
        let of_phase = |(phase, range): (&Phase, Range<usize>)| {
            let own = phase.model.mean.regression.iter();
            own.map(move |regression| (range.start + regression.element, regression.column)).collect::<Vec<_>>()
        };
        let regressions: Vec<(usize, usize)> = model.phases.iter().zip(model.ranges()).flat_map(of_phase).collect();
        let states = model.dimension();
        let of = |(place, known): (usize, &Estimand)| match *known {
            Estimand::Population(Estimated::Mean(i)) if i < states => Some((place, i, None)),
            Estimand::Population(Estimated::Coefficient(c)) => Some((place, regressions[c].0, Some(c))),
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
        Doubt { knowledge, states, of_means, covariance_of_means, is_fixed, columns: columns.len() }
    }

    /// Dynamic parameters: their places among what was estimated, and their standard errors; `None` of those that the data do not determine.
    pub(super) fn parameters(&self) -> impl Iterator<Item = (Option<usize>, &'a Estimand, Option<f64>)> {
        let knowledge = self.knowledge;
        let error = |i: usize| knowledge.covariance[(i, i)].max(0.0).sqrt();
        let own = knowledge.quantities.iter().enumerate().map(move |(i, known)| (Some(i), known, Some(error(i))));
        own.chain(knowledge.open.iter().map(|known| (None, known, None)))
            .filter(|(_, known, _)| matches!(known, Estimand::Parameter { .. }))
    }

    /// How the means that were estimated enter a test: p × means.
    pub(super) fn effect(&self, reduction: ReductionRef<'_>) -> DMatrix<f64> {
        let mut effect = DMatrix::zeros(self.states, self.of_means.len());
        for (at, &(_, element, coefficient)) in self.of_means.iter().enumerate() {
            effect[(element, at)] = coefficient.map_or(1.0, |c| reduction.covariates[c]);
        }
        effect
    }

    /// What errors of the means add on average.
    pub(super) fn of_means(&self, weights: &DMatrix<f64>) -> f64 {
        weights.dot(&self.covariance_of_means).max(0.0)
    }

    /// How many means of one element were estimated: one, one for each column that they are regressed on, and one for each state that is the same
    /// in all tests whose errors are a part of `all`, what errors of the means add.
    pub(super) fn means(&self, weights: &DMatrix<f64>, all: f64) -> usize {
        let own = |at: usize| weights[(at, at)] * self.covariance_of_means[(at, at)];
        let is_noticed = |&at: &usize| self.is_fixed[at] && own(at) > SHARE * all;
        let random = self.of_means.iter().zip(&self.is_fixed).any(|(own, is_fixed)| own.2.is_none() && !is_fixed);
        usize::from(random) + self.columns + (0..self.of_means.len()).filter(is_noticed).count()
    }

    /// The derivative of the expectation by each element of Σ.
    fn by(&self, weights: &Weights, known: &Estimand) -> f64 {
        let Estimand::Population(Estimated::Covariance(i, j)) = *known else { return 0.0 };
        let (level, p) = (i / self.states, self.states);
        let own = weights.of_level.get(level).map_or(0.0, |of| of[(i % p, j % p)]);
        if i == j { own } else { 2.0 * own }
    }

    /// The variance of the expectation by errors of covariances and parameters.
    pub(super) fn variance(&self, weights: &Weights, moved: &[(&ValueEffect, f64)]) -> f64 {
        let known = self.knowledge.quantities.iter().map(|known| self.by(weights, known));
        self.variance_along(DVector::from_iterator(self.knowledge.quantities.len(), known), moved)
    }

    /// The same by errors of parameters alone.
    pub(super) fn variance_by_parameters(&self, moved: &[(&ValueEffect, f64)]) -> f64 {
        self.variance_along(DVector::zeros(self.knowledge.quantities.len()), moved)
    }

    fn variance_along(&self, mut slopes: DVector<f64>, moved: &[(&ValueEffect, f64)]) -> f64 {
        for (one, slope) in moved {
            if let Some(place) = one.place {
                slopes[place] = *slope;
            }
        }
        slopes.dot(&(&self.knowledge.covariance * &slopes)).max(0.0)
    }

    /// Whether what is expected hangs on something that the data of the fit do not determine.
    pub(super) fn is_open(&self, weights: &Weights, moved: &[(&ValueEffect, f64)], degrees: f64) -> bool {
        let largest = weights.of_level.iter().map(DMatrix::amax).fold(0.0, f64::max);
        let by_sigma = self.knowledge.open.iter().any(|known| self.by(weights, known).abs() > FAINT * largest);
        by_sigma || self.is_moved_openly(moved, degrees)
    }

    /// The same by parameters alone.
    pub(super) fn is_moved_openly(&self, moved: &[(&ValueEffect, f64)], degrees: f64) -> bool {
        moved.iter().any(|(one, slope)| one.place.is_none() && slope.abs() > FAINT * degrees)
    }

    /// Of how many degrees of freedom Σ of a level is estimated as one, and how many of them have one variance: p and 1 for a full p × p matrix, 1
    /// and 1 for variances by themselves, 1 and m for m variances that are equal. X the error of Σ̂ in units of W⁻¹: E tr X² is (p + 1)/2 times
    /// Var[tr X], once, and Var[tr X]/m.
    pub(super) fn dimension(&self, w: &DMatrix<f64>, level: usize) -> (f64, f64) {
        let p = self.states;
        let own = |(place, known): (usize, &Estimand)| match *known {
            Estimand::Population(Estimated::Covariance(i, j)) if i / p == level => Some((place, i % p, j % p)),
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
            true if squares < (1.0 - TIED) * traces => (1.0, traces / squares),
            true => ((2.0 * squares / traces - 1.0).max(1.0), 1.0),
            false => (1.0, 1.0),
        }
    }
}
