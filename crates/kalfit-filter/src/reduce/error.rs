//! Errors of tests that cannot be reduced.

use std::fmt;

use crate::reduce::semidefinite::NotSemidefinite;
use kalfit_model::{Label, Source};

/// The error of a test without a reduction: the test, the row, what was being computed, and the kind of fault.
#[derive(Debug, Clone, PartialEq)]
pub struct ReduceError {
    /// Id of the test; `None` when the model at α is at fault, whatever the test.
    pub test: Option<String>,
    /// The row at fault, if there is one.
    pub row: Option<Source>,
    /// What was being computed, in words: "noise variance of measurement `gyro`".
    pub what: String,
    /// The kind of fault.
    pub kind: Box<ReduceErrorKind>,
}

/// A cell of the data, as printed in a message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cell {
    /// A cell of a numeric column.
    Number(f64),
    /// A cell of a text column.
    Text(Label),
}

impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Cell::Number(x) => write!(f, "{x}"),
            Cell::Text(label) => write!(f, "text {}", label.index()),
        }
    }
}

/// The kind of fault.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReduceErrorKind {
    /// An empty cell is needed.
    #[error("the cell of column `{column}` is empty, and it is needed")]
    MissingCell {
        /// Name of the column.
        column: String,
    },
    /// A parameter has no value at the level of the row.
    #[error("parameter `{parameter}` has no value for the level of this row")]
    NoLevel {
        /// Name of the parameter.
        parameter: String,
        /// The level of the row.
        level: Label,
    },
    /// A coefficient is infinite or undefined.
    #[error("the value is not a finite number")]
    NotFinite,
    /// A cell is infinite.
    #[error("the cell of column `{column}` is {value}, expected a finite number")]
    InfiniteCell {
        /// Name of the column.
        column: String,
        /// The value of the cell.
        value: f64,
    },
    /// A variance is below zero.
    #[error("found a variance of {value}, expected 0 or more")]
    NegativeVariance {
        /// The value of the variance.
        value: f64,
    },
    /// A covariance matrix is not positive semidefinite.
    #[error(
        "the covariance matrix is not positive semidefinite: {left:.3e} of variance {variance:.3e} is left after regression on the others"
    )]
    NotSemidefinite {
        /// The conditional variance given the other variables, or minus a covariance with a variable whose conditional
        /// variance is zero.
        left: f64,
        /// The unconditional variance.
        variance: f64,
    },
    /// A matrix is not symmetric.
    #[error("the matrix is not symmetric: {upper} above the diagonal, {lower} below")]
    NotSymmetric {
        /// The entry above the diagonal.
        upper: f64,
        /// The mirrored entry below the diagonal.
        lower: f64,
    },
    /// A covariance is given between a variable and itself.
    #[error("found a covariance of `{name}` with itself, expected two different names")]
    SelfCovariance {
        /// Name of the variable.
        name: String,
    },
    /// A covariance is given between noises of continuous and discrete motion.
    #[error("`{continuous}` moves in continuous time and `{discrete}` does not: their noises cannot be correlated")]
    MixedCovariance {
        /// Name of the state of continuous motion.
        continuous: String,
        /// Name of the state of discrete motion.
        discrete: String,
    },
    /// Which instances of two correlated measurements belong together is ambiguous.
    #[error("`{first}` and `{second}` are measured several times in different rows of one step")]
    AmbiguousCovariance {
        /// Name of the first measurement.
        first: String,
        /// Name of the second measurement.
        second: String,
    },
    /// The time of x_0 is later than the time of the first row.
    #[error("the initial time {initial} is later than the first row's time {first}")]
    InitialTimeAfterStart {
        /// Time of x_0.
        initial: f64,
        /// Time of the first row.
        first: f64,
    },
    /// `initial_time` is given without `time`.
    #[error("an initial time is given, but the rows have no times")]
    InitialTimeWithoutTime,
    /// The length of the step before the first row is needed but unknown.
    #[error("the time from x_0 to the first row is not known")]
    UnknownFirstStep,
    /// Times decrease.
    #[error("time {time} follows time {previous}")]
    TimeBackwards {
        /// Time of the previous row.
        previous: f64,
        /// Time of the row.
        time: f64,
    },
    /// Times are so large that the rounding of times hides the lengths of the steps.
    #[error(
        "times as large as {time} are known to {grid:.3e}, which is no small part of a step ({step:.3e} on average)"
    )]
    TimesTooLarge {
        /// The last time.
        time: f64,
        /// Distance between adjacent floating-point numbers of that size.
        grid: f64,
        /// Mean length of a step.
        step: f64,
    },
    /// A column that must be constant within a test varies within the test.
    #[error("column `{column}` varies within the test: {first} and {second}")]
    Varies {
        /// Name of the column.
        column: String,
        /// A cell.
        first: Cell,
        /// A later cell.
        second: Cell,
    },
    /// Rows of one step disagree in a column that the transition of the step uses.
    #[error("rows of one step disagree in column `{column}`: {first} and {second}")]
    StepConflict {
        /// Name of the column.
        column: String,
        /// A cell.
        first: Cell,
        /// A later cell.
        second: Cell,
    },
    /// The motion has no stationary distribution.
    #[error("the motion has no stationary distribution: it is not stable ({})", states.join(", "))]
    Unstable {
        /// Names of the unstable states.
        states: Vec<String>,
    },
    /// A stationary state depends on a state that is not stationary.
    #[error("`{state}` starts in its stationary distribution but depends on `{other}`, which does not")]
    StationaryOpen {
        /// The stationary state.
        state: String,
        /// Name of the state on which the stationary state depends.
        other: String,
    },
    /// Continuous and discrete stationary states depend on each other.
    #[error(
        "`{state}` and `{other}` have no stationary distribution together: one moves in continuous time, the other from step to step"
    )]
    StationaryMixed {
        /// One state.
        state: String,
        /// The other state.
        other: String,
    },
    /// A stationary state has an input that depends on the data.
    #[error("`{state}` starts in its stationary distribution, but its input depends on the data")]
    StationaryInput {
        /// The stationary state.
        state: String,
    },
    /// A measurement determines a combination of the estimated states exactly.
    #[error("a combination of estimated states is measured without any noise")]
    ExactMeasurement,
    /// A value measured without noise is impossible.
    #[error("measured without any noise, the value is off by {residual:.3e}, which is impossible")]
    Impossible {
        /// Measured value minus the only possible value.
        residual: f64,
    },
    /// Estimates of a phase are requested, but the phase has no filter.
    #[error("it has no filter, so nothing makes estimates of it")]
    NoFilter,
    /// The filter and the model take different measurements of a test.
    #[error(
        "by its own parameters the filter takes {found} measurements, and other ones than the {expected} of the model"
    )]
    OtherMeasurements {
        /// Number of measurements that the filter takes.
        found: usize,
        /// Number of measurements of the model.
        expected: usize,
    },
    /// Estimates contradict the only possible value in a direction in which estimates are not random.
    #[error("where they are not random, the estimates are off by {residual:.3e}, expected {allowed:.1e} at most")]
    Inconsistent {
        /// Estimate minus the only possible value; a random element is in units of the standard deviation of the
        /// element.
        residual: f64,
        /// Largest residual that rounding explains.
        allowed: f64,
    },
    /// A quantity that is discontinuous in the parameters depends on a free parameter.
    #[error("it depends on the free parameter `{parameter}`, expected parameters that are fixed")]
    FreeParameter {
        /// Name of the parameter.
        parameter: String,
    },
    /// A part of a phase that was reduced or estimated earlier is missing.
    #[error("the {what} is missing, and it is needed")]
    Absent {
        /// Name of the missing part.
        what: &'static str,
    },
    /// The factor of an earlier reduction has a negative diagonal entry.
    #[error("found {value} on the diagonal of the factor, expected 0 or more")]
    NegativeDiagonal {
        /// The diagonal entry.
        value: f64,
    },
    /// The test has more phases than the model.
    #[error("found {found} phases, expected {expected} at most")]
    TooManyPhases {
        /// Number of phases of the test.
        found: usize,
        /// Number of phases of the model.
        expected: usize,
    },
    /// The test has no rows.
    #[error("the test has no rows")]
    NoRows,
    /// A matrix or vector has the wrong shape.
    #[error("found {} x {}, expected {} x {}", found.0, found.1, expected.0, expected.1)]
    Shape {
        /// (rows, columns) of the matrix or vector.
        found: (usize, usize),
        /// (rows, columns) expected.
        expected: (usize, usize),
    },
}

