//! Information in α alone, once (μ, Σ) follow it.

use nalgebra::DMatrix;

use crate::dynamic::joint::Joint;

/// Information in some values once (μ, Σ) follow them.
#[derive(Debug, Clone)]
pub(crate) struct Curvature {
    pub(super) slots: Vec<usize>,
    pub(super) information: DMatrix<f64>,
}

impl Curvature {
    /// `None` where values of single tests stand between.
    pub(crate) fn of(joint: &Joint) -> Option<Curvature> {
        Some(Curvature { slots: joint.shared().to_vec(), information: joint.followed()? })
    }

    /// What so many times the data would say.
    pub(crate) fn times(self, factor: f64) -> Curvature {
        Curvature { information: self.information * factor, ..self }
    }
}
