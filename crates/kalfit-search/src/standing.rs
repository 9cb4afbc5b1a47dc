//! What is known of one free value of α.

/// Lower and upper end; an end is `None` where no limit was found.
pub type Interval = Option<[Option<f64>; 2]>;

/// What is known of one free value of α.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterInference {
    /// Standard error; `None` at a bound, and where the data do not determine the value.
    pub std_error: Option<f64>,
    /// 95 % interval.
    pub interval: Interval,
    /// Where the value lies.
    pub standing: Standing,
}

/// Where a free value of α lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// Inside its bounds.
    Inside,
    /// At its lower bound, or at zero.
    Lower,
    /// A noise level that ℓ would have at zero, where a measurement would be exact: kept a little above it.
    Vanishing,
    /// At its upper bound.
    Upper,
    /// A covariance of two noises that is as large as their variances allow.
    Edge,
    /// ℓ still rises, ever more slowly, towards infinity: a time constant far longer than the records.
    Unbounded,
    /// ℓ does not depend on the value while some noise level is zero: its time constant, its correlation.
    Idle,
    /// ℓ does not depend on the value, or no longer once others follow it.
    Unidentified,
}
