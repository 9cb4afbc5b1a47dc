//! Steps of long records, determined once for all values of α, since steps depend on times alone.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::reduce::data_memory::DataMemory;
use crate::reduce::steps::StepSpan;
use kalfit_model::{Test, TestId};

/// Number of rows from which a record counts as long.
pub(crate) const MIN_LONG_ROWS: usize = 1 << 10;
/// Least mean number of rows per span: with fewer rows, the list of spans is nearly as long as the record.
const MIN_ROWS_PER_SPAN: usize = 16;

/// The steps of the long records of one ensemble, whose tests have different ids.
#[derive(Debug, Default)]
pub(crate) struct KnownSteps {
    spans: Mutex<HashMap<TestId, KnownSpans>>,
    /// Memory for the data of these records.
    pub(crate) memory: DataMemory,
}

#[derive(Debug)]
struct KnownSpans {
    rows: usize,
    /// Bits of the time of x_0, from which the first step is counted.
    initial: Option<u64>,
    spans: Arc<Vec<StepSpan>>,
}

impl KnownSteps {
    /// The steps of a test with the time `initial` of x_0; `None` if the steps are not known.
    pub(crate) fn of(&self, test: &Test, initial: Option<f64>) -> Option<Arc<Vec<StepSpan>>> {
        if test.rows() < MIN_LONG_ROWS {
            return None;
        }
        let known_records = self.spans.lock().unwrap_or_else(PoisonError::into_inner);
        let known = known_records.get(&test.id)?;
        (known.rows == test.rows() && known.initial == initial.map(f64::to_bits)).then(|| known.spans.clone())
    }

    /// Stores the steps of a test, if the test is long and has few spans.
    pub(crate) fn keep(&self, test: &Test, initial: Option<f64>, spans: &[StepSpan]) {
        if test.rows() >= MIN_LONG_ROWS && MIN_ROWS_PER_SPAN * spans.len() <= test.rows() {
            let initial = initial.map(f64::to_bits);
            let known = KnownSpans { rows: test.rows(), initial, spans: Arc::new(spans.to_vec()) };
            self.spans.lock().unwrap_or_else(PoisonError::into_inner).insert(test.id.clone(), known);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::Source;

    fn record(rows: usize, dt: f64) -> Test {
        let mut test = Test::new("long", 1, 0);
        (0..rows).for_each(|k| test.push(&[dt * k as f64], &[], Source::default()));
        test
    }

    #[test]
    fn steps_are_those_of_the_same_rows_from_the_same_time() {
        let known = KnownSteps::default();
        let spans = |rows: usize| [StepSpan { rows: 0..rows, count: rows, dt: 0.5, moves: true }];
        let (long, short) = (record(5000, 0.5), record(1000, 0.5));
        known.keep(&long, Some(0.0), &spans(5000));
        assert_eq!(known.of(&long, Some(0.0)).expect("they were kept")[..], spans(5000));
        assert!(known.of(&long, Some(1.0)).is_none() && known.of(&long, None).is_none(), "from another time");
        assert!(known.of(&record(5001, 0.5), Some(0.0)).is_none(), "of another length");
        known.keep(&short, None, &spans(1000));
        assert!(known.of(&short, None).is_none(), "short ones are found as quickly");
        let each: Vec<StepSpan> =
            (0..5000).map(|k| StepSpan { rows: k..k + 1, count: 1, dt: 0.5, moves: true }).collect();
        known.keep(&long, None, &each);
        assert!(known.of(&long, None).is_none(), "as many as there are rows");
        assert!(known.of(&long, Some(0.0)).is_some(), "and those before are still there");
    }
}
