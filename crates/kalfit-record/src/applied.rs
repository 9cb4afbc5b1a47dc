//! Results of a fitted model applied to tests, all of them together.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

use crate::{FitRecord, holm};
use kalfit_apply::apply::{Joint, Law, Laws, Said, Verdict};
use kalfit_infer::{GroupPosterior, Posterior};
use kalfit_model::PhasedModel;
use kalfit_model::PhasedTest;
use kalfit_model::{Group, Grouping, Labels};

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
    /// Where tests stand in groups: how far the tests of one outermost group are from each other.
    pub within: Option<JointRecord>,
    /// How many tests, or groups of the outermost level, the population was estimated from; null where it was given.
    pub fitted: Option<usize>,
    /// What laws and p-values allow for.
    pub basis: Basis,
    /// How many of the tests are among those that the parameters were estimated from.
    pub own: usize,
    /// Variances and noise levels that were estimated as zero: they count as zero.
    pub at_zero: Vec<String>,
    /// Number of estimated states.
    pub states: usize,
    /// Parameters that were given other values.
    pub changed: Vec<String>,
    /// How far measured values are off the model whatever the initial states are: squares of the innovations less the
    /// squared distances of the tests.
    pub residual: JointRecord,
    /// Tests that have a distance.
    pub compared: usize,
    /// The test furthest from the population.
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
    /// Name of the group, after those of the groups that contain it, the outermost first.
    pub id: Vec<String>,
    /// Number of its tests.
    pub tests: usize,
    /// Standardised squared distance of the group, as its tests estimate it, from the population.
    pub squared: f64,
    /// Degrees of freedom of χ².
    pub degrees_of_freedom: usize,
    /// p-value of this group by itself.
    pub p_value: f64,
    /// p-value after Holm's correction for the number of groups of all levels.
    pub p_corrected: f64,
}

/// What the laws of distances and residuals allow for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Basis {
    /// Nothing: the parameters were given.
    Given,
    /// The errors of all estimates.
    Estimates,
    /// The errors of μ and Σ; not those of dynamic parameters, because tests are given by reductions or estimates that
    /// were made at these parameters' values.
    Population,
    /// The number of tests that the population was estimated from: the fit does not contain the errors of its
    /// estimates.
    Tests,
    /// Nothing: the tests are those that the parameters were estimated from.
    OwnTests,
    /// Nothing, although the parameters were estimated: groups of the tests cross.
    Crossed,
}

/// A sum of squares over all tests and its law.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct JointRecord {
    /// Sum of the squares.
    pub squared: f64,
    /// Degrees of freedom: the expected sum at known parameters.
    pub degrees_of_freedom: usize,
    /// Law of the sum; null without degrees of freedom, and where it is not known.
    pub law: Option<LawRecord>,
    /// Two-sided p-value; null without a law.
    pub p_value: Option<f64>,
}

/// A multiple of Fisher's F, or of χ².
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LawRecord {
    /// Mean; null where there is none.
    pub expected: Option<f64>,
    /// Standard deviation; null where there is none.
    pub std_dev: Option<f64>,
    /// Degrees of freedom; for F those of the numerator.
    pub degrees_of_freedom: f64,
    /// Degrees of freedom of the denominator of F; null for χ².
    pub denominator: Option<f64>,
}

/// A test far out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FarRecord {
    /// Id of the test.
    pub test: String,
    /// Sum of squares of the test.
    pub squared: f64,
    /// Degrees of freedom of χ².
    pub degrees_of_freedom: usize,
    /// p-value of this test by itself.
    pub p_value: f64,
    /// p-value after Holm's correction for the number of tests.
    pub p_corrected: f64,
}

/// Origin of the parameters, and facts about the fit.
#[derive(Debug, Clone)]
pub struct AppliedSource {
    /// Origin, as named by the user.
    pub name: String,
    /// Number of tests, or groups of the outermost level, that the population was estimated from; `None` where unknown.
    pub fitted: Option<usize>,
    /// Parameters that were given other values.
    pub changed: Vec<String>,
    /// What the laws allow for.
    pub basis: Basis,
    /// Number of applied tests that the parameters were also estimated from.
    pub own: usize,
    /// Variances and noise levels that were estimated as zero.
    pub at_zero: Vec<String>,
}

/// Significance level, after correction for the number of tests or groups.
const SIGNIFICANCE: f64 = 0.05;

impl From<Joint> for JointRecord {
    fn from(Joint { squared, degrees_of_freedom, law, p_value }: Joint) -> JointRecord {
        JointRecord { squared, degrees_of_freedom, law: law.map(LawRecord::from), p_value }
    }
}

impl From<Law> for LawRecord {
    fn from(law: Law) -> LawRecord {
        let finite = |x: f64| x.is_finite().then_some(x);
        LawRecord {
            expected: finite(law.mean()),
            std_dev: finite(law.std_dev()),
            degrees_of_freedom: law.numerator,
            denominator: finite(law.denominator),
        }
    }
}

