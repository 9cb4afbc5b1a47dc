//! Tests in groups (theory §11): posteriors and distances of tests and of groups, and the fit without each test and
//! each group.

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::deletion::{Deletion, search_without};
use crate::posterior::distance;
use crate::posteriors::{Distance, Posteriors};
use crate::progress::SharedProgress;
use kalfit_algebra::symmetric;
use kalfit_estimate::Order;
use kalfit_estimate::{Estimate, LevelPosteriors, Point, Problem, TestPosterior, Units, level_posteriors};
use kalfit_filter::reduce::Reductions;

/// The fit without each test, or without each group of a level.
type Deletions = Vec<Option<Deletion>>;

/// Results of one group.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupPosterior {
    /// log p of all measurements of the group's tests, without other groups.
    pub log_likelihood: f64,
    /// E[m | z] of the mean m of the group's members, without regressions (p).
    pub mean: Vec<f64>,
    /// Var[m | z] (p × p).
    pub covariance: DMatrix<f64>,
    /// Distance of the group from the population.
    pub distance: Distance,
    /// Squared distance of the group's tests and inner groups from each other: χ² with (sum of the degrees of freedom
    /// of the tests' distances) - (degrees of freedom of `distance`) degrees of freedom.
    pub within: f64,
    /// Number of tests in the group.
    pub tests: usize,
    /// d`mean` / d(μ, regression coefficients) (p × (p + coefficients)); `None` without regressions
    /// where groups differ in every direction.
    pub follows: Option<DMatrix<f64>>,
    /// d`mean` / d(estimates), in the order of the covariance of all estimates (p × estimates), with zeros for estimates
    /// that are no elements of Σ; `None` where it was not computed.
    pub by_estimates: Option<DMatrix<f64>>,
    /// Covariance of m, or of the effect of a level, with the effects of levels of crossed factors; of a level only with
    /// those before it. Empty without factors, and where these are too many.
    pub with_effects: Vec<EffectCovariance>,
}

/// Posterior covariance with the effect of a level of a crossed factor.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectCovariance {
    /// Level of the grouping of the factor.
    pub level: usize,
    /// Index of the group among those of that level.
    pub group: usize,
    /// Cov[m, effect | z] (p × p).
    pub covariance: DMatrix<f64>,
}

/// Eigenvalue of a correlation matrix below which a direction does not vary: rounding errors of sums of squares are a
/// millionth of this, and to treat a direction as one that varies little costs no more than a second solution.
const LEAST_EIGENVALUE: f64 = 1e-9;

/// Tests in groups; `evidence`: reductions in the per-test effect and the effects of the test's groups.
struct GroupedTests<'a> {
    problem: &'a Problem,
    evidence: &'a Reductions,
    units: &'a Units,
}

impl GroupedTests<'_> {
    fn at(&self, point: &Point) -> LevelPosteriors {
        let constants: Vec<f64> = self.evidence.iter().map(|reduction| reduction.constant).collect();
        let regressors = &self.problem.mean.regressors;
        let follow = !regressors.is_empty() || self.units.grouping.is_crossed() || self.leaves_directions(point);
        level_posteriors(self.units, (point, regressors), Some(&constants), follow)
    }

    /// Whether groups do not differ in some direction. How the mean of a group follows μ is then not to be seen from
    /// the posterior covariance alone: a state that is the same in all groups may stand for a part of what they measure.
    fn leaves_directions(&self, point: &Point) -> bool {
        let p = self.units.states;
        let blocks = (p..point.root.nrows()).step_by(p).map(|start| point.root.rows(start, p));
        let sum = blocks.fold(DMatrix::zeros(p, p), |sum, root| sum + root * root.transpose());
        sum.diagonal().iter().any(|x| *x == 0.0) || symmetric::scaled_range(&sum).0 < LEAST_EIGENVALUE
    }

    /// A covariance in the user's units (p × p), from one in η by rows.
    fn covariance(&self, numbers: &[f64]) -> DMatrix<f64> {
        let (p, scale) = (self.units.states, &self.problem.classes.frame.scale);
        symmetric::scaled(&scale[..p], |i, k| numbers[i * p + k])
    }

    /// The mean of a group at covariate zero, in the user's units, from that at the average of centred covariates.
    fn mean(&self, centred: &[f64], point: &Point) -> Vec<f64> {
        let mut coordinates = [centred, &point.coefficients].concat();
        self.problem.mean.centring.of_first(self.units.states).uncentre(&mut coordinates);
        self.problem.classes.frame.mean_out(&coordinates[..self.units.states])
    }

    /// d(group mean) / d(μ, regression coefficients) in the user's units, from the same by centred coordinates by rows;
    /// `None` where `numbers` is empty.
    fn follows(&self, numbers: &[f64]) -> Option<DMatrix<f64>> {
        let (p, regressors) = (self.units.states, self.problem.mean.regressors.len());
        let units = self.problem.mean_units();
        let of: Vec<f64> = units[..p].iter().chain(&units[units.len() - regressors..]).copied().collect();
        let centring = self.problem.mean.centring.of_first(p);
        let row = |numbers: &[f64]| {
            let mut row = numbers.to_vec();
            centring.derivatives(&mut row);
            row
        };
        let mut rows: Vec<Vec<f64>> = numbers.chunks_exact(of.len()).map(row).collect();
        for c in 0..of.len() {
            // the mean at covariate zero follows the coefficient itself, too
            let mut direction = vec![0.0; of.len()];
            direction[c] = f64::from(u8::from(c >= p));
            centring.uncentre(&mut direction);
            rows.iter_mut().enumerate().for_each(|(i, row)| row[c] += direction[i]);
        }
        (!numbers.is_empty()).then(|| DMatrix::from_fn(p, of.len(), |i, c| rows[i][c] * units[i] / of[c]))
    }

    fn with_effect(&self, found: &kalfit_estimate::ScaledEffectCovariance) -> EffectCovariance {
        let (p, scale) = (self.units.states, &self.problem.classes.frame.scale);
        let covariance = DMatrix::from_fn(p, p, |i, k| found.covariance[i * p + k] * scale[i] * scale[k]);
        EffectCovariance { level: found.level, group: found.group, covariance }
    }

    fn group(&self, found: &kalfit_estimate::ScaledGroupPosterior, tests: usize, point: &Point) -> GroupPosterior {
        GroupPosterior {
            log_likelihood: found.log_density,
            mean: self.mean(&found.mean, point),
            covariance: self.covariance(&found.covariance),
            distance: Distance::new(found.squared, found.degrees_of_freedom),
            within: found.within,
            tests,
            follows: self.follows(&found.follows),
            by_estimates: None,
            with_effects: found.with_effects.iter().map(|one| self.with_effect(one)).collect(),
        }
    }
}

