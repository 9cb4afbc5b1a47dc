//! The posterior of ξ of every test, and of the mean of every group, given all tests of its unit (theory §11).

use rayon::prelude::*;

use crate::levels::batch_data::BatchData;
use crate::levels::crossed;
use crate::levels::design::{UnitDesign, UnitMembers};
use crate::levels::units::Units;
use crate::levels::walk::{GroupMean, LevelLaws, PassResults};
use crate::point::{Point, Regressors};
use kalfit_algebra::rows::Rows;

/// Posteriors of every test and group of an ensemble, in η.
#[derive(Debug, Clone)]
pub struct LevelPosteriors {
    /// Posterior of each test, in the order of the tests in the grouping.
    pub tests: Vec<TestPosterior>,
    /// Posterior of each group, level by level from the innermost level on, in the order of the groups in the grouping.
    pub groups: Vec<Vec<ScaledGroupPosterior>>,
}

/// Posterior of ξ of a test given all tests of its unit.
#[derive(Debug, Clone, Default)]
pub struct TestPosterior {
    /// Posterior mean of ξ (p).
    pub mean: Vec<f64>,
    /// V, p × p by rows.
    pub covariance: Vec<f64>,
    /// d(posterior mean) / d(mean coordinates), p × coordinates by rows; empty unless requested.
    pub(crate) moved: Vec<f64>,
}

/// Posterior of the mean of the members of a group given all tests of the unit, and the distance of the group, without
/// the rest of the unit, from the population.
#[derive(Debug, Clone, Default)]
pub struct ScaledGroupPosterior {
    /// Posterior mean of the mean of the members (p).
    pub mean: Vec<f64>,
    /// V, p × p by rows.
    pub covariance: Vec<f64>,
    /// (y - Jμ)'(J + JΣJ)⁺(y - Jμ) for the mean of the group, with Σ the sum of the Σ of the group's level and of the
    /// levels above.
    pub squared: f64,
    /// Rank of J, the information of the group's tests on the group's mean.
    pub degrees_of_freedom: usize,
    /// Squared distance of the group's tests and inner groups from each other: the quadratic form of all tests in the
    /// group minus `squared`.
    pub within: f64,
    /// log p of the measurements of all tests in the group, without the rest of the unit.
    pub log_density: f64,
    /// d(posterior mean) / d(mean coordinates), p × coordinates by rows; empty unless requested.
    pub follows: Vec<f64>,
    /// Covariance with the effects of levels of crossed factors, of a level only with those before it; empty unless
    /// requested, and where these are too many.
    pub with_effects: Vec<ScaledEffectCovariance>,
}

/// Posterior covariance of the mean of a group with the effect of a level of a crossed factor.
#[derive(Debug, Clone)]
pub struct ScaledEffectCovariance {
    /// Level of the grouping of the factor.
    pub level: usize,
    /// Index of the group among those of that level.
    pub group: usize,
    /// p × p by rows.
    pub covariance: Vec<f64>,
}

/// Posterior of a test, with the index of the reduction, or of a group, with the level and the index in the level.
pub(super) enum MemberId {
    Test(usize, TestPosterior),
    Group(usize, usize, ScaledGroupPosterior),
}

/// The posteriors of all tests and groups at a point. `constants`: the constants of the reductions, which log densities
/// otherwise lack; `coordinates`: whether derivatives by the mean coordinates are computed.
pub fn posteriors(
    units: &Units,
    (point, regressors): (&Point, &Regressors),
    constants: Option<&[f64]>,
    coordinates: bool,
) -> LevelPosteriors {
    if let Some(crossing) = &units.crossing {
        return crossed::posteriors((units, crossing), (point, regressors), constants, coordinates);
    }
    let none;
    let constants = match constants {
        Some(constants) => constants,
        None => {
            none = vec![0.0; units.numbers.len()];
            &none
        }
    };
    let at = LevelLaws::new(units, point, regressors);
    let upper_roots = UpperRoots::new(&at);
    let of_design = |design: &UnitDesign| -> Vec<MemberId> {
        let batch = BatchData::equal_designs(units, design, 0..design.units.len());
        let results = at.results(&batch, coordinates);
        let all = (design.units.as_slice(), &batch, &results);
        let tests = (0..design.tests.len()).flat_map(|t| of_test(&at, all, t));
        tests.chain((0..design.groups.len()).flat_map(|g| of_group((&at, &upper_roots), all, (g, constants)))).collect()
    };
    let found: Vec<Vec<MemberId>> = units.designs.par_iter().map(of_design).collect();
    LevelPosteriors::gathered(units, found)
}