impl FitRecord {
    /// Number of `tests` that the fit was also made from, by id and log density; all or none for a fit that does not
    /// list tests.
    pub fn own_tests(&self, tests: &[PhasedTest], said: &Said) -> usize {
        /// Relative difference between computations of one log density on two machines.
        const DENSITY_TOLERANCE: f64 = 1e-9;
        let is_same = |a: f64, b: f64| (a - b).abs() <= DENSITY_TOLERANCE * (1.0 + a.abs());
        if self.tests.is_empty() {
            let all: f64 = said.log_density();
            let is_own = self.data.tests == tests.len() && is_same(self.log_likelihood, all);
            return if is_own { tests.len() } else { 0 };
        }
        let of: HashMap<&str, f64> = self.tests.iter().map(|test| (test.id, test.log_likelihood)).collect();
        let is_own = |(test, own): (&PhasedTest, Posterior<'_>)| {
            of.get(test.id.as_str()).is_some_and(|fitted| is_same(*fitted, own.log_likelihood))
        };
        tests.iter().zip(said.posteriors.iter()).filter(|&both| is_own(both)).count()
    }
}

impl AppliedRecord {
    /// Record of the results of tests, with parameters from `source`. `groups`: grouping of the tests, and names of the
    /// groups.
    pub fn new(
        model: &PhasedModel,
        source: AppliedSource,
        (tests, groups): (&[PhasedTest], Option<(&Grouping, &Labels)>),
        (said, laws): (&Said, &Laws),
    ) -> AppliedRecord {
        let Verdict { log_density, distance, within, residual } = said.verdict(laws);
        let distances = said.posteriors.iter().map(|test| test.distance).zip(&laws.tests);
        let distances = distances.map(|(own, law)| (own.squared, own.degrees_of_freedom, above(*law, own.squared)));
        let far = ranked(tests, distances);
        let seen = said.innovations.iter().flatten().map(|own| own.summary.count).sum();
        let residuals = (0..tests.len()).map(|test| {
            let (squared, degrees) = said.residuals[test].unwrap_or_default();
            (squared, degrees, above(laws.residuals[test], squared))
        });
        let stands_out = |one: &FarRecord| one.p_corrected < SIGNIFICANCE;
        AppliedRecord {
            title: model.shared().title.clone(),
            fitted: source.fitted,
            basis: source.basis,
            own: source.own,
            at_zero: source.at_zero,
            states: model.dimension(),
            from: source.name,
            changed: source.changed,
            within: within.map(JointRecord::from),
            compared: far.len(),
            tests: tests.len(),
            observations: seen,
            log_density,
            distance: distance.into(),
            of: match model.levels.first() {
                Some(level) if !level.crossed => level.name.clone(),
                _ => "test".to_owned(),
            },
            residual: residual.into(),
            outlying: far.iter().take_while(|one| stands_out(one)).cloned().collect(),
            furthest: far.into_iter().next(),
            unlikely: ranked(tests, residuals).into_iter().take_while(stands_out).collect(),
            outlying_groups: groups.map_or_else(Vec::new, |groups| outlying_groups(model, groups, (said, laws))),
        }
    }
}

/// Probability of a larger sum of squares.
fn above(law: Option<Law>, squared: f64) -> Option<f64> {
    law?.tails(squared).map(|[_, above]| above)
}

/// Groups of all levels that stand out at `SIGNIFICANCE`.
fn outlying_groups(
    model: &PhasedModel,
    (grouping, labels): (&Grouping, &Labels),
    (said, laws): (&Said, &Laws),
) -> Vec<FarGroupRecord> {
    let of_level = |(inner, found): (usize, &Vec<GroupPosterior>)| {
        let level = &model.levels[model.levels.len() - 1 - inner].name;
        let one = |((group, found), law): ((&Group, &GroupPosterior), &Option<Law>)| {
            let p_value = above(*law, found.distance.squared)?;
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
        grouping.groups(inner).iter().zip(found).zip(&laws.groups[inner]).filter_map(one).collect::<Vec<_>>()
    };
    let mut all: Vec<FarGroupRecord> = said.groups.iter().enumerate().flat_map(of_level).collect();
    all.sort_by(|a, b| a.p_value.total_cmp(&b.p_value).then_with(|| a.id.cmp(&b.id)));
    let p_values: Vec<f64> = all.iter().map(|one| one.p_value).collect();
    all.iter_mut().zip(holm(&p_values, p_values.len())).for_each(|(one, corrected)| one.p_corrected = corrected);
    all.retain(|one| one.p_corrected < SIGNIFICANCE);
    all
}

/// Tests in order of p-value, with Holm's correction.
fn ranked(tests: &[PhasedTest], squares: impl Iterator<Item = (f64, usize, Option<f64>)>) -> Vec<FarRecord> {
    let one = |(test, (squared, degrees_of_freedom, p_value)): (&PhasedTest, (f64, usize, Option<f64>))| {
        let p_value = p_value?;
        Some(FarRecord { test: test.id.to_string(), squared, degrees_of_freedom, p_value, p_corrected: p_value })
    };
    let mut all: Vec<FarRecord> = tests.iter().zip(squares).filter_map(one).collect();
    all.sort_by(|a, b| a.p_value.total_cmp(&b.p_value).then_with(|| a.test.cmp(&b.test)));
    let p_values: Vec<f64> = all.iter().map(|one| one.p_value).collect();
    all.iter_mut().zip(holm(&p_values, p_values.len())).for_each(|(one, corrected)| one.p_corrected = corrected);
    all
}
