//! The best plan in whole numbers: rounding, exchange of pairs, and branch and bound.

use super::bound::{self, ByGain};
use super::problem::PlanProblem;
use super::relaxed::{Relaxed, relax};

/// Largest number of branches that are looked at; all cases of theory §15 end within 15.
const MOST_NODES: usize = 4000;
/// Largest number of multiplications, in units of kinds × d², over all branches.
const MOST_WORK: f64 = 2e10;
/// Difference of log φ that counts as none.
const SAME: f64 = 1e-10;
/// Distance from a whole number that counts as rounding of the relaxed solution.
const NEARLY_WHOLE: f64 = 1e-7;
/// Costs add up to the budget to this factor.
const ROUNDED_UP: f64 = 1.0 + 1e-12;
/// What is left of the budget is filled in at most so many portions of a kind, then test by test.
const MOST_FILLED: f64 = 64.0;
/// Kinds that an exchange tries in place of another: those with the largest gains per cost.
const MOST_TRIED: usize = 24;

/// The best plan in whole numbers that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct WholePlan {
    /// Number of tests of each kind.
    pub numbers: Vec<f64>,
    /// log φ of the plan.
    pub log_phi: f64,
    /// No plan in whole numbers has a log φ above this; `log_phi` where the plan is proved to be the best.
    pub bound: f64,
    /// Number of branches that were looked at.
    pub nodes: usize,
}

impl WholePlan {
    /// Whether no plan in whole numbers is better.
    pub fn is_optimal(&self) -> bool {
        self.bound - self.log_phi <= SAME
    }
}

/// The best plan in whole numbers, from the relaxed solution `root`; `None` where every plan in whole numbers has singular
/// information.
pub fn in_whole_numbers(problem: &PlanProblem, root: &Relaxed) -> Option<WholePlan> {
    let first = rounded(problem, root);
    // a kind of which one test brings no plan above the first is in no better plan
    let kept = worth_trying(problem, root, first.as_ref());
    let small = problem.only(&kept);
    let of = |numbers: &[f64]| kept.iter().map(|&k| numbers[k]).collect::<Vec<f64>>();
    let found = branched(&small, first.map(|(numbers, log_phi)| (of(&numbers), log_phi)))?;
    let mut numbers = vec![0.0; problem.kinds.len()];
    kept.iter().zip(&found.numbers).for_each(|(&k, n)| numbers[k] = *n);
    Some(WholePlan { numbers, ..found })
}

/// The kinds of which a plan better than the first may have a test, with those of the relaxed plan and of the first.
fn worth_trying(problem: &PlanProblem, root: &Relaxed, first: Option<&(Vec<f64>, f64)>) -> Vec<usize> {
    let least = first.map_or(f64::NEG_INFINITY, |first| first.1);
    let kinds = &problem.kinds;
    let by_gain = ByGain::new(kinds, &root.gains);
    let may_be_better = |k: usize| {
        if kinds.costs[k] > kinds.budget || kinds.most[k] < 1.0 {
            return false;
        }
        let gap = root.of_base + root.gains[k] + by_gain.largest(kinds.budget - kinds.costs[k]) - 1.0;
        // a plan may also be worse than the relaxed one: U < 1
        bound::bound(root.log_phi, gap, problem.scenarios.len()) > least + SAME
    };
    let is_in_first = |k: usize| first.is_some_and(|first| first.0[k] > 0.0);
    (0..kinds.len()).filter(|&k| root.numbers[k] > 0.0 || is_in_first(k) || may_be_better(k)).collect()
}

/// A branch: numbers of each kind between `least` and `most`.
struct Branch {
    least: Vec<f64>,
    most: Vec<f64>,
    bound: f64,
}

/// Branch and bound from a first plan, where there is one; `None` where no plan that was looked at has regular information.
fn branched(problem: &PlanProblem, first: Option<(Vec<f64>, f64)>) -> Option<WholePlan> {
    let kinds = &problem.kinds;
    let (mut best, mut nodes) = (first.unwrap_or((Vec::new(), f64::NEG_INFINITY)), 0);
    let work = (kinds.len() * problem.scenarios.len() * problem.scenarios[0].base.len()) as f64;
    let allowed = MOST_NODES.min((MOST_WORK / work.max(1.0)) as usize).max(1);
    let mut open = vec![Branch { least: vec![0.0; kinds.len()], most: kinds.most.clone(), bound: f64::INFINITY }];
    while let Some(at) = most_promising(&open) {
        if open[at].bound <= best.1 + SAME || nodes >= allowed {
            break;
        }
        let branch = open.swap_remove(at);
        nodes += 1;
        let left = problem.after(&branch.least, &branch.most);
        let Some(found) = relax(&left) else { continue };
        let limit = found.bound(&left).min(branch.bound);
        if limit <= best.1 + SAME {
            continue;
        }
        let numbers: Vec<f64> = found.numbers.iter().zip(&branch.least).map(|(n, least)| n + least).collect();
        let near = Relaxed { numbers, ..found };
        if let Some(whole) = rounded(problem, &near).filter(|(_, log_phi)| *log_phi > best.1) {
            best = whole;
        }
        let Some(split) = most_fractional(&near.numbers) else { continue };
        let (mut below, mut above) = ((branch.least.clone(), branch.most.clone()), (branch.least, branch.most));
        (below.1[split], above.0[split]) = (near.numbers[split].floor(), near.numbers[split].ceil());
        open.push(Branch { least: below.0, most: below.1, bound: limit });
        if kinds.cost_of(&above.0) <= kinds.budget * ROUNDED_UP {
            open.push(Branch { least: above.0, most: above.1, bound: limit });
        }
    }
    let bound = open.iter().map(|branch| branch.bound).fold(best.1, f64::max);
    best.1.is_finite().then_some(WholePlan {
        numbers: best.0,
        log_phi: best.1,
        bound: if bound <= best.1 + SAME { best.1 } else { bound },
        nodes,
    })
}

