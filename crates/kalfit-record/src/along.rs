//! Estimates at the steps of tests, as numbers for charts; not part of fit.json.

use crate::CurveRecord;

/// Estimates at the steps of the tests of a fit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AlongRecord {
    /// Unit label of the model's time.
    pub time_unit: Option<String>,
    /// Allan deviations of the records of all tests, one entry for each measurement of each phase.
    pub allan: Vec<CurveRecord>,
    /// Notes on the Allan deviations, in plain words.
    pub allan_notes: Vec<String>,
    /// Results of some tests, the least probable first.
    pub tests: Vec<TestAlong>,
    /// Number of all tests of the fit.
    pub of: usize,
    /// Notes on what is not shown, and why, in plain words.
    pub notes: Vec<String>,
}

/// Results of one test at the steps of the records.
#[derive(Debug, Clone, PartialEq)]
pub struct TestAlong {
    /// Id of the test.
    pub id: String,
    /// Phases of the test.
    pub phases: Vec<PhaseAlong>,
}

/// Results of one phase of a test at the included steps.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseAlong {
    /// Name of the phase.
    pub name: String,
    /// Number of steps of the phase.
    pub steps: usize,
    /// Times of the steps that are included.
    pub at: Vec<f64>,
    /// States at the included steps, given all measurements.
    pub states: Vec<StateAlong>,
    /// Measured values, by measurement.
    pub measurements: Vec<MeasurementAlong>,
}

/// A smoothed state.
#[derive(Debug, Clone, PartialEq)]
pub struct StateAlong {
    /// Name of the state.
    pub name: String,
    /// Unit label of the state.
    pub unit: Option<String>,
    /// Mean at each included step.
    pub mean: Vec<f64>,
    /// Standard deviation at each included step.
    pub std_dev: Vec<f64>,
}

/// Measured values of one measurement, with the predictions by the filter.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasurementAlong {
    /// Name of the measurement.
    pub name: String,
    /// Number of values in the record.
    pub values: usize,
    /// Times of the values that are included.
    pub at: Vec<f64>,
    /// Measured values at the times `at`.
    pub measured: Vec<f64>,
    /// Predictions of the values `measured`, each from all earlier steps.
    pub predicted: Vec<f64>,
    /// Standard deviations of the predictions, including the noise of the measurement.
    pub std_dev: Vec<f64>,
    /// Number of innovations of the measurement.
    pub innovations: usize,
    /// Times of the innovations that are included.
    pub innovations_at: Vec<f64>,
    /// Included innovations e/√S, N(0, 1) when the model is right.
    pub standardised: Vec<f64>,
    /// (Quantile of N(0, 1) for the rank among all innovations, innovation) of some innovations, sorted; both tails are
    /// complete.
    pub quantiles: Vec<[f64; 2]>,
}