impl From<NotSemidefinite> for ReduceErrorKind {
    fn from(NotSemidefinite { left, variance }: NotSemidefinite) -> ReduceErrorKind {
        ReduceErrorKind::NotSemidefinite { left, variance }
    }
}

/// The error `kind` of a test, or of the model if `test` is `None`.
pub(crate) fn refuse(test: Option<&str>, what: &str, kind: impl Into<ReduceErrorKind>) -> ReduceError {
    ReduceError { test: test.map(str::to_owned), row: None, what: what.to_owned(), kind: Box::new(kind.into()) }
}

/// An error unless the shape of a matrix or vector is as expected.
pub(crate) fn check_shape(found: (usize, usize), expected: (usize, usize)) -> Result<(), ReduceErrorKind> {
    if found == expected { Ok(()) } else { Err(ReduceErrorKind::Shape { found, expected }) }
}

/// An error unless all numbers are finite.
pub(crate) fn finite(numbers: &[f64]) -> Result<(), ReduceErrorKind> {
    if numbers.iter().all(|x| x.is_finite()) { Ok(()) } else { Err(ReduceErrorKind::NotFinite) }
}

impl fmt::Display for ReduceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.test, self.row) {
            (Some(test), Some(row)) => write!(f, "test `{test}`, row {}: ", row.row)?,
            (Some(test), None) => write!(f, "test `{test}`: ")?,
            _ => {}
        }
        write!(f, "{}: {}", self.what, self.kind)
    }
}

