//! A first plan, and steps that exchange one kind of tests for another.

use super::Criterion;
use super::bound;
use super::problem::{PlanProblem, PlanValue};

/// The part of a plan of all kinds alike that the beginning plan includes, so that its information is regular: small enough
/// to leave the order of gains as it is.
const BEGINNING: f64 = 1e-6;
/// Differences of log φ, which is of order 1 for scaled information, that rounding can make.
const ROUNDING: f64 = 1e-13;
/// Halvings of a step that does not improve the plan; after these a step is below the rounding of numbers (2⁻⁶⁰).
const HALVINGS: usize = 60;
/// Numbers of tests below this fraction of what the budget allows count as zero.
pub(super) const NOTHING: f64 = 1e-12;

/// A plan in 2d portions of the budget, each for the kind that increases |M| most for its cost.
pub(super) fn greedy(problem: &PlanProblem) -> Vec<f64> {
    let kinds = &problem.kinds;
    let d = problem.scenarios[0].base.nrows();
    let mut regular = problem.clone();
    let equal = kinds.budget / kinds.cost_of(&vec![1.0; kinds.len()]);
    for own in &mut regular.scenarios {
        own.base = own.information(&vec![BEGINNING * equal; kinds.len()]);
        own.criterion = Criterion::Determinant;
    }
    let portion = kinds.budget / (2 * d) as f64;
    let (mut numbers, mut left) = (vec![0.0; kinds.len()], kinds.budget);
    while left > NOTHING * kinds.budget {
        let gains = regular.value(&numbers).map_or_else(|| vec![1.0; kinds.len()], |at| at.gains);
        let open = (0..kinds.len()).filter(|&k| numbers[k] < kinds.most[k]);
        let best = open.max_by(|&a, &b| {
            let per_cost = |k: usize| gains[k] / kinds.costs[k];
            per_cost(a).total_cmp(&per_cost(b)).then(b.cmp(&a))
        });
        let Some(best) = best else { break };
        let more = (portion.min(left) / kinds.costs[best]).min(kinds.most[best] - numbers[best]);
        numbers[best] += more;
        left -= more * kinds.costs[best];
    }
    numbers
}

/// Moves cost from the kind of the plan with the least gain per cost to the kind with the most; `None` where that does not
/// improve the plan.
pub(super) fn step(problem: &PlanProblem, numbers: &[f64], at: &PlanValue) -> Option<(Vec<f64>, PlanValue)> {
    let kinds = &problem.kinds;
    let per_cost = |k: usize| at.gains[k] / kinds.costs[k];
    let least = (0..kinds.len()).filter(|&k| numbers[k] > 0.0).min_by(|&a, &b| per_cost(a).total_cmp(&per_cost(b)))?;
    let open = (0..kinds.len()).filter(|&k| numbers[k] < kinds.most[k] && k != least);
    let most = open.max_by(|&a, &b| per_cost(a).total_cmp(&per_cost(b)).then(b.cmp(&a)))?;
    let largest = (numbers[least] * kinds.costs[least]).min((kinds.most[most] - numbers[most]) * kinds.costs[most]);
    let mut direction = vec![0.0; kinds.len()];
    (direction[least], direction[most]) = (-largest / kinds.costs[least], largest / kinds.costs[most]);
    improved(problem, (numbers, at), &direction)
}

/// The plan after a step along a direction that is feasible at its whole length, shortened until log φ increases.
pub(super) fn improved(
    problem: &PlanProblem,
    (numbers, at): (&[f64], &PlanValue),
    direction: &[f64],
) -> Option<(Vec<f64>, PlanValue)> {
    let mut length = 1.0;
    for _ in 0..HALVINGS {
        let moved: Vec<f64> = numbers.iter().zip(direction).map(|(n, step)| (n + length * step).max(0.0)).collect();
        if let Some(value) = problem.value(&moved).filter(|value| is_better(problem, at, value)) {
            // where the slope is steep against the direction, the maximum along it is nearer
            let slope =
                |at: &PlanValue| -> f64 { at.gains.iter().zip(direction).map(|(gain, step)| gain * step).sum() };
            if slope(&value) >= -0.5 * slope(at) {
                return Some((moved, value));
            }
        }
        length /= 2.0;
    }
    None
}

/// Whether log φ is larger; where the difference is rounding, whether the gap of the certificate is smaller.
fn is_better(problem: &PlanProblem, at: &PlanValue, value: &PlanValue) -> bool {
    let gap = |at: &PlanValue| bound::gap(&problem.kinds, at);
    let more = value.log_phi - at.log_phi;
    more > ROUNDING || (more > -ROUNDING && gap(value) < 0.9 * gap(at))
}
