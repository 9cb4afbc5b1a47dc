//! What a fitted model says of tests, all of them together.

use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::apply::{Joint, Said, Verdict};
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
    /// What measured values are off the model whatever the initial states are: squares of the innovations less the tests' own distances.
    pub residual: JointRecord,
    /// Of the test furthest from the population.
    pub furthest: Option<FarRecord>,
    /// Tests that stand out at 5 % after correction for their number, the furthest first.
    pub outlying: Vec<FarRecord>,
    /// Tests whose residuals are larger than the model allows, at 5 % after correction for their number.
    pub unlikely: Vec<FarRecord>,
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

/// 5 %.
const LEVEL: f64 = 0.05;

impl From<Joint> for JointRecord {
    fn from(Joint { squared, degrees_of_freedom, p_value }: Joint) -> JointRecord {
        JointRecord { squared, degrees_of_freedom, p_value }
    }
}

impl AppliedRecord {
    /// Of tests under the model of a title. `outermost`: name of the outermost level of groups.
    pub fn new(title: &str, from: String, tests: &[PhasedTest], said: &Said, outermost: Option<&str>) -> AppliedRecord {
        let Verdict { log_density, distance, residual } = said.verdict();
        let distances = said.posteriors.iter().map(|test| &test.distance);
        let distances = distances.map(|own| (own.squared, own.degrees_of_freedom, own.p_value));
        let far = ranked(tests, distances);
        let seen = said.innovations.iter().flatten().map(|own| own.summary.count).sum();
        let residuals = (0..tests.len()).map(|test| {
            let (squared, degrees) = said.residual(test).unwrap_or_default();
            (squared, degrees, ChiSquared::new(degrees as f64).ok().map(|law| law.sf(squared)))
        });
        let stands_out = |one: &FarRecord| one.p_corrected < LEVEL;
        AppliedRecord {
            title: title.to_owned(),
            from,
            tests: tests.len(),
            observations: seen,
            log_density,
            distance: distance.into(),
            of: outermost.unwrap_or("test").to_owned(),
            residual: residual.into(),
            outlying: far.iter().take_while(|one| stands_out(one)).cloned().collect(),
            furthest: far.into_iter().next(),
            unlikely: ranked(tests, residuals).into_iter().take_while(stands_out).collect(),
        }
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
