//! Explains why the data do not determine a direction.

use std::collections::BTreeSet;

use crate::direction::{Direction, Quantity};
use crate::observability::Observability;
use kalfit_estimate::Problem;

/// Why a direction is not identified. States are elements of μ.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reason {
    /// No test informs these states.
    Unseen {
        /// The states.
        states: Vec<usize>,
    },
    /// No test informs both states of a covariance.
    NeverTogether {
        /// The two states.
        states: [usize; 2],
    },
    /// No test separates these states: each test informs only combinations of them.
    NeverApart {
        /// The states.
        states: Vec<usize>,
    },
    /// The tests inform too few different combinations of these states.
    TooFewCombinations {
        /// The states.
        states: Vec<usize>,
    },
    /// Groups of some level have one member each, or too few groups have more than one: for these states only the sum
    /// of the variations at two levels is known.
    LevelsTogether {
        /// The states.
        states: Vec<usize>,
    },
    /// A level has only one group: the effect of this group on these states cannot be separated from the mean.
    OneGroup {
        /// The states.
        states: Vec<usize>,
    },
    /// μ and Σ can move along the direction together with dynamic parameters without a change of ℓ.
    WithParameters {
        /// Indices of the parameters.
        parameters: Vec<usize>,
    },
    /// The covariates of these regressions vary too little, or vary together, over the tests that inform the states of
    /// the regressions.
    Confounded {
        /// Indices of [`MeanStructure::regression`](kalfit_model::MeanStructure::regression).
        regressions: Vec<usize>,
    },
}

/// Why a direction is not identified, and the tests concerned.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Explanation {
    /// Why the direction is not identified.
    pub reason: Reason,
    /// Sorted ids of the tests that inform any of the direction's states, for few tests; else empty.
    pub tests: Vec<String>,
}

impl Explanation {
    /// Adds the parameters of another explanation of the same direction.
    pub(crate) fn also(&mut self, other: &Explanation) {
        if let (Reason::WithParameters { parameters }, Reason::WithParameters { parameters: others }) =
            (&mut self.reason, &other.reason)
        {
            parameters.extend(others);
            parameters.sort_unstable();
            parameters.dedup();
        }
    }
}

/// An explanation for each direction.
pub(crate) fn explain(problem: &Problem, directions: &[Direction], seen: &Observability) -> Vec<Explanation> {
    let one = |direction: &Direction| match direction.quantity {
        Quantity::Mean => mean(problem, direction, seen),
        Quantity::Covariance => covariance(problem, direction, seen),
    };
    directions.iter().map(one).collect()
}

/// Indices of the elements that take part in a direction.
fn support(direction: &[f64]) -> Vec<usize> {
    (0..direction.len()).filter(|&k| direction[k] != 0.0).collect()
}

fn mean(problem: &Problem, direction: &Direction, seen: &Observability) -> Explanation {
    let p = problem.classes.dimension();
    let (states, coefficients): (Vec<usize>, Vec<usize>) =
        support(&direction.direction).into_iter().partition(|&k| k < p);
    let mut states: Vec<usize> = states.into_iter().map(|i| i % seen.states.len()).collect();
    let regressions: Vec<usize> = coefficients.into_iter().map(|k| k - p).collect();
    states.extend(regressions.iter().map(|&c| problem.mean.regressors[c]));
    states.sort_unstable();
    states.dedup();
    let tests = seen.tests_of(&states);
    let reason = match unseen(&states, seen) {
        unobserved if unobserved.len() == states.len() => Reason::Unseen { states },
        _ if !regressions.is_empty() => Reason::Confounded { regressions },
        _ => Reason::NeverApart { states },
    };
    Explanation { reason, tests }
}

fn covariance(problem: &Problem, direction: &Direction, seen: &Observability) -> Explanation {
    let elements = &problem.covariance.elements;
    debug_assert_eq!(direction.direction.len(), elements.count(), "one weight for each element");
    let all: Vec<(usize, usize)> = elements.all().collect();
    let elements: Vec<(usize, usize)> = support(&direction.direction).into_iter().map(|at| all[at]).collect();
    // the element indices repeat the states once for each level of groups
    let p = seen.states.len();
    let levels: BTreeSet<usize> = elements.iter().map(|(i, _)| i / p.max(1)).collect();
    let elements: Vec<(usize, usize)> = elements.into_iter().map(|(i, k)| (i % p, k % p)).collect();
    let mut states: Vec<usize> = elements.iter().flat_map(|&(i, k)| [i, k]).collect();
    states.sort_unstable();
    states.dedup();
    let tests = seen.tests_of(&states);
    let unobserved = unseen(&states, seen);
    let reason = match elements.as_slice() {
        elements if elements.iter().all(|(i, k)| unobserved.contains(i) || unobserved.contains(k)) => {
            Reason::Unseen { states: unobserved }
        }
        &[(i, k)] if i != k && seen.together[i][k] == 0 => Reason::NeverTogether { states: [k, i] },
        _ if levels.len() > 1 => Reason::LevelsTogether { states },
        _ if levels.iter().all(|level| problem.is_one_group(*level)) => Reason::OneGroup { states },
        _ if states.iter().all(|&i| seen.states[i].observed_by == 0) => Reason::NeverApart { states },
        _ => Reason::TooFewCombinations { states },
    };
    Explanation { reason, tests }
}

fn unseen(states: &[usize], seen: &Observability) -> Vec<usize> {
    states.iter().copied().filter(|&i| seen.states[i].informed_by == 0).collect()
}
