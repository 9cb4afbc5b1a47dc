//! The division of tests into classes, in an order that does not depend on the order of the data.

use std::cmp::Ordering;

use rayon::prelude::*;

use kalfit_filter::reduce::Reductions;
use kalfit_model::{Chain, ChainPhase};

/// The indices of the tests of each class.
#[derive(Debug, Clone)]
pub(super) struct Members {
    /// Indices of the tests, class after class.
    tests: Vec<usize>,
    /// Position in `tests` where each class ends.
    ends: Vec<usize>,
}

impl Members {
    /// Classes of one test each.
    pub(super) fn each(tests: &[usize]) -> Members {
        Members { tests: tests.to_vec(), ends: (1..=tests.len()).collect() }
    }

    /// The indices of all tests, class after class.
    pub(super) fn tests(&self) -> &[usize] {
        &self.tests
    }

    /// Number of classes.
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// The indices of the tests of a class.
    pub(super) fn class(&self, class: usize) -> &[usize] {
        &self.tests[class.checked_sub(1).map_or(0, |before| self.ends[before])..self.ends[class]]
    }
}

/// The tests sorted by the first and the last entry of R, then in [`canonical`] order. With `chained`, tests form one
/// class only if the matrices of every phase and link are equal.
pub(super) fn ordered(reductions: &Reductions, chained: bool) -> Members {
    // these two entries distinguish most reductions, and comparing two keys needs no access to whole reductions
    let keyed = |j: usize| {
        let factor = reductions.factor(j);
        ((factor.first().map_or(0, |x| ordinal(*x)), factor.last().map_or(0, |x| ordinal(*x))), j)
    };
    let mut order: Vec<_> = (0..reductions.len()).into_par_iter().map(keyed).collect();
    order.par_sort_unstable_by(|a, b| {
        a.0.cmp(&b.0).then_with(|| canonical(reductions, a.1, b.1)).then_with(|| a.1.cmp(&b.1))
    });
    let differ =
        |a: &((i64, i64), usize), b: &((i64, i64), usize)| a.0 != b.0 || !same_class(reductions, (a.1, b.1), chained);
    let mut ends: Vec<usize> = (1..order.len()).filter(|&at| differ(&order[at - 1], &order[at])).collect();
    ends.extend((!order.is_empty()).then_some(order.len()));
    let mut tests: Vec<usize> = order.into_iter().map(|(_, j)| j).collect();
    tests.shrink_to_fit(); // the list reuses the memory of the keys, which took three times as much
    Members { tests, ends }
}

/// An integer with the same order as [`f64::total_cmp`].
fn ordinal(x: f64) -> i64 {
    let bits = x.to_bits() as i64;
    bits ^ (((bits >> 63) as u64) >> 1) as i64
}

/// Order by R, covariates, C, then id: a total order that puts classes together and ignores the order of the data.
fn canonical(reductions: &Reductions, a: usize, b: usize) -> Ordering {
    compare(reductions.factor(a), reductions.factor(b))
        .then_with(|| compare(reductions.covariates(a), reductions.covariates(b)))
        .then_with(|| compare(exact(reductions, a), exact(reductions, b)))
        .then_with(|| compare_chains(reductions.chain(a), reductions.chain(b)))
        .then_with(|| reductions.id(a).cmp(reductions.id(b)))
}

/// Order by all matrices of the phases and of the links between phases.
fn compare_chains(a: Option<&Chain>, b: Option<&Chain>) -> Ordering {
    let (Some(a), Some(b)) = (a, b) else { return a.is_some().cmp(&b.is_some()) };
    let of_phases = |(a, b): (&ChainPhase, &ChainPhase)| {
        let links = match (&a.link, &b.link) {
            (Some(a), Some(b)) => compare(a.sensitivity.as_slice(), b.sensitivity.as_slice())
                .then_with(|| compare(a.root.as_slice(), b.root.as_slice())),
            (a, b) => a.is_some().cmp(&b.is_some()),
        };
        compare(&a.factor, &b.factor).then(links)
    };
    let different = a.phases.iter().zip(&b.phases).map(of_phases).find(|o| o.is_ne());
    different.unwrap_or_else(|| a.phases.len().cmp(&b.phases.len()))
}

/// C of a test, q × p by rows; empty where nothing is measured exactly.
fn exact(reductions: &Reductions, number: usize) -> &[f64] {
    reductions.exact(number).map_or(&[], |exact| &exact.coefficients)
}

fn compare(a: &[f64], b: &[f64]) -> Ordering {
    let different = a.iter().zip(b).map(|(x, y)| x.total_cmp(y)).find(|o| o.is_ne());
    different.unwrap_or_else(|| a.len().cmp(&b.len()))
}

fn same_class(reductions: &Reductions, (a, b): (usize, usize), chained: bool) -> bool {
    compare(reductions.factor(a), reductions.factor(b)).is_eq()
        && compare(reductions.covariates(a), reductions.covariates(b)).is_eq()
        && compare(exact(reductions, a), exact(reductions, b)).is_eq()
        && (!chained || compare_chains(reductions.chain(a), reductions.chain(b)).is_eq())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ordinals_go_with_the_total_order_of_numbers() {
        let numbers =
            [f64::NEG_INFINITY, -1e300, -1.5, -5e-324, -0.0, 0.0, 5e-324, 1.5, 1e300, f64::INFINITY, f64::NAN];
        for pair in numbers.windows(2) {
            assert!(pair[0].total_cmp(&pair[1]).is_lt(), "{pair:?}");
            assert!(ordinal(pair[0]) < ordinal(pair[1]), "{pair:?}: {} {}", ordinal(pair[0]), ordinal(pair[1]));
        }
    }
}
