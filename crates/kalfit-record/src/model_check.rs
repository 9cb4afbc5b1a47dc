//! Whether the model describes the data, by the figures of the fit; to be known before the estimates are used.
//!
//! Findings are contradictions by the data. One test that decides much of the answer is only a remark, because small
//! ensembles of a correct model have such tests. A singular Σ is neither: the fit reports a singular Σ in the first
//! sentence and among the limits.

use std::cmp::Ordering;

use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::{FitRecord, InnovationRecord, MisfitTermRecord, TestRecord};

/// Significance level of each check, over all tests and not of each test. There are four: the innovations of single
/// tests, the distances of tests from the population or from their groups, single measurements, and the misfit that
/// tests have in common; a fifth, the size of all innovations, counts where noise levels are given. Corrections for many
/// p-values make each check reject a correct model less often than this. Together they reject 4 % of correct ensembles,
/// and up to 9 % of those with thousands of tests, as `cargo dev verdicts` and `cargo dev false-alarms` measure.
pub const SEARCH_LEVEL: f64 = 0.018;
/// Tail probability below which the mean square of all innovations is improbable.
const OVERALL_TAIL: f64 = 0.5 * SEARCH_LEVEL;
/// Number of innovations per free quantity above which a mean square below one counts against the model.
const INNOVATIONS_PER_FREE: usize = 10;

/// What the innovations, the distances of the tests and the fits without each of them show about the model. All checks
/// together reject a correct model in 4 % of ensembles, and in up to 9 % with thousands of tests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelCheckRecord {
    /// `passed`, `doubtful` or `not checked`.
    pub verdict: String,
    /// Evidence against the model; empty unless `doubtful`.
    pub findings: Vec<FindingRecord>,
    /// Limits of the result that are not evidence against the model.
    #[serde(default)]
    pub remarks: Vec<FindingRecord>,
}

/// One piece of evidence against a model, or one limit of its result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FindingRecord {
    /// For findings `innovations`, `mean_square`, `distance`, `unlike`, `row`, `misfit` or
    /// `normality`; for remarks `influence`.
    pub kind: String,
    /// A sentence without a full stop.
    pub text: String,
}

impl FitRecord {
    /// Along what innovations correlate, in words: "in time", or "from row to row" where rows are known to have no times.
    pub fn correlates(&self) -> &'static str {
        if self.has_times() { "in time" } else { "from row to row" }
    }

    /// Whether rows have times, or it is not known.
    pub fn has_times(&self) -> bool {
        let mut series = self.tests.iter().filter_map(|test| test.innovations?.series.as_deref()).peekable();
        series.peek().is_none() || series.any(|series| series.timed)
    }

    /// Whether innovations of single tests are correlated in time.
    pub fn has_correlated_innovations(&self) -> bool {
        improbable(self).iter().any(|one| one.2)
    }
}

impl ModelCheckRecord {
    /// Checks the requested figures of a record. Nothing is checked without figures of the tests, or where the search
    /// did not converge.
    pub fn of(record: &FitRecord) -> ModelCheckRecord {
        let has_figures =
            innovation_p_values(record).next().is_some() || record.tests.iter().any(|t| t.p_value.is_some());
        if !record.converged || !has_figures {
            return ModelCheckRecord { verdict: "not checked".to_owned(), findings: vec![], remarks: vec![] };
        }
        let found = [
            ("mean_square", mean_square(record)),
            ("innovations", innovations(record)),
            ("distance", distances(record)),
            ("unlike", unlike(record)),
            ("row", wrong_rows(record)),
            ("misfit", misfit(record)),
            ("normality", normality(record)),
        ];
        let one = |(kind, text): (&str, Option<String>)| Some(FindingRecord { kind: kind.to_owned(), text: text? });
        let findings: Vec<FindingRecord> = found.into_iter().filter_map(one).collect();
        let remarks = one(("influence", influence(record))).into_iter().collect();
        let verdict = if findings.is_empty() { "passed" } else { "doubtful" };
        ModelCheckRecord { verdict: verdict.to_owned(), findings, remarks }
    }

    /// Whether there are findings, evidence against the model.
    pub fn is_doubtful(&self) -> bool {
        !self.findings.is_empty()
    }
}

