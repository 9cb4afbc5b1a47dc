//! The posterior of ξ of every test, and of the mean of the members of every group and level, given all tests.

use rayon::prelude::*;

use crate::levels::crossed::dense::rows_of;
use crate::levels::crossed::layout::{Crossing, Part, TreeGroup, Unit};
use crate::levels::crossed::respond::{PartAt, Response};
use crate::levels::crossed::totals::{DataColumns, leaves};
use crate::levels::posterior::{
    LevelPosteriors, MemberId, ScaledEffectCovariance, ScaledGroupPosterior, TestPosterior,
};
use crate::levels::units::Units;
use crate::levels::walk::{GroupMean, Integrated, LevelLaws, RANK_TOLERANCE};
use crate::point::{Point, Regressors};
use kalfit_algebra::rows::Rows;
use kalfit_algebra::symmetric;
use nalgebra::{DMatrix, DVector};

/// The posteriors at a point. The mean of the members of a group is μ plus the effects of the group and of the groups
/// around it; that of a level of a factor is μ plus the effect of the level. The distance of a group is r'N⁺r, which is
/// χ² with as many degrees of freedom as N has ranks, given all other tests. `constants`: constants of the reductions;
/// log densities of groups by themselves are computed where they are given.
pub(in crate::levels) fn posteriors(
    (units, crossing): (&Units, &Crossing),
    (point, regressors): (&Point, &Regressors),
    constants: Option<&[f64]>,
    coordinates: bool,
) -> LevelPosteriors {
    let at = LevelLaws::<f64>::new(units, point, regressors);
    let leaves = leaves(units, &at);
    let with_effects = coordinates && crossing.effect_covariances() * units.states.pow(2) <= MOST_WITH_EFFECTS;
    let given = Given { units, crossing, at: &at, leaves: &leaves, constants, coordinates, with_effects };
    let found: Vec<Vec<MemberId>> = crossing.parts.par_iter().map(|part| given.of_part(part)).collect();
    LevelPosteriors::gathered(units, found)
}

struct Given<'a> {
    units: &'a Units,
    crossing: &'a Crossing,
    at: &'a LevelLaws<'a>,
    leaves: &'a [Integrated<f64>],
    constants: Option<&'a [f64]>,
    coordinates: bool,
    with_effects: bool,
}

/// Most covariances of groups with effects that are kept, as numbers: a thousand units on 25 benches with two states
/// have as many, which take some megabytes in a file of results.
const MOST_WITH_EFFECTS: usize = 100_000;

