//! What is known along the records of tests, as numbers for charts. It is no part of fit.json.

use crate::CurveRecord;

/// What is known along the records of the tests of a fit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AlongRecord {
    /// Unit label of the model's time.
    pub time_unit: Option<String>,
    /// Allan deviations of the records of all tests, one entry for each measurement of each phase.
    pub allan: Vec<CurveRecord>,
    /// What should be known of these, in plain words.
    pub allan_notes: Vec<String>,
    /// Some tests one by one, the least probable first.
    pub tests: Vec<TestAlong>,
    /// Number of all tests.
    pub of: usize,
    /// What is not shown, and why, in plain words.
    pub notes: Vec<String>,
}

/// One test along its records.
#[derive(Debug, Clone, PartialEq)]
pub struct TestAlong {
    /// Its id.
    pub id: String,
    /// The phases that it has.
    pub phases: Vec<PhaseAlong>,
}

/// One phase of a test along its record.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseAlong {
    /// Name of the phase.
    pub name: String,
    /// Number of its steps.
    pub steps: usize,
    /// Times of the steps that were kept.
    pub at: Vec<f64>,
    /// The states at these steps, given all that was measured.
    pub states: Vec<StateAlong>,
    /// What was measured.
    pub measurements: Vec<MeasurementAlong>,
}

/// A smoothed state.
#[derive(Debug, Clone, PartialEq)]
pub struct StateAlong {
    /// Its name.
    pub name: String,
    /// Its unit label.
    pub unit: Option<String>,
    /// Its mean at each step that was kept.
    pub mean: Vec<f64>,
    /// Its standard deviation there.
    pub std_dev: Vec<f64>,
}

/// What was measured, and what the filter had foreseen.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasurementAlong {
    /// Name of the measurement.
    pub name: String,
    /// Number of values in the record.
    pub values: usize,
    /// Times of the values that were kept.
    pub at: Vec<f64>,
    /// These values.
    pub measured: Vec<f64>,
    /// What was foreseen from all steps before.
    pub predicted: Vec<f64>,
    /// Its standard deviation, the noise of the measurement among it.
    pub std_dev: Vec<f64>,
    /// Number of its innovations.
    pub innovations: usize,
    /// Times of those that were kept.
    pub innovations_at: Vec<f64>,
    /// Innovations e/√S, N(0, 1) when the model is right.
    pub standardised: Vec<f64>,
    /// Innovations in order, each beside the quantile of N(0, 1) that belongs to its place among all: some of them, both ends whole.
    pub quantiles: Vec<[f64; 2]>,
}
