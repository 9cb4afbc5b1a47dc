//! The certificate (15.4): no plan can be better than so much.

use super::problem::{Kinds, PlanValue};

/// Kinds by gain per cost, for the largest of Σ n_k ψ_k over all plans within a budget.
pub(super) struct ByGain {
    /// (Gain per cost, largest cost) of each kind with a gain, the largest gain per cost first.
    order: Vec<(f64, f64)>,
    /// (Cost, gain) of all kinds before each, in the largest numbers.
    before: Vec<(f64, f64)>,
}

impl ByGain {
    pub(super) fn new(kinds: &Kinds, gains: &[f64]) -> ByGain {
        let with_gain = (0..kinds.len()).filter(|&k| gains[k] > 0.0);
        let mut order: Vec<(f64, f64)> =
            with_gain.map(|k| (gains[k] / kinds.costs[k], kinds.most[k] * kinds.costs[k])).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut sum = (0.0, 0.0);
        let before = order.iter().map(|&(gain, cost)| {
            let before = sum;
            sum = (sum.0 + cost, sum.1 + cost * gain);
            before
        });
        let before = before.collect();
        ByGain { order, before }
    }

    /// The largest of Σ n_k ψ_k: the budget is filled by gain per cost.
    pub(super) fn largest(&self, budget: f64) -> f64 {
        let full = self.before.partition_point(|before| before.0 <= budget);
        let Some(last) = full.checked_sub(1) else { return 0.0 };
        let ((gain, cost), (spent, gained)) = (self.order[last], self.before[last]);
        gained + gain * cost.min(budget - spent)
    }
}

/// U - 1 at a point: every plan has a log φ of at most log φ + log U, and with several scenarios of log φ + U - 1.
pub(super) fn gap(kinds: &Kinds, at: &PlanValue) -> f64 {
    at.of_base + ByGain::new(kinds, &at.gains).largest(kinds.budget) - 1.0
}

/// The bound on log φ of plans with ratios of φ of at most 1 + `gap`; see [`gap`].
pub(super) fn bound(log_phi: f64, gap: f64, scenarios: usize) -> f64 {
    log_phi + if scenarios == 1 { gap.ln_1p() } else { gap }
}
