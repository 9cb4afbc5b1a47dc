//! Innovations of one test in order, as a record.

use serde::{Deserialize, Serialize};

/// Innovations of one test in order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeriesRecord {
    /// Names of the measurements that occur; `phase: name` where there are several phases.
    pub measurements: Vec<String>,
    /// Time of each innovation, or the number of its step where the model has no times; empty when there are too many.
    pub at: Vec<f64>,
    /// Index in `measurements` of each innovation.
    pub measurement: Vec<usize>,
    /// e/√S of each innovation, to four decimals.
    pub standardised: Vec<f64>,
    /// `at` is time, in the model's unit.
    pub timed: bool,
    /// Unit of time, where the model gives it.
    #[serde(default)]
    pub time_unit: Option<String>,
    /// Sums over windows of about equal numbers of innovations.
    pub windows: Vec<WindowRecord>,
    /// Autocorrelation from lag 1 on, by measurement.
    pub autocorrelation: Vec<AutocorrelationRecord>,
}

/// Innovations that follow each other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WindowRecord {
    /// Time or step of the first.
    pub from: f64,
    /// Time or step of the last.
    pub to: f64,
    /// Number of innovations.
    pub count: usize,
    /// Σ e²/S, χ² with as many degrees of freedom when the model is right.
    pub nis: f64,
}

/// Autocorrelation of e/√S about zero.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AutocorrelationRecord {
    /// The measurement; null for all together.
    pub measurement: Option<String>,
    /// Number of innovations.
    pub count: usize,
    /// r_1, r_2, …
    pub lags: Vec<f64>,
}
