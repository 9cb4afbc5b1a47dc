//! One innovation of a filter.

/// One scalar innovation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation {
    /// Index of the phase.
    pub phase: usize,
    /// Number of the step in the phase, from 0.
    pub step: usize,
    /// Time of the step, where the model has times; in the model's time unit.
    pub time: Option<f64>,
    /// Index of the measurement in the phase's model. Where noises are correlated, the innovation of a later
    /// measurement of a step excludes the part of the noise that earlier measurements of the step
    /// predict.
    pub measurement: usize,
    /// e, in the measurement's unit.
    pub value: f64,
    /// S, the variance of e.
    pub variance: f64,
    /// e/√S, which is N(0, 1) when the model is right.
    pub standardised: f64,
}
