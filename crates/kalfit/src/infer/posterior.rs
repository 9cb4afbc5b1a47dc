//! What each test says: its likelihood, the posterior of its ξ (10), (11), and its distance from the population.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::estimate::{Class, Estimate, Point, Problem, Terms};
use crate::linalg::posterior_root;
use crate::reduce::Reduction;

/// What one test says, at an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Posterior {
    /// log p of its measurements.
    pub log_likelihood: f64,
    /// E[ξ | z] (p).
    pub mean: Vec<f64>,
    /// Var[ξ | z] (p × p).
    pub covariance: DMatrix<f64>,
    /// How far the test is from the population.
    pub distance: Distance,
}

/// Standardised squared distance of a test's own estimate from the population mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distance {
    /// (y - Jμ)'(J + JΣJ)⁺(y - Jμ).
    pub squared: f64,
    /// Rank of J.
    pub degrees_of_freedom: usize,
    /// χ² tail probability; `None` without degrees of freedom.
    pub p_value: Option<f64>,
}

/// Posteriors of all tests, in their order.
pub fn posteriors(estimate: &Estimate, reductions: &[Reduction]) -> Vec<Posterior> {
    reductions.par_iter().map(|reduction| posterior(estimate, reduction)).collect()
}

fn posterior(estimate: &Estimate, reduction: &Reduction) -> Posterior {
    let state = &estimate.state;
    let (problem, point) = (&state.problem, &state.place.point);
    let class = problem.classes.single(reduction);
    let terms = terms(problem, point, &class);
    let mut mean = DVector::from_column_slice(&point.mean);
    for (c, &element) in problem.mean.regressors.iter().enumerate() {
        mean[element] += class.covariates[c] * point.coefficients[c];
    }
    mean += point.covariance() * DVector::from_column_slice(&terms.r);
    let frame = &problem.classes.frame;
    Posterior {
        log_likelihood: terms.value(&class),
        mean: frame.mean_out(mean.as_slice()),
        covariance: frame.covariance_out(&posterior_covariance(&class.factor, &point.root)),
        distance: Distance::new(terms.quadratic, &class),
    }
}

/// log p of a test's measurements and its distance from the population, at any point.
pub(crate) fn distance(problem: &Problem, point: &Point, reduction: &Reduction) -> (f64, Distance) {
    let class = problem.classes.single(reduction);
    let terms = terms(problem, point, &class);
    (terms.value(&class), Distance::new(terms.quadratic, &class))
}

fn terms(problem: &Problem, point: &Point, class: &Class) -> Terms {
    let mut terms = Terms::new(point.mean.len());
    terms.evaluate(class, &problem.mean.regressors, point);
    terms
}

impl Distance {
    fn new(squared: f64, class: &Class) -> Distance {
        let p = class.mean.len();
        let rank = (0..p).filter(|&i| (i..p).any(|k| class.factor[i * p + k] != 0.0)).count();
        let p_value = ChiSquared::new(rank as f64).ok().map(|chi| chi.sf(squared));
        Distance { squared, degrees_of_freedom: rank, p_value }
    }
}

/// F (I + F'JF)⁻¹ F'; `factor` is R with J = R'R, by rows.
fn posterior_covariance(factor: &[f64], root: &DMatrix<f64>) -> DMatrix<f64> {
    let p = root.nrows();
    let half = posterior_root(&DMatrix::from_row_slice(p, p, factor), root);
    &half * half.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_test_that_knows_much_more_than_the_population_has_a_posterior() {
        // two directions of very different information, neither along a state
        let factor = [3e12, 1e12, 0.0, 0.5];
        let root = DMatrix::from_row_slice(2, 2, &[1e3, 0.0, -3e3, 1e-4]);
        let found = posterior_covariance(&factor, &root);
        // by hand: along the root's first column RF is (0, -1500)', along its second (1e8, 5e-5)'
        let first = 1.0 / (1.0 + 1500.0_f64.powi(2));
        assert!((found[(0, 0)] / (1e6 * first) - 1.0).abs() < 1e-6, "{} {}", found[(0, 0)], 1e6 * first);
        assert!(found.iter().all(|x| x.is_finite()), "{found}");
        let huge = posterior_covariance(&[1e140, 1e140, 0.0, 1.0], &DMatrix::from_element(2, 2, 1e3));
        assert!(huge.iter().all(|x| x.is_finite()), "{huge}");
    }
}