impl std::error::Error for ReduceError {}

impl ReduceError {
    /// Advice on how to correct the error, for errors with a typical cause.
    pub fn hint(&self) -> Option<&'static str> {
        Some(match &*self.kind {
            ReduceErrorKind::MissingCell { .. } => "fill the cell, or leave the measured value empty too",
            ReduceErrorKind::NoLevel { .. } => "give the parameter a value for this level, or let it be estimated",
            ReduceErrorKind::NegativeVariance { .. } => {
                "a `noise` is a standard deviation; `variance` must be 0 or more"
            }
            ReduceErrorKind::NotSemidefinite { .. } => "make the covariances smaller or the variances larger",
            ReduceErrorKind::AmbiguousCovariance { .. } => "put correlated measurements in the same row",
            ReduceErrorKind::InitialTimeAfterStart { .. } => "`initial_time` must not be later than the first row",
            ReduceErrorKind::InitialTimeWithoutTime => "give `time` in [data], or leave out `initial_time`",
            ReduceErrorKind::UnknownFirstStep => "give `initial_time` in [data]",
            ReduceErrorKind::TimeBackwards { .. } => "sort the rows of each test by time",
            ReduceErrorKind::TimesTooLarge { .. } => {
                "count times from the start of each test: subtract its first time before the data are written"
            }
            ReduceErrorKind::Varies { .. } => "such a column must have one value per test",
            ReduceErrorKind::StepConflict { .. } => {
                "rows of equal time are one step: give the value in one of them, or the same value in each"
            }
            ReduceErrorKind::Unstable { .. }
            | ReduceErrorKind::StationaryOpen { .. }
            | ReduceErrorKind::StationaryMixed { .. }
            | ReduceErrorKind::StationaryInput { .. } => {
                "give `initial = { mean, sigma }` or `initial = \"estimated\"`"
            }
            ReduceErrorKind::FreeParameter { .. } => {
                "give the parameter a value: which rows count, and when x_0 is, cannot be estimated"
            }
            ReduceErrorKind::ExactMeasurement => "give the measurement some noise",
            ReduceErrorKind::Impossible { .. } => {
                "give the measurement or the process some noise, or correct the value"
            }
            _ => return None,
        })
    }
}
