//! What a fitted model says of tests, all of them together.

use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::apply::{Joint, Said, Verdict};
use crate::ensemble::{Group, Grouping, Labels};
use crate::infer::GroupPosterior;
use crate::model::PhasedModel;
use crate::record::holm;
use crate::reduce::PhasedTest;

/// A fitted model applied to tests. Nothing of it was estimated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AppliedRecord {
    /// Title of the model.
    pub title: String,
    /// What the parameters were taken from, as named by the user.
    pub from: String,
    /// Number of tests.
    pub tests: usize,
    /// Values measured.
    pub observations: usize,
    /// Log density of all that was measured.
    pub log_density: f64,
    /// Initial states against the population.
    pub distance: JointRecord,
    /// What the sum is over: `test`, or the outermost level of groups.
    pub of: String,
    /// Of tests in groups: how far those of one group of the outermost level are from each other.
    pub within: Option<JointRecord>,
    /// How many tests, or groups of the outermost level, the population was estimated from; null where it was given.
    pub fitted: Option<usize>,
    /// Number of its states.
    pub states: usize,
    /// Parameters that were given other values.
    pub changed: Vec<String>,
    /// What measured values are off the model whatever the initial states are: squares of the innovations less the tests' own distances.
    pub residual: JointRecord,
    /// Tests that have a distance.
    pub compared: usize,
    /// Of the test furthest from the population.
    pub furthest: Option<FarRecord>,
    /// Tests that stand out at 5 % after correction for their number, the furthest first.
    pub outlying: Vec<FarRecord>,
    /// Tests whose residuals are larger than the model allows, at 5 % after correction for their number.
    pub unlikely: Vec<FarRecord>,
    /// Groups that stand out at 5 % after correction for the number of groups, the furthest first.
    #[serde(default)]
    pub outlying_groups: Vec<FarGroupRecord>,
}

/// A group of tests that is far out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FarGroupRecord {
    /// Name of its level.
    pub level: String,
    /// Its name after those of the groups that it stands in, the outermost first.
    pub id: Vec<String>,
    /// Number of its tests.
    pub tests: usize,
    /// Standardised squared distance of what its tests say of the group from the population.
    pub squared: f64,
    /// Degrees of freedom of χ².
    pub degrees_of_freedom: usize,
    /// Of this group by itself.
    pub p_value: f64,
    /// After Holm's correction for the number of groups of all levels.
    pub p_corrected: f64,
}

/// A sum of squares over all tests and its law.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct JointRecord {
    /// The sum.
    pub squared: f64,
    /// Degrees of freedom of χ².
    pub degrees_of_freedom: usize,
    /// Two-sided; null without degrees of freedom.
    pub p_value: Option<f64>,
}

/// A test far out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FarRecord {
    /// The test.
    pub test: String,
    /// Its sum of squares.
    pub squared: f64,
    /// Degrees of freedom of χ².
    pub degrees_of_freedom: usize,
    /// Of this test by itself.
    pub p_value: f64,
    /// After Holm's correction for the number of tests.
    pub p_corrected: f64,
}

/// Where the parameters came from.
#[derive(Debug, Clone)]
pub struct AppliedSource {
    /// As named by the user.
    pub name: String,
    /// How many tests, or groups of the outermost level, the population was estimated from, where that is known.
    pub fitted: Option<usize>,
    /// Parameters that were given other values.
    pub changed: Vec<String>,
}

/// 5 %.
const LEVEL: f64 = 0.05;

impl From<Joint> for JointRecord {
    fn from(Joint { squared, degrees_of_freedom, p_value }: Joint) -> JointRecord {
        JointRecord { squared, degrees_of_freedom, p_value }
    }
}

impl AppliedRecord {
    /// Of tests and what they say, with parameters from a source. `groups`: which tests stand in one group, and the names.
    pub fn new(
        model: &PhasedModel,
        source: AppliedSource,
        (tests, groups): (&[PhasedTest], Option<(&Grouping, &Labels)>),
        said: &Said,
    ) -> AppliedRecord {
        let Verdict { log_density, distance, within, residual } = said.verdict();
        let distances = said.posteriors.iter().map(|test| &test.distance);
        let distances = distances.map(|own| (own.squared, own.degrees_of_freedom, own.p_value));
        let far = ranked(tests, distances);
        let seen = said.innovations.iter().flatten().map(|own| own.summary.count).sum();
        let residuals = (0..tests.len()).map(|test| {
            let (squared, degrees) = said.residuals[test].unwrap_or_default();
            (squared, degrees, ChiSquared::new(degrees as f64).ok().map(|law| law.sf(squared)))
        });
        let stands_out = |one: &FarRecord| one.p_corrected < LEVEL;
        AppliedRecord {
            title: model.shared().title.clone(),
            fitted: source.fitted,
            states: model.dimension(),
            from: source.name,
            changed: source.changed,
            within: within.map(JointRecord::from),
            compared: far.len(),
            tests: tests.len(),
            observations: seen,
            log_density,
            distance: distance.into(),
            of: model.levels.first().map_or("test", |level| level.name.as_str()).to_owned(),
            residual: residual.into(),
            outlying: far.iter().take_while(|one| stands_out(one)).cloned().collect(),
            furthest: far.into_iter().next(),
            unlikely: ranked(tests, residuals).into_iter().take_while(stands_out).collect(),
            outlying_groups: groups.map_or_else(Vec::new, |groups| outlying_groups(model, groups, said)),
        }
    }
}

