//! Uncertainty where α is free: standard errors, intervals and likelihood-ratio tests of a fit whose α was sought.

mod at_start;
mod branches;
mod expected;
mod held_profile;
mod inference;
mod interval;
mod law;
mod mean_limits;
mod mixed;
mod profile;
mod ratio;
mod sandwich;
mod stepwise;
#[cfg(test)]
mod tests;
mod units;

pub use at_start::examine_with_parameters;
pub use inference::{accepts_intervals, infer};
pub use interval::MOST_PROFILED;
pub use mean_limits::{MeansAt, mean_limits};
pub use ratio::{DynamicRatioError, dynamic_bootstrap, dynamic_bootstrap_while, dynamic_ratio, started};
pub use units::{UnitError, UnitInformation, unit_information};