impl FitRecord {
    /// (number n of all innovations, sum of their squares, χ²_n when the model is right). Innovations of tests of one
    /// group share the effect of the group, so that with levels the sum is that under the law of the whole model; it is
    /// not known where groups cross.
    pub fn overall_innovations(&self) -> (usize, f64) {
        match &self.misfit {
            Some(misfit) if !self.levels.is_empty() => {
                let count = misfit.innovations;
                (count, misfit.mean_square.map_or(0.0, |mean| mean * count as f64))
            }
            None if !self.crossed.is_empty() => (0, 0.0),
            _ => innovations_of(self).fold((0, 0.0), |(count, nis): (usize, f64), (_, figures)| {
                (count.saturating_add(figures.count), nis + figures.nis.unwrap_or(0.0))
            }),
        }
    }

    /// Checks the model by the present figures of the record.
    pub fn add_model_check(&mut self) {
        self.model_check = Some(ModelCheckRecord::of(self));
    }
}

/// Holm's (1979) adjusted p-values of the smallest of `all` p-values, which are given in ascending order.
pub fn holm(ascending: &[f64], all: usize) -> Vec<f64> {
    let mut largest = 0.0_f64;
    let adjusted = |(k, p): (usize, &f64)| {
        largest = largest.max(p * (all - k) as f64).min(1.0);
        largest
    };
    ascending.iter().enumerate().map(adjusted).collect()
}

/// Compares the normalised innovation squared of `count` innovations over all tests with its law: `Greater` and `Less`
/// where it is larger or smaller than chance allows. Estimation makes innovations smaller, so a small value counts only
/// where there are many innovations for the number of free quantities.
pub fn overall_size(count: usize, nis: f64, free: usize) -> Ordering {
    let Some(chi) = ChiSquared::new(count as f64).ok().filter(|_| count > 0) else { return Ordering::Equal };
    if nis > count as f64 && chi.sf(nis) < OVERALL_TAIL {
        Ordering::Greater
    } else if nis < count as f64 && count > INNOVATIONS_PER_FREE * free && chi.cdf(nis) < OVERALL_TAIL {
        Ordering::Less
    } else {
        Ordering::Equal
    }
}

/// Median of χ² with k degrees of freedom, by Wilson and Hilferty: the displacement at the edge of the 50 % confidence
/// region.
pub fn displacement_limit(k: usize) -> f64 {
    let k = k.max(1) as f64;
    k * (1.0 - 2.0 / (9.0 * k)).powi(3)
}

fn innovations_of(record: &FitRecord) -> impl Iterator<Item = (&str, &InnovationRecord)> {
    record.tests.iter().filter_map(|test| Some((test.id, test.innovations?)))
}

/// (p-value, id of the test, whether the p-value is of the correlation of the innovations), for all tests.
fn innovation_p_values(record: &FitRecord) -> impl Iterator<Item = (f64, &str, bool)> {
    innovations_of(record).flat_map(|(id, figures)| {
        let white = figures.whiteness.as_ref().map(|w| w.p_value);
        let both = [(figures.nis_p_value, false), (white, true)];
        both.into_iter().filter_map(move |(p, white)| Some((p.filter(|p| p.is_finite())?, id, white)))
    })
}

fn mean_square(record: &FitRecord) -> Option<String> {
    let (count, nis) = record.overall_innovations();
    match overall_size(count, nis, record.free_parameters) {
        Ordering::Greater => Some("the innovations of all tests together are larger than the model allows".to_owned()),
        Ordering::Less => Some("the innovations of all tests together are smaller than the model allows".to_owned()),
        Ordering::Equal => None,
    }
}

/// Improbable p-values of innovations of single tests: p-value, id of the test, whether it is of correlation.
fn improbable(record: &FitRecord) -> Vec<(f64, &str, bool)> {
    let all = innovation_p_values(record).count();
    let mut least: Vec<(f64, &str, bool)> = innovation_p_values(record).filter(|one| one.0 < SEARCH_LEVEL).collect();
    least.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(b.1)));
    let adjusted = holm(&least.iter().map(|one| one.0).collect::<Vec<_>>(), all);
    least.truncate(adjusted.iter().take_while(|p| **p < SEARCH_LEVEL).count());
    least
}

