//! A change of what was measured in a test.

use kalfit_model::{Evidence, PhasedTest};

/// Other values of one measurement of a phase.
pub struct Change<'a> {
    /// Index of the phase.
    pub phase: usize,
    /// Index of the measurement in the phase's model.
    pub measurement: usize,
    /// The value from (row of the phase, measured value).
    pub value: Box<dyn Fn(usize, f64) -> f64 + Sync + 'a>,
}

impl Change<'_> {
    /// A copy of a test with this change. `column`: the column of the measurement.
    pub(super) fn copy(&self, test: &PhasedTest, column: usize) -> PhasedTest {
        let mut copy = test.clone();
        if let Some(Evidence::Rows(rows)) = copy.phases.get_mut(self.phase) {
            for row in 0..rows.rows() {
                let measured = rows.numbers(row)[column];
                let value = (self.value)(row, measured);
                if value.to_bits() != measured.to_bits() {
                    rows.set_number(row, column, value);
                }
            }
        }
        copy
    }
}
