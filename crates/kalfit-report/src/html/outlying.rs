//! Which tests stand out from the others.

use kalfit::FitRecord;
use kalfit::record::TestRecord;

/// Tests that are listed and drawn one by one; of more, these are the ones that stand out most.
pub(super) const MOST_TESTS: usize = 200;
/// Level of the search over all tests.
pub(super) const LEVEL: f64 = 0.05;

/// Tests, the most outlying first; those without a p-value last.
pub(super) fn outlying(record: &FitRecord) -> Vec<&TestRecord> {
    let key = |test: &TestRecord| test.p_value.filter(|p| p.is_finite()).unwrap_or(2.0);
    let mut tests: Vec<&TestRecord> = record.tests.iter().collect();
    tests.sort_by(|a, b| key(a).total_cmp(&key(b)).then_with(|| a.id.cmp(&b.id)));
    tests
}

/// Even though the search went over so many tests.
pub(crate) fn stands_out(test: &TestRecord, all: usize) -> bool {
    test.p_value.is_some_and(|p| p * (all as f64) < LEVEL)
}
