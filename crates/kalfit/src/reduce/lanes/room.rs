//! The work space of a pass over a block.

/// Work space of a pass over a block, and what it finds. All in lanes.
#[derive(Debug, Clone, Default)]
pub(crate) struct Room {
    /// x̂ of the last step of each test.
    pub(super) last: Vec<f64>,
    /// The innovations, in order.
    pub(super) e: Vec<f64>,
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
