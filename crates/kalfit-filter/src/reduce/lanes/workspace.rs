//! Work space and results of the data pass.

use crate::reduce::data::Outcome;
use crate::reduce::segments::FilteredStretch;

/// Work space and results of a data pass over a block or a single test. All numbers are in lanes.
#[derive(Debug, Default)]
pub struct DataWorkspace {
    /// x̂ of the last step of each test.
    pub x: Vec<f64>,
    /// The innovations, in order.
    pub e: Vec<f64>,
    /// The stretches that are cut into segments, after the data pass with ξ = 0.
    pub(super) stretches: Vec<FilteredStretch>,
    /// y, then d.
    pub(super) d: Vec<f64>,
    /// The best ξ.
    pub(super) best: Vec<f64>,
    /// d, refined by way of the best ξ.
    pub(super) refined: Vec<f64>,
    /// Residual sum of squares of each test.
    pub(super) residual: Vec<f64>,
    /// True for each test whose d is in `refined`.
    pub(super) is_refined: Vec<bool>,
}

impl DataWorkspace {
    /// The outcome of the test in lane `lane` of `lanes`. `log_determinant`: Σ log S over `active` measurements.
    pub(crate) fn outcome(&self, (lane, lanes): (usize, usize), active: usize, log_determinant: f64) -> Outcome {
        let data = if self.is_refined[lane] { &self.refined } else { &self.d };
        Outcome::new(
            data.iter().skip(lane).step_by(lanes).copied().collect(),
            self.residual[lane],
            active,
            log_determinant,
        )
    }
}