impl LevelPosteriors {
    /// The posteriors that were found of all tests and groups, in the order of the grouping.
    pub(super) fn gathered(units: &Units, found: Vec<Vec<MemberId>>) -> LevelPosteriors {
        let empty = |level: usize| vec![ScaledGroupPosterior::default(); units.grouping.groups(level).len()];
        let mut all = LevelPosteriors {
            tests: vec![TestPosterior::default(); units.grouping.tests()],
            groups: (0..units.grouping.depth()).map(empty).collect(),
        };
        for one in found.into_iter().flatten() {
            match one {
                MemberId::Test(number, posterior) => all.tests[units.numbers[number]] = posterior,
                MemberId::Group(level, number, posterior) => all.groups[level - 1][number] = posterior,
            }
        }
        all
    }
}

/// Units of one design: members, data, and results of the upward and downward pass.
type EqualUnits<'a> = (&'a [UnitMembers], &'a BatchData<'a, f64>, &'a PassResults<f64>);

fn of_test(at: &LevelLaws<'_>, (units, batch, results): EqualUnits<'_>, t: usize) -> Vec<MemberId> {
    let (member, down) = (batch.tests[t], &results.tests[t]);
    let weight = &results.leaves[member.leaf].W;
    let mean = GroupMean::of((weight, &down.r), &at.sigmas[0], Some(&results.means[member.group]));
    let leaf = &batch.leaves[member.leaf];
    let centre = at.mean_of(leaf);
    let p = centre.len();
    // a unit step of a mean coordinate moves the prior mean of ξ by the coordinate's effect, and lowers d - Rμ by R
    // times the effect
    let moved: Vec<f64> = (0..p)
        .flat_map(|i| (0..results.before).map(move |c| (i, c)))
        .map(|(i, c)| at.effect(leaf, i, c) - mean.mean[(i, c)])
        .collect();
    let one = |(unit, numbers): (usize, &UnitMembers)| {
        let own = |i: usize| centre[i] + mean.mean[(i, results.before + unit)];
        let covariance = mean.covariance.as_slice().to_vec();
        MemberId::Test(
            numbers.tests[t],
            TestPosterior { mean: (0..p).map(own).collect(), covariance, moved: moved.clone() },
        )
    };
    units.iter().enumerate().map(one).collect()
}

/// For each level a root F' of the sum of the Σ of that level and the levels above.
struct UpperRoots(Vec<Rows>);

impl UpperRoots {
    fn new(at: &LevelLaws<'_>) -> UpperRoots {
        let of = |level: usize| {
            let mut root = Rows::zeros(0, at.mean.len());
            at.roots[level..].iter().for_each(|one| root.append(one));
            root
        };
        UpperRoots((0..at.roots.len()).map(of).collect())
    }
}

fn of_group(
    (at, upper_roots): (&LevelLaws<'_>, &UpperRoots),
    (units, batch, results): EqualUnits<'_>,
    (g, constants): (usize, &[f64]),
) -> Vec<MemberId> {
    let (node, mean, up) = (batch.groups[g], &results.means[g], &results.up[g]);
    let p = at.mean.len();
    let rank = up.rank();
    let (squares, log_det) = up.without_unit(&upper_roots.0[node.level]);
    let within = results.within(batch, g);
    let members: Vec<usize> = (0..batch.tests.len()).filter(|&t| batch.is_within(batch.tests[t].group, g)).collect();
    // a unit step of an element of μ moves the prior mean of the group and lowers d - Rμ; a unit step of a coefficient
    // only lowers d - Rμ
    let follow = |(i, c): (usize, usize)| f64::from(u8::from(i == c)) - mean.mean[(i, c)];
    let follows: Vec<f64> = (0..p).flat_map(|i| (0..results.before).map(move |c| (i, c))).map(follow).collect();
    let one = |(unit, numbers): (usize, &UnitMembers)| {
        let column = results.before + unit;
        let constant: f64 = members.iter().map(|&t| constants[numbers.tests[t]]).sum();
        let squared = squares[column];
        let posterior = ScaledGroupPosterior {
            mean: (0..p).map(|i| at.mean[i] + mean.mean[(i, column)]).collect(),
            covariance: mean.covariance.as_slice().to_vec(),
            squared,
            degrees_of_freedom: rank,
            within: within.1[column],
            log_density: constant - 0.5 * (log_det + within.0 + within.1[column] + squared),
            follows: follows.clone(),
            with_effects: Vec::new(),
        };
        MemberId::Group(node.level, numbers.groups[g], posterior)
    };
    units.iter().enumerate().map(one).collect()
}
