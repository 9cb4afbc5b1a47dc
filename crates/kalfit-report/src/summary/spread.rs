//! What varies: from test to test in a phase, or from group to group of a level.

use kalfit::record::{CovarianceRecord, LevelRecord, MatrixRecord, PhaseRecord, VectorRecord};

/// Standard deviations and correlations of some states.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spread<'a> {
    pub(crate) states: &'a [String],
    pub(crate) covariance: &'a CovarianceRecord,
    pub(crate) std_dev: &'a VectorRecord,
    pub(crate) correlation: &'a MatrixRecord,
}

impl<'a> From<&'a PhaseRecord> for Spread<'a> {
    fn from(phase: &'a PhaseRecord) -> Spread<'a> {
        let PhaseRecord { states, covariance, std_dev, correlation, .. } = phase;
        Spread { states, covariance, std_dev, correlation }
    }
}

impl<'a> From<&'a LevelRecord> for Spread<'a> {
    fn from(level: &'a LevelRecord) -> Spread<'a> {
        let LevelRecord { states, covariance, std_dev, correlation, .. } = level;
        Spread { states, covariance, std_dev, correlation }
    }
}
