//! Newton's step among the kinds of a plan and the best kind that is not in it.

use nalgebra::{DMatrix, DVector};

use super::exchange;
use super::problem::{PlanProblem, PlanValue};

/// Added to the diagonal of the Hessian, relative to its largest element: kinds whose information depends on that of
/// others leave it singular.
const RIDGE: f64 = 1e-10;

/// The plan after a step at constant cost; `None` where the step does not improve it.
pub(super) fn step(problem: &PlanProblem, numbers: &[f64], at: &PlanValue) -> Option<(Vec<f64>, PlanValue)> {
    let kinds = &problem.kinds;
    let mut chosen = working_set(problem, numbers, at);
    // kinds that the step would move beyond their bounds leave it
    while chosen.len() > 1 {
        let (gradient, hessian) = (at.gains_of(&chosen), problem.hessian(at, &chosen));
        let costs = DVector::from_iterator(chosen.len(), chosen.iter().map(|&k| kinds.costs[k]));
        let step = constrained(&hessian, &gradient, &costs)?;
        let is_blocked = |i: &usize| {
            let k = chosen[*i];
            (numbers[k] <= 0.0 && step[*i] < 0.0) || (numbers[k] >= kinds.most[k] && step[*i] > 0.0)
        };
        if let Some(blocked) = (0..chosen.len()).find(is_blocked) {
            chosen.remove(blocked);
            continue;
        }
        let mut direction = vec![0.0; kinds.len()];
        chosen.iter().zip(step.iter()).for_each(|(&k, step)| direction[k] = *step);
        let room = |&k: &usize| match direction[k] {
            step if step < 0.0 => numbers[k] / -step,
            step if step > 0.0 => (kinds.most[k] - numbers[k]) / step,
            _ => f64::INFINITY,
        };
        let length = chosen.iter().map(room).fold(1.0, f64::min);
        direction.iter_mut().for_each(|step| *step *= length);
        let (mut moved, value) = exchange::improved(problem, (numbers, at), &direction)?;
        let least = exchange::NOTHING * kinds.budget;
        let is_nothing = |k: usize| moved[k] * kinds.costs[k] < least && moved[k] > 0.0;
        if (0..kinds.len()).any(is_nothing) {
            (0..kinds.len()).for_each(|k| {
                if moved[k] * kinds.costs[k] < least {
                    moved[k] = 0.0
                }
            });
            let value = problem.value(&moved)?;
            return Some((moved, value));
        }
        return Some((moved, value));
    }
    None
}

/// Kinds between their bounds, the best of those that have none, and the worst of those at their caps.
fn working_set(problem: &PlanProblem, numbers: &[f64], at: &PlanValue) -> Vec<usize> {
    let kinds = &problem.kinds;
    let per_cost = |k: usize| at.gains[k] / kinds.costs[k];
    let all = || 0..kinds.len();
    let compare = |a: &usize, b: &usize| per_cost(*a).total_cmp(&per_cost(*b)).then(b.cmp(a));
    let is_at_cap = |k: &usize| numbers[*k] >= kinds.most[*k];
    let mut chosen: Vec<usize> = all().filter(|k| numbers[*k] > 0.0 && !is_at_cap(k)).collect();
    chosen.extend(all().filter(|k| numbers[*k] <= 0.0 && !is_at_cap(k)).max_by(compare));
    chosen.extend(all().filter(|k| numbers[*k] > 0.0 && is_at_cap(k)).min_by(compare));
    chosen.sort_unstable();
    chosen
}

/// The step s that maximises g's + ½s'Hs with c's = 0.
fn constrained(hessian: &DMatrix<f64>, gradient: &DVector<f64>, costs: &DVector<f64>) -> Option<DVector<f64>> {
    let n = gradient.len();
    // in shares of the budget, in which all kinds are alike
    let per_cost = |i: usize, j: usize| hessian[(i, j)] / costs[i] / costs[j];
    let largest = (0..n).map(|i| per_cost(i, i).abs()).fold(0.0, f64::max);
    let mut system = DMatrix::zeros(n + 1, n + 1);
    for i in 0..n {
        (0..n).for_each(|j| system[(i, j)] = per_cost(i, j) / largest);
        system[(i, i)] -= RIDGE;
        (system[(i, n)], system[(n, i)]) = (1.0, 1.0);
    }
    let mut right = DVector::zeros(n + 1);
    (0..n).for_each(|i| right[i] = -gradient[i] / costs[i] / largest);
    let solution = system.lu().solve(&right)?;
    let step = DVector::from_iterator(n, (0..n).map(|i| solution[i] / costs[i]));
    step.iter().all(|x| x.is_finite()).then_some(step)
}
