//! The work space of the data pass, and what it finds.

use crate::reduce::data::Outcome;

/// Work space of a pass over a block or a test by itself, and what it finds. All in lanes.
#[derive(Debug, Clone, Default)]
pub struct DataWorkspace {
    /// x̂ of the last step of each test.
    pub x: Vec<f64>,
    /// The innovations, in order.
    pub e: Vec<f64>,
    /// y, then d.
    pub(super) d: Vec<f64>,
    /// The best ξ.
    pub(super) best: Vec<f64>,
    /// d by way of the best ξ.
    pub(super) refined: Vec<f64>,
    /// Residual sums of squares, and where d was refined.
    pub(super) residual: Vec<f64>,
    pub(super) is_refined: Vec<bool>,
}

impl DataWorkspace {
    /// What was found in one of so many lanes, for `active` measurements with this Σ log S.
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
