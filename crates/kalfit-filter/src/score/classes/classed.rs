//! The classes of tests that are scored together, found once for all values of α.

use crate::reduce::{PhaseReplicates, PhasedReducer, Replicates};
use kalfit_model::PhasedTest;

/// Fewer tests than these are not worth the chain rule put down as factors,
const FEWEST: usize = 16;
/// but two are where they have so many rows, in so many times fewer runs of equal steps.
pub(super) const LONG: usize = 1 << 10;
const EQUAL: usize = 16;

/// Tests that are replicates in all of these phases, where they are enough.
pub(crate) fn classes_of(reducer: &PhasedReducer, tests: &[PhasedTest], phases: &[PhaseReplicates]) -> Replicates {
    let is_enough = |class: &[usize]| class.len() >= FEWEST || is_long(reducer, &tests[class[0]]);
    PhaseReplicates::in_all(phases, tests).retain(is_enough)
}

/// Whether most of a test are long stretches of equal steps, which other data pass over quickly.
fn is_long(reducer: &PhasedReducer, test: &PhasedTest) -> bool {
    let phases = (0..reducer.phases().len()).filter_map(|at| Some((at, reducer.rows_of(at, test)?)));
    phases.clone().map(|(_, rows)| rows.rows()).sum::<usize>() >= LONG
        && phases.into_iter().all(|(at, rows)| {
            let stretches = reducer.phases()[at].reducer.preparer().stretches(rows);
            stretches.is_some_and(|stretches| EQUAL * stretches <= rows.rows())
        })
}
