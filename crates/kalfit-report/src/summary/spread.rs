//! What varies: from test to test in a phase, or from group to group of a level.

use kalfit::record::{CovarianceRecord, LevelRecord, MatrixRecord, PhaseRecord, VectorRecord};

/// Standard deviations and correlations of some states.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StateSpread<'a> {
    pub(crate) states: &'a [String],
    pub(crate) covariance: &'a CovarianceRecord,
    pub(crate) std_dev: &'a VectorRecord,
    pub(crate) correlation: &'a MatrixRecord,
}

impl<'a> From<&'a PhaseRecord> for StateSpread<'a> {
    fn from(phase: &'a PhaseRecord) -> StateSpread<'a> {
        let PhaseRecord { states, covariance, std_dev, correlation, .. } = phase;
        StateSpread { states, covariance, std_dev, correlation }
    }
}

impl<'a> From<&'a LevelRecord> for StateSpread<'a> {
    fn from(level: &'a LevelRecord) -> StateSpread<'a> {
        let LevelRecord { states, covariance, std_dev, correlation, .. } = level;
        StateSpread { states, covariance, std_dev, correlation }
    }
}
