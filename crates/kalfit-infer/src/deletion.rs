//! Exact deletion: the fit without one test, and how well that fit predicts the test (theory §9).
//!
//! The reductions are in memory, so the fit without test j costs a few Newton steps from the optimum of all tests. The
//! first step needs no pass: the sums over the other tests are the sums over all tests minus the terms of test j.

use nalgebra::DMatrix;

use crate::posterior::distance;
use crate::posteriors::Distance;
use crate::progress::SharedProgress;
use kalfit_estimate::Order;
use kalfit_estimate::{
    Class, ClimbLimits, CovarianceMap, Criterion, Estimate, Local, NewtonIterate, Objective, Point, Problem, Silent,
    Stop, Sums, climb, fit_from,
};
use kalfit_filter::reduce::Reductions;
use kalfit_model::Population;

/// The fit without one test.
#[derive(Debug, Clone, PartialEq)]
pub struct Deletion {
    /// μ, Σ and regression coefficients without the test.
    pub estimate: Population,
    /// log p of the test's measurements at `estimate`: the predictive density.
    pub log_density: f64,
    /// Distance of the test from the population that the other tests describe.
    pub distance: Distance,
    /// 2 (ℓ(θ̂) - ℓ(θ̂₋ⱼ)), ℓ over all tests: influence of the test on the estimate (Cook's likelihood displacement).
    pub displacement: f64,
}

/// Most Newton steps of one deletion before a full search takes over.
const MAX_NEWTON_STEPS: usize = 12;

/// The fit without each test, for tests without groups, in the order of the reductions. An entry is `None` where the
/// other tests have no certified optimum, and for the only test; the result is `None` once `progress` stops.
pub(super) fn ungrouped(
    estimate: &Estimate,
    reductions: &Reductions,
    progress: &SharedProgress<'_>,
) -> Option<Vec<Option<Deletion>>> {
    if reductions.len() < 2 {
        return Some(vec![None; reductions.len()]);
    }
    let all = &AllTests::of(estimate);
    let without = |j: usize| {
        let others = match climb_without(estimate, all, (reductions, j)) {
            Some(others) => others,
            None => OtherTests { point: search_without(estimate, reductions, &[j])?.0, log_likelihood: None },
        };
        Some(deletion(estimate, all, (reductions, j), &others))
    };
    progress.each(reductions.len(), without)
}

/// Rough number of multiplications that [`deletions`](super::deletions) takes: the passes of all Newton steps, and the
/// factorisations of the Hessians.
pub(super) fn deletion_work(estimate: &Estimate, tests: usize) -> f64 {
    let (p, free) = (estimate.mean.len() as f64, estimate.state.newton_iterate.tangent.basis.ncols() as f64);
    // tests in groups have no shortcut: a full fit without each test and each group, from a start near the optimum
    let each = if estimate.grouping().is_some() { 60.0 } else { 3.0 };
    each * tests as f64 * (estimate.classes as f64 * (p + 1.0).powi(3) + 2.5 * free.powi(3))
}

/// Sums over all tests at the estimate, before the term of the restricted likelihood.
struct AllTests {
    sums: Sums,
    /// ℓ at the estimate.
    log_likelihood: f64,
}

impl AllTests {
    fn of(estimate: &Estimate) -> AllTests {
        let (problem, iterate) = (&estimate.state.problem, &estimate.state.newton_iterate);
        let sums = problem.unrestricted(&iterate.point, Order::Second, iterate.near());
        AllTests { log_likelihood: sums.value, sums }
    }
}

/// The optimum of the other tests.
struct OtherTests {
    point: Point,
    /// ℓ of the other tests at `point`, where it is known.
    log_likelihood: Option<f64>,
}

/// Likelihood of all tests but one.
struct Without<'a> {
    problem: &'a Problem,
    test: Class,
}

impl Without<'_> {
    fn from(&self, all: Sums, point: &Point, near: Option<&DMatrix<f64>>) -> Option<Local> {
        Some(Local::of(&mut self.problem.without(all, &self.test, point, near)?))
    }
}

impl Objective for Without<'_> {
    fn local(&self, point: &Point, near: Option<&DMatrix<f64>>) -> Option<Local> {
        self.from(self.problem.unrestricted(point, Order::Second, near), point, near)
    }

    fn mean_jacobian(&self) -> &DMatrix<f64> {
        self.problem.mean_jacobian()
    }

    fn move_mean(&self, point: &Point, step: &[f64]) -> Point {
        self.problem.move_mean(point, step)
    }
}

/// The optimum without test j, by Newton steps from the optimum of all tests; `None` where no certified optimum is
/// reached.
fn climb_without(estimate: &Estimate, all: &AllTests, (reductions, j): (&Reductions, usize)) -> Option<OtherTests> {
    let state = &estimate.state;
    let (problem, map): (&Problem, &CovarianceMap) = (&state.problem, &state.problem.covariance);
    let objective = Without { problem, test: problem.classes.single(reductions, j) };
    if !problem.informed_without(&all.sums, &objective.test, &state.newton_iterate.point) {
        return None; // log|ΣX'WX| has fewer directions without the test
    }
    let local = objective.from(all.sums.clone(), &state.newton_iterate.point, state.newton_iterate.near())?;
    let start = NewtonIterate::at(local, objective.mean_jacobian(), map, state.newton_iterate.point.clone())?;
    let limits = ClimbLimits { tolerance: state.settings.tolerance, steps: MAX_NEWTON_STEPS };
    let (iterate, stop) = climb(&objective, map, problem.classes.tests as f64 - 1.0, start, limits);
    let log_likelihood = (estimate.criterion == Criterion::Ml).then_some(iterate.local.value);
    (stop == Stop::Certified).then_some(OtherTests { point: iterate.point, log_likelihood })
}

/// Searches without the `removed` tests, from the optimum of all tests; returns the optimum in the coordinates of the
/// full fit, and the reductions of the remaining tests.
pub(super) fn search_without(
    estimate: &Estimate,
    reductions: &Reductions,
    removed: &[usize],
) -> Option<(Point, Reductions)> {
    let remaining: Vec<usize> = (0..reductions.len()).filter(|j| !removed.contains(j)).collect();
    if remaining.is_empty() {
        return None;
    }
    let (state, others) = (&estimate.state, reductions.select(&remaining));
    let start = Population::from(estimate);
    let found = fit_from(&others, &state.structure(), &start, &state.settings, &mut Silent).ok()?;
    let point = || state.problem.point_of(&Population::from(&found));
    (found.stop == Stop::Certified).then(|| (point(), others))
}

fn deletion(
    estimate: &Estimate,
    all: &AllTests,
    (reductions, j): (&Reductions, usize),
    others: &OtherTests,
) -> Deletion {
    let (problem, point) = (&estimate.state.problem, &others.point);
    let (log_density, distance) = distance(problem, point, reductions, j);
    let displaced_likelihood = match others.log_likelihood {
        Some(of_others) => of_others + log_density,
        None => problem.likelihood(point, Order::First).value,
    };
    Deletion {
        estimate: problem.values_of(point),
        log_density,
        distance,
        displacement: (2.0 * (all.log_likelihood - displaced_likelihood)).max(0.0),
    }
}
