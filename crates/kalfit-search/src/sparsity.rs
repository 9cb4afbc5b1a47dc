//! Which tests depend on which values of α: values that no test has in common can move in one run of the filters.

use crate::colours::colours;
use crate::profile_likelihood::{ProfileLikelihood, TestResults};
use kalfit_filter::score::Gradient;

/// The dependences between the tests and the values of α.
#[derive(Debug)]
pub(super) struct JacobianSparsity {
    /// Indices of the tests that depend on each value.
    pub(super) tests: Vec<Vec<usize>>,
    /// Indices of the values that each test depends on.
    pub(super) of_test: Vec<Vec<usize>>,
    /// Whether each value occurs in a matrix of the covariance structure.
    pub(super) matrix: Vec<bool>,
    count: usize,
}

impl JacobianSparsity {
    /// The dependences between tests and n values, from the values that occur in the scores of each test.
    pub(super) fn of(objective: &ProfileLikelihood<'_>, all: &TestResults, n: usize) -> JacobianSparsity {
        let mut tests = vec![Vec::new(); n];
        let mentioned = |gradient: &Gradient| gradient.iter().map(|(s, _)| *s).collect();
        // a value that affects one test affects the results of all tests of the same unit
        let moved = |gradient| if objective.model.levels.is_empty() { mentioned(gradient) } else { (0..n).collect() };
        let of_test: Vec<Vec<usize>> = all.scores.iter().map(moved).collect();
        for (j, slots) in of_test.iter().enumerate() {
            slots.iter().for_each(|&s| tests[s].push(j));
        }
        let mut matrix = vec![false; n];
        objective.matrix_slots().into_iter().for_each(|s| matrix[s] = true);
        JacobianSparsity { tests, of_test, matrix, count: all.scores.len() }
    }

    /// Whether all tests depend on a value.
    pub(super) fn is_common(&self, s: usize) -> bool {
        self.tests[s].len() == self.count
    }

    /// Sets of active values without a common test; with `apart`, one set per value.
    pub(super) fn colours(&self, active: &[usize], apart: bool) -> Vec<Vec<usize>> {
        if apart {
            return active.iter().map(|&s| vec![s]).collect();
        }
        let is_whole = |s: usize| self.matrix[s] || self.is_common(s);
        let with_tests = |&s: &usize| (s, (!is_whole(s)).then_some(&*self.tests[s]));
        colours(active.iter().map(with_tests), self.count)
    }
}