fn innovations(record: &FitRecord) -> Option<String> {
    let improbable = improbable(record);
    let mut tests: Vec<&str> = improbable.iter().map(|one| one.1).collect();
    tests.sort_unstable();
    tests.dedup();
    let white = improbable.iter().filter(|one| one.2).count();
    let how = match (improbable.len() - white, white) {
        (_, 0) => "size".to_owned(),
        (0, _) => format!("correlation {}", record.correlates()),
        _ => format!("size or correlation {}", record.correlates()),
    };
    match tests[..] {
        [] => None,
        [only] => Some(format!("the innovations of test {only} are improbable ({how})")),
        _ => Some(format!("the innovations of {} of {} tests are improbable ({how})", tests.len(), record.data.tests)),
    }
}

/// Tests that are unlike the other tests of their groups.
fn unlike(record: &FitRecord) -> Option<String> {
    let all = &record.misfit.as_ref()?.unlike;
    let found: Vec<&str> =
        all.iter().filter(|one| one.adjusted_p_value < SEARCH_LEVEL).map(|one| one.test.as_str()).collect();
    match found[..] {
        [] => None,
        [only] => Some(format!("test {only} is unlike the other tests of its groups")),
        _ => Some(format!("{} tests are unlike the other tests of their groups", found.len())),
    }
}

/// Measurements that contradict the others of their test.
fn wrong_rows(record: &FitRecord) -> Option<String> {
    let all = &record.misfit.as_ref()?.wrong_rows;
    let found = || all.iter().filter(|one| one.adjusted_p_value < SEARCH_LEVEL);
    let first = found().next()?;
    let others = match found().count() - 1 {
        0 => String::new(),
        1 => ", and one more row is as strange".to_owned(),
        more => format!(", and {more} more rows are as strange"),
    };
    let (measurement, row, test) = (&first.measurement, first.row, &first.test);
    let size = (first.deviation / first.std_dev).abs();
    Some(format!(
        "`{measurement}` in row {row} (test {test}) is {size:.1} standard deviations from what the other rows of the test say{others}"
    ))
}

fn distances(record: &FitRecord) -> Option<String> {
    let known = || record.tests.iter().filter_map(|test| Some((test.p_value.filter(|p| p.is_finite())?, test.id)));
    let all = known().count() as f64;
    let outlying: Vec<&str> = known().filter(|(p, _)| p * all < SEARCH_LEVEL).map(|(_, id)| id).collect();
    match outlying[..] {
        [] => None,
        [only] => Some(format!("test {only} is an outlier")),
        _ => Some(format!("{} tests are outliers", outlying.len())),
    }
}

/// Whether a p-value of the misfit in common is below its part of the level, among all of them.
fn is_common(record: &FitRecord, p_value: f64) -> bool {
    let all = record.misfit.as_ref().map_or(0, |misfit| misfit.p_values().count());
    p_value * all as f64 <= SEARCH_LEVEL
}

fn misfit(record: &FitRecord) -> Option<String> {
    let terms = &record.misfit.as_ref()?.terms;
    let found: Vec<&MisfitTermRecord> = terms.iter().filter(|term| is_common(record, term.p_value)).collect();
    let first = found.first()?;
    let several = record.phases.len() > 1;
    let measurement = |term: &MisfitTermRecord| match several {
        true => format!("`{}` of phase `{}`", term.measurement, term.phase),
        false => format!("`{}`", term.measurement),
    };
    let others = match found.len() - 1 {
        0 => String::new(),
        1 => ", and one more such term".to_owned(),
        more => format!(", and {more} more such terms"),
    };
    Some(format!("the tests deviate in common: {} of {}{others}", first.words(), measurement(first)))
}

fn normality(record: &FitRecord) -> Option<String> {
    let normality = record.misfit.as_ref()?.normality.as_ref()?;
    let is_found = is_common(record, normality.p_value);
    is_found.then(|| "the innovations are not normal".to_owned())
}

fn influence(record: &FitRecord) -> Option<String> {
    let limit = displacement_limit(record.free_parameters);
    let decides =
        |test: &TestRecord<'_>| test.deletion.is_some_and(|d| d.displacement.is_finite() && d.displacement > limit);
    let deciding: Vec<&str> = record.tests.iter().filter(decides).map(|test| test.id).collect();
    match deciding[..] {
        [] => None,
        [only] => Some(format!("test {only} is influential: the estimates depend on it")),
        _ => Some(format!("{} tests are influential: the estimates depend on each of them", deciding.len())),
    }
}
