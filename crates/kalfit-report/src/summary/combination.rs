//! Weighted combinations of states or elements, in words.

use crate::number::plain;
use crate::words::clean;

/// No more terms than this of a direction are written out.
const MOST_TERMS: usize = 6;

/// The two states of `a, b` or `covariance[a, b]`.
pub(crate) fn covariance_of(element: &str) -> Option<(&str, &str)> {
    element.strip_prefix("covariance[").and_then(|e| e.strip_suffix(']')).unwrap_or(element).split_once(", ")
}

/// The terms of a direction that are not zero, the largest first. Weights are in the states' own units, so the smallest may matter.
pub(crate) fn weighted<'a>(direction: &[f64], names: &'a [String]) -> Vec<(f64, &'a String)> {
    let weights = direction.iter().zip(names).filter(|(w, _)| **w != 0.0 && w.is_finite());
    let mut terms: Vec<(f64, &String)> = weights.map(|(&w, name)| (w, name)).collect();
    terms.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
    terms
}

/// A combination of states in words.
pub(crate) fn combination_of(terms: &[(f64, &String)]) -> String {
    if terms.is_empty() { "of none".to_owned() } else { combination(terms, &|name| clean(name)) }
}

/// A combination of what `word` makes of each name.
pub(super) fn combination(terms: &[(f64, &String)], word: &dyn Fn(&str) -> String) -> String {
    let sign = terms[0].0.signum();
    let mut text = String::new();
    for (i, (weight, name)) in terms.iter().take(MOST_TERMS).enumerate() {
        let weight = weight * sign;
        let joint = match (i, weight < 0.0) {
            (0, _) => "",
            (_, true) => " - ",
            (_, false) => " + ",
        };
        text.push_str(&format!("{joint}{} {}", plain(weight.abs(), 2), word(name)));
    }
    if terms.len() > MOST_TERMS { text + " + …" } else { text }
}