/// Groups of all levels that stand out.
fn outlying_groups(model: &PhasedModel, (grouping, labels): (&Grouping, &Labels), said: &Said) -> Vec<FarGroupRecord> {
    let of_level = |(inner, found): (usize, &Vec<GroupPosterior>)| {
        let level = &model.levels[model.levels.len() - 1 - inner].name;
        let one = |(group, found): (&Group, &GroupPosterior)| {
            let p_value = found.distance.p_value?;
            Some(FarGroupRecord {
                level: level.clone(),
                id: group.path.iter().map(|&name| labels.text(name).to_owned()).collect(),
                tests: found.tests,
                squared: found.distance.squared,
                degrees_of_freedom: found.distance.degrees_of_freedom,
                p_value,
                p_corrected: p_value,
            })
        };
        grouping.groups(inner).iter().zip(found).filter_map(one).collect::<Vec<_>>()
    };
    let mut all: Vec<FarGroupRecord> = said.groups.iter().enumerate().flat_map(of_level).collect();
    all.sort_by(|a, b| a.p_value.total_cmp(&b.p_value).then_with(|| a.id.cmp(&b.id)));
    let p_values: Vec<f64> = all.iter().map(|one| one.p_value).collect();
    all.iter_mut().zip(holm(&p_values)).for_each(|(one, corrected)| one.p_corrected = corrected);
    all.retain(|one| one.p_corrected < LEVEL);
    all
}

impl AppliedRecord {
    /// How many times as large the sum of distances is on average, as the population was estimated: (1 + 1/N) N / (N - p - 2) of p states that
    /// N tests tell well. 1 where it was given, infinite where N is too small.
    pub fn inflation(&self) -> f64 {
        let Some(number) = self.fitted else { return 1.0 };
        let left = number as f64 - self.states as f64 - 2.0;
        if left > 0.0 { (number as f64 + 1.0) / left } else { f64::INFINITY }
    }

    /// Whether the distances are more than chance and the estimated population allow at this level: how much larger they are differs from fit to
    /// fit, so that twice the average excess is allowed for.
    pub fn is_outside(&self, level: f64) -> bool {
        let most = 1.0 + 2.0 * (self.inflation() - 1.0);
        let below = |p: Option<f64>| p.is_some_and(|p| p < level);
        let JointRecord { squared, degrees_of_freedom, p_value } = self.distance;
        let expected = degrees_of_freedom as f64;
        let allowed = squared / most;
        let beyond = allowed > expected && below(Joint::new(allowed, degrees_of_freedom).p_value);
        below(p_value) && (squared < expected || beyond)
    }
}

/// Tests from the least probable on, with Holm's correction.
fn ranked(tests: &[PhasedTest], squares: impl Iterator<Item = (f64, usize, Option<f64>)>) -> Vec<FarRecord> {
    let one = |(test, (squared, degrees_of_freedom, p_value)): (&PhasedTest, (f64, usize, Option<f64>))| {
        let p_value = p_value?;
        Some(FarRecord { test: test.id.clone(), squared, degrees_of_freedom, p_value, p_corrected: p_value })
    };
    let mut all: Vec<FarRecord> = tests.iter().zip(squares).filter_map(one).collect();
    all.sort_by(|a, b| a.p_value.total_cmp(&b.p_value).then_with(|| a.test.cmp(&b.test)));
    let p_values: Vec<f64> = all.iter().map(|one| one.p_value).collect();
    all.iter_mut().zip(holm(&p_values)).for_each(|(one, corrected)| one.p_corrected = corrected);
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(squared: f64, fitted: Option<usize>) -> AppliedRecord {
        AppliedRecord {
            title: String::new(),
            from: "fit.json".to_owned(),
            tests: 200,
            observations: 0,
            log_density: 0.0,
            distance: Joint::new(squared, 800).into(),
            of: "test".to_owned(),
            within: None,
            fitted,
            states: 4,
            changed: Vec::new(),
            residual: Joint::new(0.0, 0).into(),
            compared: 0,
            furthest: None,
            outlying: Vec::new(),
            unlikely: Vec::new(),
            outlying_groups: Vec::new(),
        }
    }

    #[test]
    fn a_population_that_was_estimated_from_few_tests_is_allowed_for() {
        // sums of 200 tests of the population itself, of which 20 were fitted: on average 1.5 times what is expected
        assert!((of(800.0, Some(20)).inflation() - 1.5).abs() < 1e-15);
        for squared in [887.0, 1004.0, 1404.0, 1386.0, 904.0, 1262.0, 1227.0, 1143.0] {
            assert!(!of(squared, Some(20)).is_outside(0.01), "{squared}");
            assert_eq!(of(squared, None).is_outside(0.01), squared > 905.0, "{squared}");
        }
        assert!(of(2000.0, Some(20)).is_outside(0.01) && of(500.0, Some(20)).is_outside(0.01));
        assert!(!of(1e6, Some(5)).is_outside(0.01), "five tests do not tell what four states are like");
    }
}
