//! How far each number can be trusted: standard errors, sensitivities, identifiability, and what each test says.

mod constraint;
mod identifiability;
mod information;
mod posterior;

pub use constraint::{Element, Sensitivity, sensitivities};
pub use identifiability::{Direction, Quantity, identifiability, identifiability_at_start};
pub use information::{Boundary, Uncertainty, uncertainty};
pub use posterior::{Posterior, posteriors};

pub(crate) use constraint::is_held;
pub(crate) use identifiability::directions;
pub(crate) use information::{PART, uncertainty_at};

use crate::estimate::Estimate;
use crate::reduce::Reduction;

/// All that is inferred from an estimate.
#[derive(Debug, Clone)]
pub struct Inference {
    /// Standard errors and the boundary.
    pub uncertainty: Uncertainty,
    /// Directions the data say nothing about.
    pub unidentified: Vec<Direction>,
    /// What each constraint costs.
    pub sensitivities: Vec<Sensitivity>,
    /// What each test says, in the order of the reductions.
    pub posteriors: Vec<Posterior>,
}

/// Infers all of it.
pub fn infer(estimate: &Estimate, reductions: &[Reduction]) -> Inference {
    let unidentified = identifiability(estimate);
    Inference {
        uncertainty: uncertainty(estimate, &unidentified),
        sensitivities: sensitivities(estimate),
        posteriors: posteriors(estimate, reductions),
        unidentified,
    }
}
