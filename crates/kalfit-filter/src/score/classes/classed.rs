//! The classes of tests that are scored together, found once for all values of α.

use crate::reduce::{PhaseReplicates, PhasedReducer, Replicates};
use kalfit_model::PhasedTest;

/// Smallest number of tests of a class: for fewer tests, writing the chain rule as factors does not pay.
const MIN_CLASS_TESTS: usize = 16;
/// Smallest number of rows of a long test; two long tests are enough for a class.
pub(super) const MIN_LONG_ROWS: usize = 1 << 10;
/// Smallest average number of rows per stretch of equal steps in a long test.
const MIN_ROWS_PER_STRETCH: usize = 16;

/// Classes of tests that are replicates in all `phases`; each class has at least [`MIN_CLASS_TESTS`] tests, or long
/// tests.
pub(crate) fn classes_of(reducer: &PhasedReducer, tests: &[PhasedTest], phases: &[PhaseReplicates]) -> Replicates {
    let is_enough = |class: &[usize]| class.len() >= MIN_CLASS_TESTS || is_long(reducer, &tests[class[0]]);
    PhaseReplicates::in_all(phases, tests).retain(is_enough)
}

/// Whether a test has many rows in long stretches of equal steps, which a pass with other data covers quickly.
fn is_long(reducer: &PhasedReducer, test: &PhasedTest) -> bool {
    let phases = (0..reducer.phases().len()).filter_map(|at| Some((at, reducer.rows_of(at, test)?)));
    phases.clone().map(|(_, rows)| rows.rows()).sum::<usize>() >= MIN_LONG_ROWS
        && phases.into_iter().all(|(at, rows)| {
            let stretches = reducer.phases()[at].reducer.preparer().stretches(rows);
            stretches.is_some_and(|stretches| MIN_ROWS_PER_STRETCH * stretches <= rows.rows())
        })
}
