//! What the report of a fit shows along the records of its tests, where these are at hand.

use kalfit::along::along;
use kalfit::record::AlongRecord;
use kalfit::{Alpha, FitRecord, PhasedModel, PhasedTest};

use crate::work::JobWork;

/// What a fit leaves of its data.
pub(crate) enum HeldTests {
    /// All tests, and α of the fit.
    Tests(Vec<PhasedTest>, Alpha),
    /// They were too large to be kept.
    TooLarge,
    /// They were never known by rows.
    Nothing,
}

impl HeldTests {
    /// Tests that were kept, if they were.
    pub(crate) fn kept(tests: Option<Vec<PhasedTest>>, alpha: Alpha) -> HeldTests {
        tests.map_or(HeldTests::TooLarge, |tests| HeldTests::Tests(tests, alpha))
    }

    /// What is known along the records; `None` where there are none over time.
    pub(crate) fn along(self, model: &PhasedModel, fit: &FitRecord, work: &mut JobWork<'_>) -> Option<AlongRecord> {
        model.shared().clock.time?;
        let (tests, alpha) = match self {
            HeldTests::Tests(tests, alpha) => (tests, alpha),
            HeldTests::TooLarge => return Some(said("the data are larger than what is kept in memory; `kalfit apply --states` writes the states along them to a file, and `kalfit datasheet` shows their Allan deviations".to_owned(), fit)),
            HeldTests::Nothing => return None,
        };
        if work.is_stopped() {
            return Some(said("the fit was interrupted".to_owned(), fit));
        }
        match fit.population(model) {
            Ok(population) => Some(along((model, &alpha, &population), &tests, fit, &mut |done| {
                work.say(|| format!("records for the report: {done} tests"));
                !work.is_stopped()
            })),
            Err(error) => Some(said(error.to_string(), fit)),
        }
    }
}

/// Nothing, and why.
fn said(why: String, fit: &FitRecord) -> AlongRecord {
    let notes = vec![format!("records over time are not shown: {why}")];
    AlongRecord { of: fit.data.tests, notes, ..AlongRecord::default() }
}