/// Posteriors of all tests, in the order of the reductions, and of the groups of each level from the innermost on;
/// `None` without groups. The likelihood and distance of a test do not depend on the other tests of the group.
pub(super) fn posteriors(
    problem: &Problem,
    point: &Point,
    evidence: &Reductions,
) -> Option<(Posteriors, Vec<Vec<GroupPosterior>>)> {
    problem.classes.units.as_ref()?;
    let classes = problem.classes.of(evidence);
    let grouped_tests = GroupedTests { problem, evidence, units: classes.units.as_ref()? };
    let found = grouped_tests.at(point);
    let grouping = &grouped_tests.units.grouping;
    let alone = problem.marginal(point);
    let own: Vec<(f64, Distance)> =
        (0..evidence.len()).into_par_iter().map(|j| distance(problem, &alone, evidence, j)).collect();
    let mut tests = Posteriors::new(vec![grouped_tests.units.states]);
    for (j, own) in own.into_iter().enumerate() {
        let number = grouping.number(evidence.id(j)).expect("it was grouped");
        let TestPosterior { mean, covariance, .. } = &found.tests[number];
        let covariance = grouped_tests.covariance(covariance);
        tests.push(own, &problem.classes.frame.mean_out(mean), covariance.as_slice());
    }
    let of_level = |(level, groups): (usize, &Vec<kalfit_estimate::ScaledGroupPosterior>)| {
        groups
            .iter()
            .zip(grouping.groups(level))
            .map(|(one, group)| grouped_tests.group(one, group.tests, point))
            .collect()
    };
    Some((tests, found.groups.iter().enumerate().map(of_level).collect()))
}

/// The fit without each test, in the order of the reductions, and without each group of each level from the innermost
/// on. An entry is `None` where there are no other tests, or no certified optimum of the other tests; the result is
/// `None` once `progress` stops.
pub(super) fn deletions(
    estimate: &Estimate,
    evidence: &Reductions,
    progress: &SharedProgress<'_>,
) -> Option<(Deletions, Vec<Deletions>)> {
    let problem = &estimate.state.problem;
    let classes = problem.classes.of(evidence);
    let grouped_tests = GroupedTests { problem, evidence, units: classes.units.as_ref()? };
    let whole = problem.likelihood(&estimate.state.newton_iterate.point, Order::First).value;
    let tests = progress.each(evidence.len(), |j| {
        let (point, found) = grouped_tests.without(estimate, &[j], whole)?;
        let (_, distance) = distance(problem, &problem.marginal(&point), evidence, j);
        Some(Deletion { distance, ..found })
    })?;
    let grouping = &grouped_tests.units.grouping;
    let of_level = |level: usize| -> Option<Deletions> {
        let mut members = vec![Vec::new(); grouping.groups(level).len()];
        for j in 0..evidence.len() {
            let number = grouping.number(evidence.id(j)).expect("it was grouped");
            grouping.groups_of(number, level).into_iter().for_each(|group| members[group].push(j));
        }
        let without = |group: usize| {
            let (point, found) = grouped_tests.without(estimate, &members[group], whole)?;
            let own = &grouped_tests.at(&point).groups[level][group];
            Some(Deletion { distance: Distance::new(own.squared, own.degrees_of_freedom), ..found })
        };
        progress.each(members.len(), without)
    };
    Some((tests, (0..grouping.depth()).map(of_level).collect::<Option<_>>()?))
}

impl GroupedTests<'_> {
    /// The optimum without the `removed` tests, and the fit; the `distance` of the fit is a placeholder.
    fn without(&self, estimate: &Estimate, removed: &[usize], whole: f64) -> Option<(Point, Deletion)> {
        let problem = self.problem;
        let (point, others) = search_without(estimate, self.evidence, removed)?;
        let displaced_likelihood = problem.likelihood(&point, Order::First).value;
        let of_others =
            Problem::within(&others, &estimate.state.structure(), problem).ok()?.likelihood(&point, Order::First).value;
        let deletion = Deletion {
            estimate: problem.values_of(&point),
            log_density: displaced_likelihood - of_others,
            distance: Distance::new(0.0, 0),
            displacement: (2.0 * (whole - displaced_likelihood)).max(0.0),
        };
        Some((point, deletion))
    }
}
