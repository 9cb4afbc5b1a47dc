//! How the posterior means of groups follow the estimated covariances: derivatives with respect to the elements of Σ.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::DMatrix;

use crate::estimated::Estimated;
use crate::estimates::EstimateCovariance;
use crate::levels::GroupPosterior;
use kalfit_algebra::symmetric;
use kalfit_estimate::{Estimate, Point, Problem, Units, level_posteriors};
use kalfit_filter::reduce::Reductions;

/// Relative step of a variance. A step is always an increase, which leaves Σ positive semidefinite where it is singular.
const STEP: f64 = 1e-4;
/// Largest number of multiplications, about a second, at which the derivatives are computed.
const MOST_MULTIPLICATIONS: f64 = 2e9;

/// Adds d(mean) / d(estimates) to the groups of the innermost level, with zeros for estimates that are no elements of
/// Σ. The groups stay without derivatives where these would take long: of many groups Σ is well known.
pub(super) fn add(
    estimate: &Estimate,
    evidence: &Reductions,
    estimates: &EstimateCovariance,
    groups: &mut [GroupPosterior],
) {
    let state = &estimate.state;
    let (problem, point) = (&state.problem, &state.newton_iterate.point);
    let classes = problem.classes.of(evidence);
    let Some(units) = classes.units.as_ref().filter(|units| !units.grouping.is_crossed()) else { return };
    let elements = elements(estimates);
    let passes = 2.0 * elements.len() as f64 + 1.0;
    if passes * evidence.len() as f64 * 4.0 * (units.states as f64 + 1.0).powi(3) > MOST_MULTIPLICATIONS {
        return;
    }
    let moving = MovingCovariance { problem, point, units };
    let slopes = moving.slopes(&elements);
    let scale = &problem.classes.frame.scale;
    for (number, group) in groups.iter_mut().enumerate() {
        let by = |i: usize, c: usize| match estimates.quantities[c] {
            Estimated::Covariance(a, b) => slopes[&(a, b)][number][i] * scale[i] / (scale[a] * scale[b]),
            _ => 0.0,
        };
        group.by_estimates = Some(DMatrix::from_fn(units.states, estimates.quantities.len(), by));
    }
}

/// Elements (i, j) of Σ among the estimates, with the variances (i, i) and (j, j) of each.
fn elements(estimates: &EstimateCovariance) -> BTreeSet<(usize, usize)> {
    let own = estimates.quantities.iter().filter_map(|quantity| match *quantity {
        Estimated::Covariance(i, j) => Some([(i, j), (i, i), (j, j)]),
        _ => None,
    });
    own.flatten().collect()
}

/// Posterior means, by group, at other Σ.
struct MovingCovariance<'a> {
    problem: &'a Problem,
    point: &'a Point,
    units: &'a Units,
}

impl MovingCovariance<'_> {
    /// d(means of all groups) / d(element of Σ), in η.
    fn slopes(&self, elements: &BTreeSet<(usize, usize)>) -> BTreeMap<(usize, usize), Vec<Vec<f64>>> {
        let (start, sizes) = (self.means(self.point), self.sizes());
        // variances before covariances: (i, j) needs (i, i) and (j, j)
        let (variances, others): (Vec<_>, Vec<_>) = elements.iter().copied().partition(|(i, j)| i == j);
        let mut along: BTreeMap<(usize, usize), Vec<Vec<f64>>> = BTreeMap::new();
        for (i, j) in variances.into_iter().chain(others) {
            let mut slope = self.slope((i, j), &sizes, &start);
            if i != j {
                let both = along[&(i, i)].iter().zip(&along[&(j, j)]);
                for (own, (first, second)) in slope.iter_mut().zip(both) {
                    let parts = first.iter().zip(second);
                    own.iter_mut().zip(parts).for_each(|(own, (first, second))| *own -= first + second);
                }
            }
            along.insert((i, j), slope);
        }
        for ((i, j), slope) in &mut along {
            let size = sizes[*i] * sizes[*j];
            slope.iter_mut().flatten().for_each(|x| *x /= size);
        }
        along
    }

    /// Derivative along vv', with v the sizes of the states i and j and zeros elsewhere, by two steps forwards:
    /// (4 f(h) - f(2h) - 3 f(0)) / 2h.
    fn slope(&self, element: (usize, usize), sizes: &[f64], start: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let [near, far] = [STEP, 2.0 * STEP].map(|step| self.means(&self.moved(element, sizes, step)));
        let one = |((near, far), start): ((&Vec<f64>, &Vec<f64>), &Vec<f64>)| -> Vec<f64> {
            let three = near.iter().zip(far).zip(start);
            three.map(|((near, far), start)| (4.0 * near - far - 3.0 * start) / (2.0 * STEP)).collect()
        };
        near.iter().zip(&far).zip(start).map(one).collect()
    }

    /// The point with Σ + step vv'.
    fn moved(&self, (i, j): (usize, usize), sizes: &[f64], step: f64) -> Point {
        let p = self.units.states;
        let block = (i / p) * p;
        let own = self.point.root.view((block, block), (p, p));
        let mut covariance = own * own.transpose();
        let states = if i == j { vec![i] } else { vec![i, j] };
        for &a in &states {
            states.iter().for_each(|&b| covariance[(a - block, b - block)] += step * sizes[a] * sizes[b]);
        }
        let mut point = self.point.clone();
        point.root.view_mut((block, block), (p, p)).copy_from(&symmetric::square_root(&covariance));
        point
    }

    /// Standard deviation of each state in η, over all levels; one where a state does not vary.
    fn sizes(&self) -> Vec<f64> {
        let (p, covariance) = (self.units.states, self.point.covariance());
        let n = covariance.nrows();
        let total = |state: usize| (state..n).step_by(p).map(|i| covariance[(i, i)]).sum::<f64>();
        (0..n).map(|i| total(i % p)).map(|total| if total > 0.0 { total.sqrt() } else { 1.0 }).collect()
    }

    /// Posterior means of the groups of the innermost level, in η.
    fn means(&self, point: &Point) -> Vec<Vec<f64>> {
        let regressors = &self.problem.mean.regressors;
        let found = level_posteriors(self.units, (point, regressors), None, false);
        found.groups.into_iter().next().unwrap_or_default().into_iter().map(|group| group.mean).collect()
    }
}
