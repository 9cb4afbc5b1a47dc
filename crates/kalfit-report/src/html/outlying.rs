//! Which tests stand out from the others.

use kalfit::FitRecord;
use kalfit::record::TestRecord;

/// Tests that are listed and drawn one by one; of more, these are the ones that stand out most.
pub(super) const MOST_TESTS: usize = 200;
/// Level of the search over all tests.
pub(super) const LEVEL: f64 = 0.05;

/// Numbers of the tests, the most outlying first; those without a p-value last.
pub(super) fn outlying(record: &FitRecord) -> Vec<usize> {
    let key = |number: &usize| {
        let test = record.tests.get(*number);
        (test.p_value.filter(|p| p.is_finite()).unwrap_or(2.0), test.id)
    };
    let mut numbers: Vec<usize> = (0..record.tests.len()).collect();
    numbers.sort_by(|a, b| {
        let ((p, id), (q, other)) = (key(a), key(b));
        p.total_cmp(&q).then_with(|| id.cmp(other))
    });
    numbers
}

/// Even though the search went over so many tests.
pub(crate) fn stands_out(test: TestRecord<'_>, all: usize) -> bool {
    test.p_value.is_some_and(|p| p * (all as f64) < LEVEL)
}
