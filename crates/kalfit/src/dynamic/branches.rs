//! Branches of a profile: ℓ over a held value is the highest of several maxima, and which of them is highest changes along the way.

use crate::dynamic::DynamicFit;
use crate::dynamic::coordinates::alike;
use crate::dynamic::profile_likelihood::ProfileLikelihood;

/// An end with ℓ lower by more is nowhere within an interval: half of χ²₁'s 95 % quantile.
pub(super) const WITHIN: f64 = 1.9208;
/// So many ends are kept, none but those that differ by more than this part.
const MOST: usize = 6;
pub(super) const ALIKE: f64 = 1e-3;

/// Other ends of the searches from which a profile may be higher than from the best, as they are sought: the highest first.
pub(super) fn others(objective: &ProfileLikelihood<'_>, fit: &DynamicFit) -> Vec<Vec<f64>> {
    let least = fit.estimate.log_likelihood - WITHIN;
    let mut kept = vec![fit.sought.clone()];
    for end in fit.others.iter().filter(|end| end.log_likelihood >= least) {
        let sought = objective.sought(&end.values);
        if kept.len() <= MOST && !kept.iter().any(|other| alike(other, &sought, ALIKE)) {
            kept.push(sought);
        }
    }
    kept.split_off(1)
}

/// The highest of what is found from nearby and from places of other branches, until one is higher than `enough`.
pub(super) fn highest<T>(
    nearby: Option<T>,
    others: &[Vec<f64>],
    (value, enough): (impl Fn(&T) -> f64, f64),
    from: impl Fn(&[f64]) -> Option<T>,
) -> Option<T> {
    let height = |found: &Option<T>| found.as_ref().map_or(f64::NEG_INFINITY, &value);
    let mut best = nearby;
    for other in others {
        if height(&best) > enough {
            break;
        }
        let found = from(other);
        best = if height(&found) > height(&best) { found } else { best };
    }
    best
}
