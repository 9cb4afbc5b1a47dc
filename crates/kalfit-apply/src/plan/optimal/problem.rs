//! The kinds of tests, and the information of a plan.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::criterion::{Criterion, Evaluated};
use super::exchange;

/// Information of a first plan that is added where a criterion of few figures could leave M singular.
const REGULAR: f64 = 1e-8;

/// Largest number of tests of a kind that has no limit of its own: beyond every laboratory, and within the digits of a sum.
pub const MOST_TESTS: f64 = 1e9;

/// Cost and largest number of each kind, and the budget.
#[derive(Debug, Clone, PartialEq)]
pub struct Kinds {
    /// Cost c_k > 0 of one test of each kind.
    pub costs: Vec<f64>,
    /// Largest number m_k of tests of each kind, at most [`MOST_TESTS`].
    pub most: Vec<f64>,
    /// Largest cost of all tests together.
    pub budget: f64,
}

/// The information of each kind at one set of parameters, with the criterion there. All matrices are d × d.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Information I₀ that is there before any test is made.
    pub base: DMatrix<f64>,
    /// Information F_k of one test of each kind.
    pub kinds: Arc<Vec<DMatrix<f64>>>,
    /// What is to be best.
    pub criterion: Criterion,
}

/// A plan is sought: the mean of log φ over the scenarios is to be largest.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanProblem {
    /// The kinds of tests.
    pub kinds: Kinds,
    /// One scenario, or several for a plan that is good over draws of the parameters.
    pub scenarios: Vec<Scenario>,
}

/// The mean of log φ of a plan, with its derivatives.
#[derive(Debug, Clone)]
pub(super) struct PlanValue {
    pub(super) log_phi: f64,
    /// ⟨G, I₀⟩.
    pub(super) of_base: f64,
    /// ⟨G, F_k⟩ of each kind.
    pub(super) gains: Vec<f64>,
    points: Vec<Evaluated>,
}

impl Kinds {
    pub(super) fn len(&self) -> usize {
        self.costs.len()
    }

    pub(super) fn cost_of(&self, numbers: &[f64]) -> f64 {
        numbers.iter().zip(&self.costs).map(|(n, c)| n * c).sum()
    }
}

impl Scenario {
    /// M(n).
    pub fn information(&self, numbers: &[f64]) -> DMatrix<f64> {
        let mut sum = self.base.clone();
        numbers.iter().zip(self.kinds.iter()).filter(|(n, _)| **n != 0.0).for_each(|(n, f)| sum += f * *n);
        sum
    }
}

impl PlanProblem {
    /// The problem with a little information added where a criterion of few figures could end at a singular M, which has
    /// neither gradient nor bound: that of a plan that informs all coordinates, times 1e-8. Information that is regular
    /// stays as it is.
    #[must_use]
    pub fn regular(&self) -> PlanProblem {
        let mut regular = self.clone();
        let little: Vec<f64> = exchange::greedy(self).iter().map(|n| n * REGULAR).collect();
        for own in &mut regular.scenarios {
            if own.criterion != Criterion::Determinant && own.criterion.log_phi(&own.base).is_none() {
                own.base = own.information(&little);
            }
        }
        regular
    }

    /// log φ of a plan; `None` where its information is singular.
    pub fn log_phi(&self, numbers: &[f64]) -> Option<f64> {
        self.mean(|scenario| scenario.criterion.log_phi(&scenario.information(numbers)))
    }

    fn mean(&self, of: impl Fn(&Scenario) -> Option<f64>) -> Option<f64> {
        let values: Option<Vec<f64>> = self.scenarios.iter().map(of).collect();
        values.map(|values| values.iter().sum::<f64>() / values.len() as f64)
    }

    /// log φ of a plan with derivatives; `None` where its information is singular.
    pub(super) fn value(&self, numbers: &[f64]) -> Option<PlanValue> {
        let at = |scenario: &Scenario| scenario.criterion.evaluate(&scenario.information(numbers));
        let points: Vec<Evaluated> = self.scenarios.iter().map(at).collect::<Option<_>>()?;
        let share = (points.len() as f64).recip();
        let both = || self.scenarios.iter().zip(&points);
        let gain = |k: usize| both().map(|(own, at)| at.gradient.dot(&own.kinds[k])).sum::<f64>() * share;
        Some(PlanValue {
            log_phi: points.iter().map(|at| at.log_phi).sum::<f64>() * share,
            of_base: both().map(|(own, at)| at.gradient.dot(&own.base)).sum::<f64>() * share,
            gains: (0..self.kinds.len()).into_par_iter().map(gain).collect(),
            points,
        })
    }

    /// Second derivatives of log φ by the numbers of some kinds.
    pub(super) fn hessian(&self, at: &PlanValue, kinds: &[usize]) -> DMatrix<f64> {
        let mut sum = DMatrix::zeros(kinds.len(), kinds.len());
        for (own, point) in self.scenarios.iter().zip(&at.points) {
            let directions: Vec<&DMatrix<f64>> = kinds.iter().map(|&k| &own.kinds[k]).collect();
            sum += own.criterion.hessian(point, &directions);
        }
        sum / self.scenarios.len() as f64
    }

    /// The problem that is left after `numbers` tests are certain: with less budget, and more information to begin with.
    pub(super) fn after(&self, numbers: &[f64], most: &[f64]) -> PlanProblem {
        let left = |(most, n): (&f64, &f64)| (most - n).max(0.0);
        let kinds = Kinds {
            costs: self.kinds.costs.clone(),
            most: most.iter().zip(numbers).map(left).collect(),
            budget: (self.kinds.budget - self.kinds.cost_of(numbers)).max(0.0),
        };
        let scenario = |own: &Scenario| Scenario {
            base: own.information(numbers),
            kinds: own.kinds.clone(),
            criterion: own.criterion.clone(),
        };
        PlanProblem { kinds, scenarios: self.scenarios.iter().map(scenario).collect() }
    }

    /// The problem with some kinds only, by their numbers.
    pub(super) fn only(&self, kept: &[usize]) -> PlanProblem {
        let of = |all: &[f64]| kept.iter().map(|&k| all[k]).collect();
        let kinds = Kinds { costs: of(&self.kinds.costs), most: of(&self.kinds.most), budget: self.kinds.budget };
        let scenario = |own: &Scenario| Scenario {
            kinds: Arc::new(kept.iter().map(|&k| own.kinds[k].clone()).collect()),
            base: own.base.clone(),
            criterion: own.criterion.clone(),
        };
        PlanProblem { kinds, scenarios: self.scenarios.iter().map(scenario).collect() }
    }
}

impl PlanValue {
    /// The gains of some kinds.
    pub(super) fn gains_of(&self, kinds: &[usize]) -> DVector<f64> {
        DVector::from_iterator(kinds.len(), kinds.iter().map(|&k| self.gains[k]))
    }
}
