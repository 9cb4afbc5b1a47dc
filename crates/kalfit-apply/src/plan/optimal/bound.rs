//! The certificate (15.4): no plan can be better than so much.

use super::problem::{Kinds, PlanValue};

/// The largest of Σ n_k ψ_k over all plans within the budget, and the plan: the budget is filled by gain per cost.
pub(super) fn filled(kinds: &Kinds, gains: &[f64]) -> (f64, Vec<f64>) {
    let mut order: Vec<usize> = (0..kinds.len()).filter(|&k| gains[k] > 0.0).collect();
    let per_cost = |k: usize| gains[k] / kinds.costs[k];
    order.sort_by(|&a, &b| per_cost(b).total_cmp(&per_cost(a)).then(a.cmp(&b)));
    let (mut left, mut sum, mut numbers) = (kinds.budget, 0.0, vec![0.0; kinds.len()]);
    for k in order {
        let n = kinds.most[k].min(left / kinds.costs[k]);
        (numbers[k], sum) = (n, sum + n * gains[k]);
        left -= n * kinds.costs[k];
        if left <= 0.0 {
            break;
        }
    }
    (sum, numbers)
}

/// U - 1 at a point: every plan has a log φ of at most log φ + log U, and with several scenarios of log φ + U - 1.
pub(super) fn gap(kinds: &Kinds, at: &PlanValue) -> f64 {
    at.of_base + filled(kinds, &at.gains).0 - 1.0
}

/// The bound on log φ of all plans from a point with the gap U - 1.
pub(super) fn bound(log_phi: f64, gap: f64, scenarios: usize) -> f64 {
    let gap = gap.max(0.0);
    log_phi + if scenarios == 1 { gap.ln_1p() } else { gap }
}