fn most_promising(open: &[Branch]) -> Option<usize> {
    (0..open.len()).max_by(|&a, &b| open[a].bound.total_cmp(&open[b].bound).then(a.cmp(&b)))
}

/// The number that is furthest from a whole one; `None` where all are whole.
fn most_fractional(numbers: &[f64]) -> Option<usize> {
    let distance = |k: usize| (numbers[k] - numbers[k].round()).abs();
    let of_all = (0..numbers.len()).filter(|&k| distance(k) > NEARLY_WHOLE);
    of_all.max_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(b.cmp(&a)))
}

/// A plan in whole numbers near a relaxed one: rounded down, filled by gain per cost, and improved by exchanges; with its
/// log φ. `None` where it has singular information.
fn rounded(problem: &PlanProblem, near: &Relaxed) -> Option<(Vec<f64>, f64)> {
    let kinds = &problem.kinds;
    let cap = |k: usize| kinds.most[k].floor();
    let floored =
        |slack: f64| -> Vec<f64> { (0..kinds.len()).map(|k| (near.numbers[k] + slack).floor().min(cap(k))).collect() };
    let mut numbers = floored(NEARLY_WHOLE);
    if kinds.cost_of(&numbers) > kinds.budget * ROUNDED_UP {
        numbers = floored(0.0);
    }
    let tried = by_gain(problem, near);
    // where the rounded plan is singular, gains are those of the relaxed plan
    while let Some((k, room)) = next(problem, &numbers, near, &tried) {
        // the last tests one by one
        numbers[k] += (room / MOST_FILLED).floor().max(1.0);
    }
    let mut log_phi = problem.log_phi(&numbers)?;
    while let Some((better, value)) = exchanged(problem, &numbers, log_phi, &tried) {
        (numbers, log_phi) = (better, value);
    }
    Some((numbers, log_phi))
}

/// The kinds of the relaxed plan, and those with the largest gains per cost.
fn by_gain(problem: &PlanProblem, near: &Relaxed) -> Vec<usize> {
    let kinds = &problem.kinds;
    let per_cost = |k: usize| near.gains[k] / kinds.costs[k];
    let mut order: Vec<usize> = (0..kinds.len()).collect();
    order.sort_by(|&a, &b| {
        (near.numbers[b] > 0.0).cmp(&(near.numbers[a] > 0.0)).then(per_cost(b).total_cmp(&per_cost(a))).then(a.cmp(&b))
    });
    let of_plan = near.numbers.iter().filter(|n| **n > 0.0).count();
    order.truncate(of_plan + MOST_TRIED);
    order
}

/// The kind whose next test brings most for its cost, of those that there is room for, and the room.
fn next(problem: &PlanProblem, numbers: &[f64], near: &Relaxed, tried: &[usize]) -> Option<(usize, f64)> {
    let kinds = &problem.kinds;
    let left = kinds.budget * ROUNDED_UP - kinds.cost_of(numbers);
    let room = |k: usize| (left / kinds.costs[k]).floor().min((kinds.most[k] - numbers[k]).floor());
    let has_room = |k: usize| room(k) >= 1.0;
    let now = problem.log_phi(numbers);
    let gain = |k: usize| {
        let mut more = numbers.to_vec();
        more[k] += 1.0;
        let gain = match (now, problem.log_phi(&more)) {
            (Some(now), Some(then)) => then - now,
            _ => near.gains[k] * (1.0 + near.numbers[k] - numbers[k]).max(0.0),
        };
        gain / kinds.costs[k]
    };
    let open = tried.iter().copied().chain(0..kinds.len()).filter(|&k| has_room(k));
    // beyond those tried, any that there is room for is better than none
    let open: Vec<usize> = open.take(tried.len().max(1)).collect();
    open.into_iter()
        .map(|k| (k, gain(k)))
        .max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))
        .map(|(k, _)| (k, room(k)))
}

/// A better plan by one test of a kind less and tests of others in its place; `None` where there is none.
fn exchanged(problem: &PlanProblem, numbers: &[f64], log_phi: f64, tried: &[usize]) -> Option<(Vec<f64>, f64)> {
    let kinds = &problem.kinds;
    let mut best: Option<(Vec<f64>, f64)> = None;
    for less in (0..kinds.len()).filter(|&k| numbers[k] >= 1.0) {
        for &more in tried.iter().filter(|&&k| k != less) {
            let mut moved = numbers.to_vec();
            moved[less] -= 1.0;
            let left = kinds.budget * ROUNDED_UP - kinds.cost_of(&moved);
            let count = (left / kinds.costs[more]).floor().min((kinds.most[more] - moved[more]).floor());
            if count < 1.0 {
                continue;
            }
            for added in [1.0, count] {
                let mut moved = moved.clone();
                moved[more] += added;
                let value = problem.log_phi(&moved).unwrap_or(f64::NEG_INFINITY);
                if value > best.as_ref().map_or(log_phi, |best| best.1) + SAME {
                    best = Some((moved, value));
                }
            }
        }
    }
    best
}