impl Given<'_> {
    fn of_part(&self, part: &Part) -> Vec<MemberId> {
        let before = if self.coordinates { self.at.mean.len() + self.at.regressors.len() } else { 0 };
        let here = PartAt::new(part, self.crossing, self.at, self.leaves);
        let data = DataColumns::of(part, self.units, (self.at, self.leaves), before);
        let response = here.respond(&data.said, before + 1);
        let mut found = Vec::new();
        for number in 0..part.units.len() {
            self.tests(&here, &response, number, &mut found);
            self.groups(&here, &response, number, &mut found);
        }
        let of_level = |level: usize| self.level(&here, &response, level);
        found.extend((0..part.levels.len()).into_par_iter().map(of_level).collect::<Vec<_>>());
        found
    }

    fn tests(&self, here: &PartAt<'_>, response: &Response, number: usize, found: &mut Vec<MemberId>) {
        let (unit, own) = (&here.part.units[number], &response.units[number]);
        let p = here.p;
        let columns = own.tests[0].ncols();
        let moments = here.weights[number].tests.iter().zip(&own.expected);
        for ((test, r), (covariance, expected)) in unit.tests.iter().zip(&own.tests).zip(moments) {
            let above = GroupMean { mean: expected.clone(), covariance: covariance.clone() };
            let leaf = &self.units.leaves[test.leaf];
            let mean = GroupMean::of((&self.leaves[test.leaf].W, r), &self.at.sigmas[0], Some(&above));
            let centre = self.at.mean_of(leaf);
            let moved = |(i, c): (usize, usize)| self.at.effect(leaf, i, c) - mean.mean[(i, c)];
            let moved = (0..p).flat_map(|i| (0..columns - 1).map(move |c| (i, c))).map(moved).collect();
            let posterior = TestPosterior {
                mean: (0..p).map(|i| centre[i] + mean.mean[(i, columns - 1)]).collect(),
                covariance: mean.covariance.as_slice().to_vec(),
                moved,
            };
            found.push(MemberId::Test(test.reduction, posterior));
        }
    }

    fn groups(&self, here: &PartAt<'_>, response: &Response, number: usize, found: &mut Vec<MemberId>) {
        let (unit, own) = (&here.part.units[number], &response.units[number]);
        for (at, group) in unit.groups.iter().enumerate() {
            let Some(block) = self.crossing.block_of(group) else { continue };
            let weights = &here.weights[number].groups[at];
            let alone = self.constants.map_or(0.0, |constants| {
                let part = here.part.only_unit(number).only(&|unit, test| is_within(unit, test, at));
                self.log_density(&part, constants)
            });
            let mut posterior = self.group((&own.means[at], &weights.V), (&own.groups[at], &weights.N), alone);
            if self.with_effects && group.kind == 0 {
                // E[A | b] = α - Γb
                let all = weights.gamma.times(&rows_of(&here.dense.C, unit, here.p));
                let covariance = |level: usize| Rows::from_fn(here.p, here.p, |i, k| -all[(i, level * here.p + k)]);
                posterior.with_effects = self.covariances(here.part, 0..here.part.levels.len(), &covariance);
            }
            found.push(MemberId::Group(block, group.number, posterior));
        }
    }

    fn level(&self, here: &PartAt<'_>, response: &Response, level: usize) -> MemberId {
        let p = here.p;
        let rows = |all: &DMatrix<f64>| Rows::from_fn(p, all.ncols(), |i, c| all[(level * p + i, c)]);
        let covariance = Rows::from_fn(p, p, |i, k| here.dense.C[(level * p + i, level * p + k)]);
        let (factor, group) = here.part.levels[level];
        let alone = self.constants.map_or(0.0, |constants| {
            let meets =
                |unit: &Unit, test: usize| unit.tests[test].members.iter().any(|own| unit.met[own.level] == level);
            self.log_density(&here.part.only(&meets), constants)
        });
        let (mean, r) = (rows(&response.effects), rows(&response.levels));
        let mut posterior = self.group((&mean, &covariance), (&r, &here.dense.weight(level)), alone);
        if self.with_effects {
            let of = |other: usize| Rows::from_fn(p, p, |i, k| here.dense.C[(level * p + i, other * p + k)]);
            posterior.with_effects = self.covariances(here.part, 0..level, &of);
        }
        MemberId::Group(self.crossing.factors[factor], group, posterior)
    }

    /// The covariances with the effects of these levels of a part.
    fn covariances(
        &self,
        part: &Part,
        levels: std::ops::Range<usize>,
        of: &dyn Fn(usize) -> Rows,
    ) -> Vec<ScaledEffectCovariance> {
        let one = |level: usize| {
            let (factor, group) = part.levels[level];
            let covariance = of(level).as_slice().to_vec();
            ScaledEffectCovariance { level: self.crossing.factors[factor] - 1, group, covariance }
        };
        levels.map(one).collect()
    }

    /// The posterior of a group from the effects (p × columns) with their covariance, and from r with N.
    fn group(&self, (mean, covariance): (&Rows, &Rows), (r, n): (&Rows, &Rows), alone: f64) -> ScaledGroupPosterior {
        let (p, last) = (mean.nrows(), mean.ncols() - 1);
        let follow = |(i, c): (usize, usize)| f64::from(u8::from(i == c)) - mean[(i, c)];
        let (squared, degrees_of_freedom) = distance(r, n);
        ScaledGroupPosterior {
            mean: (0..p).map(|i| self.at.mean[i] + mean[(i, last)]).collect(),
            covariance: covariance.as_slice().to_vec(),
            squared,
            degrees_of_freedom,
            within: 0.0,
            log_density: alone,
            with_effects: Vec::new(),
            follows: (0..p).flat_map(|i| (0..last).map(move |c| (i, c))).map(follow).collect(),
        }
    }

    /// log p of the tests of a part by themselves.
    fn log_density(&self, part: &Part, constants: &[f64]) -> f64 {
        let here = PartAt::new(part, self.crossing, self.at, self.leaves);
        let data = DataColumns::of(part, self.units, (self.at, self.leaves), 0);
        let response = here.respond(&data.said, 1);
        let tests = part.units.iter().flat_map(|unit| &unit.tests);
        let constant: f64 = tests.map(|test| constants[test.reduction]).sum();
        let products = here.products(&response, &data.left);
        constant - 0.5 * (here.log_det() + products[(0, 0)])
    }
}

