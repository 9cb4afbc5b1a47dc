//! Results of inference on the free values of α.

/// Lower and upper end; an end is `None` where no limit was found.
pub type Interval = Option<[Option<f64>; 2]>;

/// Standard error, interval and standing of one free value of α.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterInference {
    /// Standard error; `None` at a bound, and where the data do not determine the value.
    pub std_error: Option<f64>,
    /// 95 % interval.
    pub interval: Interval,
    /// Standing of the value: inside the bounds, at a bound, or not determined.
    pub standing: Standing,
}

/// Standing of a free value of α: inside the bounds, at a bound, or not determined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// Inside its bounds.
    Inside,
    /// At its lower bound, or at zero.
    Lower,
    /// A noise level a little above zero: ℓ is highest towards zero, where a measurement would be exact and ℓ is not
    /// defined.
    Vanishing,
    /// At its upper bound.
    Upper,
    /// A covariance of two noises that is as large as their variances allow.
    Edge,
    /// ℓ still rises, ever more slowly, towards infinity: a time constant far longer than the records.
    Unbounded,
    /// ℓ does not depend on the value while some noise level is zero: a time constant or a correlation of that noise.
    Idle,
    /// ℓ does not depend on the value, or does not once other values adapt.
    Unidentified,
}
