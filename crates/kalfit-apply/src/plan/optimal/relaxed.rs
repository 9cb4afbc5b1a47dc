//! The best plan with any numbers n_k ≥ 0 of tests.

use super::bound;
use super::exchange;
use super::newton;
use super::problem::{PlanProblem, PlanValue};

/// Gap U - 1 at which a plan counts as the best.
const OPTIMAL: f64 = 1e-9;
/// Largest number of steps; the examples of theory §15 take 1 to 7.
const MOST_STEPS: usize = 500;

/// The best plan with any numbers of tests, and how good it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Relaxed {
    /// Number of tests of each kind.
    pub numbers: Vec<f64>,
    /// log φ of the plan.
    pub log_phi: f64,
    /// U - 1 of (15.4): zero at the best plan.
    pub gap: f64,
    /// ⟨G, F_k⟩ of each kind: the growth of log φ by one more test.
    pub gains: Vec<f64>,
    /// ⟨G, I₀⟩: the share of the information that was there before.
    pub of_base: f64,
}

impl Relaxed {
    fn new(problem: &PlanProblem, numbers: Vec<f64>, at: PlanValue) -> Relaxed {
        let gap = bound::gap(&problem.kinds, &at);
        Relaxed { numbers, log_phi: at.log_phi, gap, gains: at.gains, of_base: at.of_base }
    }

    /// No plan has a log φ above this.
    pub(super) fn bound(&self, problem: &PlanProblem) -> f64 {
        bound::bound(self.log_phi, self.gap.max(0.0), problem.scenarios.len())
    }
}

/// Solves the problem without whole numbers; `None` where the information of every plan is singular.
pub fn relax(problem: &PlanProblem) -> Option<Relaxed> {
    let kinds = &problem.kinds;
    let all = kinds.cost_of(&kinds.most);
    if all <= kinds.budget {
        let at = problem.value(&kinds.most)?;
        return Some(Relaxed { gap: 0.0, ..Relaxed::new(problem, kinds.most.clone(), at) });
    }
    let mut numbers = exchange::greedy(problem);
    let mut at = problem.value(&numbers)?;
    for _ in 0..MOST_STEPS {
        if bound::gap(kinds, &at) < OPTIMAL {
            break;
        }
        let moved = newton::step(problem, &numbers, &at).or_else(|| exchange::step(problem, &numbers, &at));
        let Some((next, value)) = moved else { break };
        (numbers, at) = (next, value);
    }
    Some(Relaxed::new(problem, numbers, at))
}