/// r'N⁺r of the last column of r, and the rank of N.
fn distance(r: &Rows, n: &Rows) -> (f64, usize) {
    let (p, last) = (r.nrows(), r.ncols() - 1);
    let (size, values, vectors) =
        symmetric::scaled_eigen(&DMatrix::from_fn(p, p, |i, k| 0.5 * (n[(i, k)] + n[(k, i)])));
    let right = DVector::from_fn(p, |i, _| r[(i, last)] / size[i]);
    let largest = values.last().copied().unwrap_or(0.0);
    let informed = values.iter().enumerate().filter(|(_, value)| **value > RANK_TOLERANCE * largest && **value > 0.0);
    informed.fold((0.0, 0), |(sum, rank), (k, value)| (sum + vectors.column(k).dot(&right).powi(2) / value, rank + 1))
}

/// Whether a test is in a group or in a group inside it.
fn is_within(unit: &Unit, test: usize, group: usize) -> bool {
    let mut at = unit.tests[test].group;
    while at != group && unit.groups[at].parent != at {
        at = unit.groups[at].parent;
    }
    at == group
}

impl Part {
    /// The part with one of its units alone.
    fn only_unit(&self, number: usize) -> Part {
        Part { levels: self.levels.clone(), units: vec![self.units[number].clone()] }
    }

    /// The part with the tests alone for which `keep` holds, and with the groups and levels that these meet.
    fn only(&self, keep: &dyn Fn(&Unit, usize) -> bool) -> Part {
        let units = self.units.iter().filter_map(|unit| unit.only(&|test| keep(unit, test)));
        let mut units: Vec<Unit> = units.collect();
        let mut met: Vec<usize> = units.iter().flat_map(|unit| unit.met.iter().copied()).collect();
        met.sort_unstable();
        met.dedup();
        for unit in &mut units {
            unit.met.iter_mut().for_each(|level| *level = met.binary_search(level).expect("it is met"));
        }
        Part { levels: met.iter().map(|&level| self.levels[level]).collect(), units }
    }
}

impl Unit {
    /// The unit with some of its tests; `None` without any.
    fn only(&self, keep: &dyn Fn(usize) -> bool) -> Option<Unit> {
        let kept: Vec<usize> = (0..self.tests.len()).filter(|&test| keep(test)).collect();
        if kept.is_empty() {
            return None;
        }
        let mut needed = vec![false; self.groups.len()];
        for &test in &kept {
            let mut at = self.tests[test].group;
            while !needed[at] {
                needed[at] = true;
                at = self.groups[at].parent;
            }
        }
        let mut place = vec![0; self.groups.len()];
        let mut count = 0;
        for (at, needed) in needed.iter().enumerate() {
            place[at] = count;
            count += usize::from(*needed);
        }
        let groups = self.groups.iter().zip(&needed).filter(|(_, needed)| **needed);
        let groups = groups.map(|(group, _)| TreeGroup { parent: place[group.parent], ..*group }).collect();
        let mut members: Vec<usize> =
            kept.iter().flat_map(|&test| self.tests[test].members.iter().map(|member| member.level)).collect();
        members.sort_unstable();
        members.dedup();
        let tests = kept.iter().map(|&test| {
            let mut own = self.tests[test].clone();
            own.group = place[own.group];
            let place = |level: usize| members.binary_search(&level).expect("it is a member");
            own.members.iter_mut().for_each(|member| member.level = place(member.level));
            own
        });
        Some(Unit { groups, tests: tests.collect(), met: members.iter().map(|&at| self.met[at]).collect() })
    }
}
