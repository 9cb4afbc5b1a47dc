//! Cheap trials of ℓ: over many powers of ten of one parameter.

use crate::profile_likelihood::ProfileLikelihood;
use kalfit_estimate::{Progress, Stage};

/// Ratio of successive values tried for a logarithm.
pub(super) const FACTOR: f64 = 4.0;
/// Number of values tried to each side.
const EACH_SIDE: i32 = 6;
/// Largest power of this factor by which a value may be off the size that the data suggest and still be the middle of
/// the trials.
const NEAR: f64 = 4.0;
/// Number of points that are evaluated between two checks whether the caller still waits.
const AT_A_TIME: usize = 8;
/// Difference of ℓ that may be rounding.
const ROUNDING: f64 = 1e-8;
/// Step, in powers of the factor, by which the time constant of a nearly white process is lengthened.
const FINE: f64 = 0.25;
/// Number of these steps.
const FINE_STEPS: usize = 12;
/// Values tried for a parameter that is not sought by its logarithm.
const TRIED: [f64; 5] = [0.0, 0.5, 0.9, -0.5, 1.0];
/// Rise of ℓ that each later one of these values must bring: where a coefficient and a mean move as one, large values
/// cost digits.
const BETTER: f64 = 1e-3;

/// ℓ at each of some points, with reports of progress; points have no value once the caller no longer waits.
pub(super) fn tried(
    small: &ProfileLikelihood<'_>,
    places: &[Vec<f64>],
    progress: &mut dyn Progress,
) -> Vec<Option<f64>> {
    let at_a_time = if small.is_narrow() { AT_A_TIME } else { 1 };
    let some = |places: &[Vec<f64>]| {
        progress.stage(Stage::StartValues { filter_runs: small.filter_passes() });
        if progress.stops() { vec![None; places.len()] } else { small.each(places, |place| small.value(place)) }
    };
    places.chunks(at_a_time).flat_map(some).collect()
}

/// Sets all levels of one parameter to the best of many powers of a factor.
pub(super) fn scan(
    small: &ProfileLikelihood<'_>,
    parameter: usize,
    values: &mut Vec<f64>,
    progress: &mut dyn Progress,
) {
    let mut places = vec![values.clone()];
    places.extend(grid(small, parameter, values));
    let of_logarithms =
        small.slots.slots().iter().zip(&small.coordinates).any(|(slot, c)| slot.parameter == parameter && c.log);
    if let Some((best, _)) = best(small, places, if of_logarithms { 0.0 } else { BETTER }, progress) {
        *values = best;
    }
}

/// The best values, with all levels of one parameter multiplied by many powers of a factor, and ℓ there.
pub(super) fn best_of(
    objective: &ProfileLikelihood<'_>,
    parameter: usize,
    values: &[f64],
    progress: &mut dyn Progress,
) -> Option<(Vec<f64>, f64)> {
    let valued = valued(objective, grid(objective, parameter, values), progress);
    let highest = valued.iter().map(|(_, value)| *value).fold(f64::NEG_INFINITY, f64::max);
    // the last of those that are equal within rounding: the longest time constant of a nearly white process
    valued.into_iter().rfind(|(_, value)| *value >= highest - ROUNDING)
}

/// Lengthens the time constant of a nearly white process to where ℓ is highest: while it affects only the shortest
/// steps, ℓ may rise and fall again between the powers tried elsewhere.
pub(super) fn longer(
    objective: &ProfileLikelihood<'_>,
    parameter: usize,
    (values, highest): (Vec<f64>, f64),
    progress: &mut dyn Progress,
) -> Vec<f64> {
    let Some(slot) = objective.slots.common(parameter).filter(|&s| objective.coordinates[s].log) else { return values };
    let at = |k: usize| {
        let mut moved = values.clone();
        moved[slot] = objective.coordinates[slot].moved(values[slot], k as f64 * FINE * FACTOR.ln());
        moved
    };
    let found =
        best(objective, (1..=FINE_STEPS).map(at).collect(), 0.0, progress).filter(|(_, value)| *value > highest);
    found.map_or(values.clone(), |(values, _)| values)
}

fn grid(small: &ProfileLikelihood<'_>, parameter: usize, values: &[f64]) -> Vec<Vec<f64>> {
    let own = |s: usize| small.slots.slots()[s].parameter == parameter;
    let with = |change: &dyn Fn(usize, f64) -> f64| -> Vec<f64> {
        values.iter().enumerate().map(|(s, &v)| if own(s) { change(s, v) } else { v }).collect()
    };
    // the size that the data suggest, where a search has gone far from it
    let middle = |s: usize, v: f64| {
        let unit = small.units()[s];
        if (v / unit).ln().abs() <= NEAR * FACTOR.ln() { v } else { unit }
    };
    if (0..values.len()).any(|s| own(s) && small.coordinates[s].log) {
        (-EACH_SIDE..=EACH_SIDE)
            .map(|k| with(&|s, v| small.coordinates[s].moved(middle(s, v), f64::from(k) * FACTOR.ln())))
            .collect()
    } else {
        TRIED.iter().map(|&x| with(&|s, _| small.coordinates[s].inside(x))).collect()
    }
}

/// The points where ℓ is defined, and ℓ there.
pub(super) fn valued(
    small: &ProfileLikelihood<'_>,
    places: Vec<Vec<f64>>,
    progress: &mut dyn Progress,
) -> Vec<(Vec<f64>, f64)> {
    let values = tried(small, &places, progress);
    places.into_iter().zip(values).filter_map(|(place, value)| Some((place, value?))).collect()
}

/// The best point and ℓ there; a later point counts as better only if ℓ is higher by more than `apart`.
fn best(
    small: &ProfileLikelihood<'_>,
    places: Vec<Vec<f64>>,
    apart: f64,
    progress: &mut dyn Progress,
) -> Option<(Vec<f64>, f64)> {
    valued(small, places, progress).into_iter().reduce(|best, next| if best.1 + apart >= next.1 { best } else { next })
}

/// Starts at maxima of ℓ over the powers of a time constant, other than the one at the first start.
pub(super) fn other_maxima(
    small: &ProfileLikelihood<'_>,
    parameter: usize,
    first: &[f64],
    progress: &mut dyn Progress,
) -> Vec<Vec<f64>> {
    let grid = grid(small, parameter, first);
    let values = tried(small, &grid, progress);
    let values: Vec<f64> = values.into_iter().map(|value| value.unwrap_or(f64::NEG_INFINITY)).collect();
    let at = |k: usize| values.get(k).copied().unwrap_or(f64::NEG_INFINITY);
    let peak = |&k: &usize| values[k].is_finite() && (k == 0 || at(k - 1) < values[k]) && at(k + 1) < values[k];
    let alike = |(s, value): (usize, &f64)| *value == first[s] || (value / first[s]).ln().abs() <= 1.01 * FACTOR.ln();
    let near = |k: usize| grid[k].iter().enumerate().all(alike);
    (0..values.len()).filter(peak).filter(|&k| !near(k)).take(3).map(|k| grid[k].clone()).collect()
}
