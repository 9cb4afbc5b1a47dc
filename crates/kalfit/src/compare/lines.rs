//! Comparison of the equations of models, by the sentences in their records.

use serde::{Deserialize, Serialize};

use kalfit_record::FitRecord;

/// A sentence on states or measurements that not all models have.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LineRecord {
    /// The sentence.
    pub line: String,
    /// Whether each fit's model has it.
    pub fits: Vec<bool>,
}

/// Beginnings of sentences on parameters, μ, Σ and groups, which are compared by other parts of a record.
const COMPARED_ELSEWHERE: [&str; 9] = [
    "tests: ",
    "parameter `",
    "order of ",
    "no state has ",
    "mean of `",
    "covariance ",
    "covariances of ",
    "variance of `",
    "level `",
];

/// Part of a sentence that is ignored: such a state has its variance fixed at zero, which is part of Σ.
const IGNORED_PART: &str = ", one value common to all tests";

/// Sentences on states, measurements, steps and filters.
pub(super) fn equations(fit: &FitRecord) -> Vec<String> {
    let counts = |line: &&String| !COMPARED_ELSEWHERE.iter().any(|start| line.starts_with(start));
    fit.model.iter().filter(counts).map(|line| line.replace(IGNORED_PART, "")).collect()
}

/// Whether two models have the same equations; false where a record has none.
pub(super) fn have_same_equations(a: &FitRecord, b: &FitRecord) -> bool {
    let (mut a, mut b) = (equations(a), equations(b));
    a.sort_unstable();
    b.sort_unstable();
    !a.is_empty() && a == b
}

/// Whether all covariances are full, diagonal, in blocks or known, so that each element that is not fixed is free by
/// itself.
pub(super) fn is_freely_structured(fit: &FitRecord) -> bool {
    let starts_plain = |kind: &str| {
        ["full", "diagonal", "blocks (", "known, ", "starts at "].iter().any(|plain| kind.starts_with(plain))
    };
    let mut all = fit.model.iter().filter_map(|line| {
        let line =
            line.strip_prefix("level `").map_or(line.as_str(), |rest| rest.split_once("`: ").map_or("", |x| x.1));
        Some(line.strip_prefix("covariance Σ")?.split_once(": ")?.1)
    });
    all.all(starts_plain) && !fit.model.iter().any(|line| line.contains("covariances of ") && line.ends_with(": equal"))
}

/// Whether a value is an end of the range of a parameter.
pub(super) fn is_range_end(fit: &FitRecord, parameter: &str, value: f64) -> bool {
    let start = format!("parameter `{parameter}`");
    let Some(line) = fit.model.iter().find(|line| line.starts_with(&start)) else { return value == 0.0 };
    line.split_once(": ").map_or("", |x| x.1).split(", ").any(|fact| {
        let bound = fact.strip_prefix("at least ").or_else(|| fact.strip_prefix("at most "));
        (fact == "not negative" && value == 0.0) || bound.and_then(|x| x.parse().ok()) == Some(value)
    })
}

/// Sentences that not all models have.
pub(super) fn differences(fits: &[&FitRecord]) -> Vec<LineRecord> {
    if fits.iter().any(|fit| fit.model.is_empty()) {
        return Vec::new();
    }
    let all: Vec<Vec<String>> = fits.iter().map(|fit| equations(fit)).collect();
    let mut records: Vec<LineRecord> = Vec::new();
    for line in all.iter().flatten() {
        let fits: Vec<bool> = all.iter().map(|own| own.contains(line)).collect();
        if fits.contains(&false) && !records.iter().any(|record| record.line == *line) {
            records.push(LineRecord { line: line.clone(), fits });
        }
    }
    records
}
