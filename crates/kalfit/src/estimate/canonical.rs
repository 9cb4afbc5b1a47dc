//! An order of tests that does not see theirs, and which tests are one class.

use std::cmp::Ordering;
use std::ops::Range;

use rayon::prelude::*;

use crate::reduce::{Chain, ChainPhase, ReductionRef, Reductions};

/// The reductions by the first and the last number of R, then in [`canonical`] order.
pub(super) fn ordered(reductions: &Reductions) -> Vec<usize> {
    // most are told apart by these numbers, which are looked at without a visit to each reduction
    let ends = |reduction: ReductionRef<'_>| {
        let factor = &reduction.factor;
        (factor.first().map_or(0, |x| ordinal(*x)), factor.last().map_or(0, |x| ordinal(*x)))
    };
    let mut order: Vec<_> = reductions.par_iter().map(ends).enumerate().map(|(j, ends)| (ends, j)).collect();
    order.par_sort_unstable_by(|a, b| {
        a.0.cmp(&b.0).then_with(|| canonical(reductions.get(a.1), reductions.get(b.1))).then_with(|| a.1.cmp(&b.1))
    });
    order.into_iter().map(|(_, j)| j).collect()
}

/// A whole number that goes with [`f64::total_cmp`].
fn ordinal(x: f64) -> i64 {
    let bits = x.to_bits() as i64;
    bits ^ (((bits >> 63) as u64) >> 1) as i64
}

/// Order by R, covariates, then id: a total order that gathers classes and does not see the order of the tests.
fn canonical(a: ReductionRef<'_>, b: ReductionRef<'_>) -> Ordering {
    compare(a.factor, b.factor)
        .then_with(|| compare(a.covariates, b.covariates))
        .then_with(|| compare_chains(a.chain, b.chain))
        .then_with(|| a.test.cmp(b.test))
}

/// By all matrices of the phases, and where the links come from.
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

fn compare(a: &[f64], b: &[f64]) -> Ordering {
    let different = a.iter().zip(b).map(|(x, y)| x.total_cmp(y)).find(|o| o.is_ne());
    different.unwrap_or_else(|| a.len().cmp(&b.len()))
}

fn same_class(a: ReductionRef<'_>, b: ReductionRef<'_>, chained: bool) -> bool {
    compare(a.factor, b.factor).is_eq()
        && compare(a.covariates, b.covariates).is_eq()
        && (!chained || compare_chains(a.chain, b.chain).is_eq())
}

/// Where each class begins and ends in the order. `chained`: tests are one class only if they are in every phase.
pub(super) fn spans(reductions: &Reductions, order: &[usize], chained: bool) -> Vec<Range<usize>> {
    let mut starts = vec![0];
    let different = |at: &usize| !same_class(reductions.get(order[at - 1]), reductions.get(order[*at]), chained);
    starts.extend((1..order.len()).filter(different));
    let ends = starts[1..].iter().copied().chain([order.len()]);
    starts.iter().copied().zip(ends).map(|(start, end)| start..end).filter(|span| !span.is_empty()).collect()
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
