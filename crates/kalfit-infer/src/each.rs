//! Posteriors and deletions of single tests, with or without groups.

use crate::deletion;
use crate::deletion::Deletion;
use crate::levels;
use crate::levels::GroupPosterior;
use crate::posterior;
use crate::posteriors::Posteriors;
use crate::progress::SharedProgress;
use kalfit_estimate::{Estimate, Point, Problem, Silent};
use kalfit_filter::reduce::Reductions;

/// Posteriors of all tests, in the order of the reductions.
pub fn posteriors(estimate: &Estimate, reductions: &Reductions) -> Posteriors {
    estimated(estimate, reductions).0
}

/// Posteriors of the tests, and of the groups of each level from the innermost on, at an estimate.
pub(super) fn estimated(estimate: &Estimate, reductions: &Reductions) -> (Posteriors, Vec<Vec<GroupPosterior>>) {
    let (problem, point) = (&estimate.state.problem, &estimate.state.newton_iterate.point);
    match estimate.grouping() {
        Some(_) => posteriors_at(problem, point, &estimate.state.evidence(reductions)),
        None => posteriors_at(problem, point, reductions),
    }
}

/// Posteriors of all tests, in the order of the reductions, and of the groups of each level from the innermost on, at
/// any point. For tests in groups, the reductions are in the per-test effect and the effects of the test's groups.
pub fn posteriors_at(
    problem: &Problem,
    point: &Point,
    reductions: &Reductions,
) -> (Posteriors, Vec<Vec<GroupPosterior>>) {
    levels::posteriors(problem, point, reductions)
        .unwrap_or_else(|| (posterior::ungrouped(problem, point, reductions), Vec::new()))
}

/// The fit without each test, in the order of the reductions. An entry is `None` where the other tests have no
/// certified optimum, and for the only test.
pub fn deletions(estimate: &Estimate, reductions: &Reductions) -> Vec<Option<Deletion>> {
    deletions_while(estimate, reductions, &SharedProgress::new(&mut Silent, None)).unwrap_or_default()
}

/// The fit without each test as from [`deletions`]; `None` once `progress` stops.
pub fn deletions_while(
    estimate: &Estimate,
    reductions: &Reductions,
    progress: &SharedProgress<'_>,
) -> Option<Vec<Option<Deletion>>> {
    let evidence = estimate.state.evidence(reductions);
    match estimate.grouping() {
        Some(_) => levels::deletions(estimate, &evidence, progress).map(|found| found.0),
        None => deletion::ungrouped(estimate, &evidence, progress),
    }
}
