//! Room for the measurements of a step.

use crate::reduce::Unwhitened;

/// Room for measurements whose noises are correlated.
#[derive(Debug, Clone, Default)]
pub(super) struct Measuring {
    pub(super) raw: Vec<f64>,
    pub(super) back: Unwhitened,
    pub(super) diagonal: Vec<f64>,
}
