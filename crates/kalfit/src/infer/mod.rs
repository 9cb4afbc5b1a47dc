//! How far each number can be trusted: standard errors, sensitivities, identifiability, and what each test says.

mod constraint;
mod identifiability;
mod information;
mod observability;
mod posterior;
mod reason;

pub use constraint::{Element, Sensitivity, sensitivities};
pub use identifiability::{
    Direction, Examination, Quantity, examine_at_start, identifiability, identifiability_at_start,
};
pub use information::{Boundary, Uncertainty, uncertainty};
pub use observability::{Leading, MOST_TESTS, Observability, Shortage, StateObservability, WEAK, WeakDirection};
pub use posterior::{Posterior, posteriors};
pub use reason::{Explanation, Reason};

use crate::estimate::Estimate;
use crate::reduce::Reduction;

/// All that is inferred from an estimate.
#[derive(Debug, Clone)]
pub struct Inference {
    /// Standard errors and the boundary.
    pub uncertainty: Uncertainty,
    /// Directions the data say nothing about.
    pub unidentified: Vec<Direction>,
    /// Why, for each of them.
    pub explanations: Vec<Explanation>,
    /// Which tests say what of each state.
    pub observability: Observability,
    /// What each constraint costs.
    pub sensitivities: Vec<Sensitivity>,
    /// What each test says, in the order of the reductions.
    pub posteriors: Vec<Posterior>,
}

/// Infers all of it.
pub fn infer(estimate: &Estimate, reductions: &[Reduction]) -> Inference {
    let Examination { unidentified, explanations, observability } = identifiability::examine(estimate, reductions);
    Inference {
        uncertainty: uncertainty(estimate, &unidentified),
        sensitivities: sensitivities(estimate),
        posteriors: posteriors(estimate, reductions),
        unidentified,
        explanations,
        observability,
    }
}
