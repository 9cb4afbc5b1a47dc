//! Whether ℓ has a maximum. Where the data fit the model exactly, ℓ has no maximum: ℓ rises without bound as noise
//! levels go to zero together.
//!
//! ```text
//! ℓ = -n log σ - ½ r/σ² + constant       where σ is small relative to all else; r: sum of squared residuals
//! ```
//!
//! With r = 0 each division of σ by ten raises ℓ by the same amount, down to where the rounding of the data matters.
//! With noise in the data, ℓ falls at larger σ already.

use crate::Standing;
use crate::coordinates::Coordinate;
use crate::profile_likelihood::ProfileLikelihood;
use crate::scales::relative_rounding;
use crate::search_state::SearchEnd;
use kalfit_estimate::Stop;

/// Value of a level, relative to the size that the data suggest, below which the level is on the way to zero.
const NEAR_ZERO: f64 = 1e-2;
/// Number of powers of ten by which levels are below the sizes suggested by the data where ℓ is first evaluated.
const FIRST_DEPTH: f64 = 3.0;
/// Number of steps from [`FIRST_DEPTH`] to the depth at which rounding matters.
const STEPS: usize = 3;
/// Least total length of these steps, in powers of ten: over a shorter range, noise cannot be distinguished from
/// rounding.
const MIN_DEPTH_RANGE: f64 = 2.0;
/// Least rise of ℓ per power of ten that counts as unbounded; a single exact measurement gives log 10.
const MIN_RISE: f64 = 1.0;
/// Relative difference up to which rises are equal.
const EQUAL: f64 = 0.02;
/// Number of levels above which levels are not examined one by one.
const MAX_SINGLE: usize = 8;
/// Number of further levels above which none of them is examined.
const MAX_FURTHER: usize = 64;

/// Index of an end from which ℓ rises without bound, and slots of the levels that go to zero; candidates are the best
/// end and the highest uncertified end above the best one.
pub(super) fn find(objective: &ProfileLikelihood<'_>, ends: &[SearchEnd], best: usize) -> Option<(usize, Vec<usize>)> {
    let value = |at: usize| ends[at].iterate.value();
    let higher = (0..ends.len()).filter(|&at| ends[at].stop != Stop::Certified && value(at) > value(best));
    let highest = higher.max_by(|&a, &b| value(a).total_cmp(&value(b)));
    let mut places = std::iter::once(best).chain(highest).filter(|&at| is_open(objective, &ends[at]));
    places.find_map(|at| Some((at, with_further(objective, &ends[at], levels(objective, &ends[at])?))))
}

/// Whether an end is uncertified, or has a level that a search stopped on the way to zero or that is below the size at
/// [`FIRST_DEPTH`].
fn is_open(objective: &ProfileLikelihood<'_>, end: &SearchEnd) -> bool {
    let was_stopped = |s: usize| matches!(end.standing[s], Standing::Vanishing | Standing::Unidentified);
    let tiny = |s: usize| {
        let value = end.iterate.values[s];
        value > 0.0 && value < lowered_level(&objective.coordinates[s], objective.units()[s], FIRST_DEPTH)
    };
    let is_open = |s: usize| objective.coordinates[s].level.is_some() && (was_stopped(s) || tiny(s));
    match end.stop {
        Stop::Interrupted => false,
        Stop::Certified => (0..end.iterate.values.len()).any(is_open),
        Stop::PassLimit | Stop::Stalled => true,
    }
}

/// Slots of the smallest set found of levels that raise ℓ without bound as all of the set go to zero together.
fn levels(objective: &ProfileLikelihood<'_>, end: &SearchEnd) -> Option<Vec<usize>> {
    let depth = depth(objective)?;
    let (values, units) = (&end.iterate.values, objective.units());
    let all: Vec<usize> = (0..values.len()).filter(|&s| can_vanish(&objective.coordinates[s])).collect();
    let near_zero: Vec<usize> = all.iter().copied().filter(|&s| values[s] <= NEAR_ZERO * units[s]).collect();
    let mut sets = vec![near_zero.clone()];
    if near_zero.len() > 1 && near_zero.len() <= MAX_SINGLE {
        sets.extend(near_zero.iter().map(|&s| vec![s]));
    }
    if near_zero.len() < all.len() {
        sets.push(all);
    }
    let mut found = sets.into_iter().find(|set| !set.is_empty() && rises(objective, values, set, depth))?;
    if found.len() > MAX_SINGLE {
        return Some(found);
    }
    let mut values = values.clone();
    for s in found.clone().into_iter().filter(|_| found.len() > 1).collect::<Vec<_>>() {
        let fewer: Vec<usize> = found.iter().copied().filter(|other| *other != s).collect();
        let kept = std::mem::replace(&mut values[s], units[s]);
        if !fewer.is_empty() && rises(objective, &values, &fewer, depth) {
            found = fewer;
        } else {
            values[s] = kept;
        }
    }
    Some(found)
}

/// A set of levels that raise ℓ without bound, and each further level that does so by itself: whoever gives only the
/// levels of the set a floor would meet the others next.
fn with_further(objective: &ProfileLikelihood<'_>, end: &SearchEnd, mut set: Vec<usize>) -> Vec<usize> {
    let Some(depth) = depth(objective) else { return set };
    let (mut values, units) = (end.iterate.values.clone(), objective.units());
    let all: Vec<usize> = (0..values.len()).filter(|&s| can_vanish(&objective.coordinates[s])).collect();
    for &s in &all {
        values[s] = values[s].max(units[s]);
    }
    let further: Vec<usize> = all.into_iter().filter(|s| !set.contains(s)).collect();
    if further.len() <= MAX_FURTHER {
        set.extend(further.into_iter().filter(|&s| rises(objective, &values, &[s], depth)));
        set.sort_unstable();
    }
    set
}

/// Whether a value is a noise level without a lower bound.
fn can_vanish(coordinate: &Coordinate) -> bool {
    coordinate.level.is_some() && coordinate.lower == 0.0
}

/// Number of powers of ten by which levels can be below the sizes suggested by the data before rounding matters; `None`
/// where this number is too small to decide.
fn depth(objective: &ProfileLikelihood<'_>) -> Option<f64> {
    let depth = -relative_rounding(objective.model, objective.tests, objective.order()).log10();
    (depth >= FIRST_DEPTH + MIN_DEPTH_RANGE).then_some(depth)
}

/// The value of a level whose standard deviation is `powers` powers of ten below the size suggested by the data.
fn lowered_level(coordinate: &Coordinate, unit: f64, powers: f64) -> f64 {
    unit * 10f64.powf(-2.0 * powers / coordinate.level.unwrap_or(2.0))
}

/// Whether ℓ rises equally with each power of ten by which the levels of `set` fall.
fn rises(objective: &ProfileLikelihood<'_>, values: &[f64], set: &[usize], depth: f64) -> bool {
    let step = (depth - FIRST_DEPTH) / STEPS as f64;
    let at = |k: usize| {
        let powers = FIRST_DEPTH + k as f64 * step;
        let mut values = values.to_vec();
        for &s in set {
            values[s] = lowered_level(&objective.coordinates[s], objective.units()[s], powers);
        }
        objective.filtered_value(&values)
    };
    let (Some(mut last), mut first) = (at(0), None) else { return false };
    (1..=STEPS).all(|k| {
        let Some(value) = at(k) else { return false };
        let rise = (value - std::mem::replace(&mut last, value)) / step;
        let first = *first.get_or_insert(rise);
        rise >= MIN_RISE && (rise - first).abs() <= EQUAL * first
    })
}
