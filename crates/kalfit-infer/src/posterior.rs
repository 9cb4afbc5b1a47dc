//! Results of each test: likelihood, posterior of ξ (10), (11), and distance from the population.

use std::ops::Range;

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::posteriors::{Distance, NumberedPosteriors, Posteriors};
use kalfit_algebra::{Conditional, posterior_root, symmetric};
use kalfit_estimate::{ChainDetail, ClassRef, ClassTerms, Classes, Point, Problem, map_classes};
use kalfit_filter::reduce::{ReductionRef, Reductions};
use kalfit_model::unpack;

/// Number of tests that one thread takes at a time.
const TESTS_PER_CHUNK: usize = 64;

/// Posteriors of all tests, without groups, at a point, in the order of the reductions.
pub(super) fn ungrouped(problem: &Problem, point: &Point, reductions: &Reductions) -> Posteriors {
    let classes = problem.classes.of(reductions);
    let of = |classes: &Classes| of_classes((problem, classes), point, reductions);
    let found: Vec<NumberedPosteriors> = if classes.has_class_per_test() {
        of(&classes)
    } else {
        let all: Vec<usize> = (0..reductions.len()).collect();
        all.par_chunks(TESTS_PER_CHUNK).flat_map_iter(|tests| of(&classes.each(reductions, tests))).collect()
    };
    Posteriors::ordered(sizes(problem), &found)
}

/// Posteriors of the tests of classes that have one test each.
fn of_classes(
    (problem, classes): (&Problem, &Classes),
    point: &Point,
    reductions: &Reductions,
) -> Vec<NumberedPosteriors> {
    let (sigma, sizes) = (point.covariance(), sizes(problem));
    let evaluator = PosteriorEvaluator { problem, point, sigma: &sigma };
    let none = || (NumberedPosteriors::new(&sizes), PosteriorBuffers::default());
    let told = |(found, buffers): &mut (NumberedPosteriors, PosteriorBuffers),
                k: usize,
                class: ClassRef<'_>,
                terms: &ClassTerms<'_>| {
        let test = classes.tests_of(k)[0];
        evaluator.mean(class, terms, &mut buffers.mean);
        evaluator.covariances(class, terms, buffers);
        let own = (terms.value(class), Distance::of(terms, class, reductions.get(test)));
        found.of(test).push(own, &buffers.mean, &buffers.covariances);
    };
    let found = map_classes(classes, &problem.mean.regressors, point, ChainDetail::Posterior, &none, &told);
    found.into_iter().map(|(found, _)| found).collect()
}

/// Number of states of each phase.
fn sizes(problem: &Problem) -> Vec<usize> {
    problem.covariance.elements.blocks().iter().map(Range::len).collect()
}

/// Buffers for the posterior of one test.
#[derive(Debug, Default)]
struct PosteriorBuffers {
    mean: Vec<f64>,
    covariances: Vec<f64>,
}

/// The point at which posteriors are computed.
struct PosteriorEvaluator<'a> {
    problem: &'a Problem,
    point: &'a Point,
    sigma: &'a DMatrix<f64>,
}

impl PosteriorEvaluator<'_> {
    /// Writes E[ξ | z] = μ_j + Σr, in the user's units.
    fn mean(&self, class: ClassRef<'_>, terms: &ClassTerms<'_>, mean: &mut Vec<f64>) {
        self.point.put_mean(class, &self.problem.mean.regressors, mean);
        for (mean, sigma) in mean.iter_mut().zip(self.sigma.row_iter()) {
            *mean += sigma.iter().zip(&terms.r).map(|(sigma, r)| sigma * r).sum::<f64>();
        }
        self.problem.classes.frame.take_mean_out(mean);
    }

    /// Var[ξ_i | z] of each phase, in the user's units; Σ for phases that a test stored phase by phase does not have.
    fn covariances(&self, class: ClassRef<'_>, terms: &ClassTerms<'_>, buffers: &mut PosteriorBuffers) {
        let scale = &self.problem.classes.frame.scale;
        let whole = class.chain.is_none().then(|| posterior_covariance(class.factor, &self.point.root));
        let all = whole.as_ref().unwrap_or(self.sigma);
        buffers.covariances.clear();
        for (f, states) in self.problem.covariance.elements.blocks().iter().enumerate() {
            let (start, before, size) = (states.start, buffers.covariances.len(), states.len());
            let own = terms.covariances.get(f).filter(|_| whole.is_none());
            let entry = |a: usize, b: usize| own.map_or_else(|| all[(start + a, start + b)], |own| own[(a, b)]);
            buffers.covariances.resize(before + size * size, 0.0);
            symmetric::write_scaled(&scale[states.clone()], entry, &mut buffers.covariances[before..]);
        }
    }
}

/// log p of a test's measurements, and the test's distance from the population, at any point.
pub(crate) fn distance(problem: &Problem, point: &Point, reductions: &Reductions, test: usize) -> (f64, Distance) {
    let class = problem.classes.single(reductions, test);
    let mut terms = ClassTerms::new(point, &problem.mean.regressors);
    terms.evaluate(class.view(), ChainDetail::Posterior);
    (terms.value(class.view()), Distance::of(&terms, class.view(), reductions.get(test)))
}

impl Distance {
    fn of(terms: &ClassTerms<'_>, class: ClassRef<'_>, reduction: ReductionRef<'_>) -> Distance {
        let p = terms.r.len();
        let own_rank = || (0..p).filter(|&i| (i..p).any(|k| reduction.factor[i + k * (k + 1) / 2] != 0.0)).count();
        let free_states = reduction.exact.map(|exact| (exact.values.len(), exact.free_states(p)));
        let told = free_states
            .map(|(q, free_states)| (q, free_states.least_squares(&unpack(reduction.factor, p), reduction.data)));
        let rank = told.map_or_else(own_rank, |(q, (rank, _))| q + rank);
        // For tests stored phase by phase the quadratic form also contains the disagreement of the test's phases at any
        // ξ: the sum of the phases' constants exceeds the stacked constant by half of this disagreement and of the
        // log-determinant of the noise between phases.
        let disagreement = match class.chain {
            Some(_) => 2.0 * (class.constant - reduction.constant) - terms.link_log_det,
            // with exact rows, the quadratic form contains the disagreement of the other rows with the exact rows
            None => told.map_or(0.0, |(_, (_, left))| left),
        };
        let squared = (terms.quadratic - disagreement).max(0.0);
        Distance::new(squared, rank)
    }
}

/// F (I + F'JF)⁻¹ F'; `factor` is R with J = R'R by rows, then C. With exact rows C, F is the root of Σ given Cξ = g.
fn posterior_covariance(factor: &[f64], root: &DMatrix<f64>) -> DMatrix<f64> {
    let p = root.nrows();
    let (factor, exact) = factor.split_at(p * p);
    let known = DMatrix::from_row_slice(exact.len().checked_div(p).unwrap_or(0), p, exact);
    let conditional = if exact.is_empty() { None } else { Conditional::new(known, root) };
    let half = posterior_root(
        &DMatrix::from_row_slice(p, p, factor),
        conditional.as_ref().map_or(root, |conditional| &conditional.root),
    );
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
