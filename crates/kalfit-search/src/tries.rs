//! Cheap trials of ℓ over several powers of ten of one parameter.

use crate::profile_likelihood::ProfileLikelihood;
use crate::scales::{has_known_size, measures};
use kalfit_estimate::{Progress, Stage};

/// Ratio of successive values tried for a logarithm.
pub(super) const TRIAL_FACTOR: f64 = 4.0;
/// Number of values tried above the middle value, and below.
const POWERS_EACH_SIDE: i32 = 6;
/// Trials are centred at the value itself while the value is within this many powers of [`TRIAL_FACTOR`] of the size
/// that the data suggest.
const MAX_POWERS_OFF: f64 = 4.0;
/// Number of points that are evaluated between two checks whether the caller still waits.
const BATCH: usize = 8;
/// Difference of ℓ that may be rounding.
const ROUNDING: f64 = 1e-8;
/// Step, in powers of [`TRIAL_FACTOR`], by which the time constant of a nearly white process is lengthened.
const FINE_STEP: f64 = 0.25;
/// Number of steps of [`FINE_STEP`] tried.
const FINE_STEPS: usize = 12;
/// Sizes of the noise of the measurements, relative to those of differences of the data.
const NOISE_SIZES: [f64; 3] = [1.0, 0.5, 0.25];
/// Values tried for a parameter that is not sought by its logarithm.
const OTHER_VALUES: [f64; 5] = [0.0, 0.5, 0.9, -0.5, 1.0];
/// Rise of ℓ above which a later one of [`OTHER_VALUES`] replaces an earlier one: where a mean compensates a
/// coefficient, large values cost digits.
const MIN_RISE: f64 = 1e-3;

/// ℓ at each point, with reports of progress; `None` where ℓ is not defined, and once the caller no longer waits.
pub(super) fn likelihoods_at(
    small: &ProfileLikelihood<'_>,
    places: &[Vec<f64>],
    progress: &mut dyn Progress,
) -> Vec<Option<f64>> {
    let at_a_time = if small.is_parallel_over_alpha() { BATCH } else { 1 };
    small.tried_values(places, at_a_time, &mut || {
        progress.stage(Stage::StartValues { filter_runs: small.filter_passes() });
        !progress.stops()
    })
}

/// Sets all levels of one parameter to the best trial values of `grid`.
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
    if let Some((best, _)) = best(small, places, if of_logarithms { 0.0 } else { MIN_RISE }, progress) {
        *values = best;
    }
}

/// The best values over the trials of one parameter (`grid`), and ℓ there.
pub(super) fn best_of(
    objective: &ProfileLikelihood<'_>,
    parameter: usize,
    values: &[f64],
    progress: &mut dyn Progress,
) -> Option<(Vec<f64>, f64)> {
    let with_likelihood = with_likelihood(objective, grid(objective, parameter, values), progress);
    let highest = with_likelihood.iter().map(|(_, value)| *value).fold(f64::NEG_INFINITY, f64::max);
    // the last of the values of ℓ that are equal within rounding: the longest time constant of a nearly white process
    with_likelihood.into_iter().rfind(|(_, value)| *value >= highest - ROUNDING)
}

/// Lengthens the time constant of a nearly white process, in fine steps, to the highest ℓ: while the time constant
/// affects only the shortest steps of a record, ℓ may rise and fall again between two powers of [`TRIAL_FACTOR`].
pub(super) fn lengthened_time(
    objective: &ProfileLikelihood<'_>,
    parameter: usize,
    (values, highest): (Vec<f64>, f64),
    progress: &mut dyn Progress,
) -> Vec<f64> {
    let Some(slot) = objective.slots.common(parameter).filter(|&s| objective.coordinates[s].log) else { return values };
    let at = |k: usize| {
        let mut moved = values.clone();
        moved[slot] = objective.coordinates[slot].moved(values[slot], k as f64 * FINE_STEP * TRIAL_FACTOR.ln());
        moved
    };
    let found =
        best(objective, (1..=FINE_STEPS).map(at).collect(), 0.0, progress).filter(|(_, value)| *value > highest);
    found.map_or(values.clone(), |(values, _)| values)
}

fn grid(small: &ProfileLikelihood<'_>, parameter: usize, values: &[f64]) -> Vec<Vec<f64>> {
    let is_of_parameter = |s: usize| small.slots.slots()[s].parameter == parameter;
    let with_parameter = |change: &dyn Fn(usize, f64) -> f64| -> Vec<f64> {
        values.iter().enumerate().map(|(s, &v)| if is_of_parameter(s) { change(s, v) } else { v }).collect()
    };
    // the size that the data suggest, where a value is far from that size
    let middle = |s: usize, v: f64| {
        let unit = small.units()[s];
        if (v / unit).ln().abs() <= MAX_POWERS_OFF * TRIAL_FACTOR.ln() { v } else { unit }
    };
    if (0..values.len()).any(|s| is_of_parameter(s) && small.coordinates[s].log) {
        (-POWERS_EACH_SIDE..=POWERS_EACH_SIDE)
            .map(|k| with_parameter(&|s, v| small.coordinates[s].moved(middle(s, v), f64::from(k) * TRIAL_FACTOR.ln())))
            .collect()
    } else {
        OTHER_VALUES.iter().map(|&x| with_parameter(&|s, _| small.coordinates[s].within_bounds(x))).collect()
    }
}

/// The points where ℓ is defined, and ℓ there.
pub(super) fn with_likelihood(
    small: &ProfileLikelihood<'_>,
    places: Vec<Vec<f64>>,
    progress: &mut dyn Progress,
) -> Vec<(Vec<f64>, f64)> {
    let values = likelihoods_at(small, &places, progress);
    places.into_iter().zip(values).filter_map(|(place, value)| Some((place, value?))).collect()
}

/// The best point and ℓ there; a later point counts as better only if ℓ is higher by more than `apart`.
fn best(
    small: &ProfileLikelihood<'_>,
    places: Vec<Vec<f64>>,
    apart: f64,
    progress: &mut dyn Progress,
) -> Option<(Vec<f64>, f64)> {
    with_likelihood(small, places, progress)
        .into_iter()
        .reduce(|best, next| if best.1 + apart >= next.1 { best } else { next })
}

/// Up to three maxima of ℓ over the trials of a parameter (`grid`), without a maximum near the first start. Where the
/// size of the process is known, noise of the measurements is tried in several sizes, as the process explains another part
/// of it with another time constant.
pub(super) fn other_maxima(
    small: &ProfileLikelihood<'_>,
    parameter: usize,
    first: &[f64],
    progress: &mut dyn Progress,
) -> Vec<Vec<f64>> {
    let fixed_size = has_known_size(small.model, parameter, &|other| small.slots.is_free(other));
    let of_noise = |s: usize| {
        let slot = small.slots.slots()[s];
        fixed_size && small.coordinates[s].log && slot.level.is_none() && measures(small.model, slot.parameter)
    };
    let sized = |place: Vec<f64>| {
        let with = |size: f64| -> Vec<f64> {
            let value = |(s, &v): (usize, &f64)| if of_noise(s) { size * small.units()[s] } else { v };
            place.iter().enumerate().map(value).collect()
        };
        let sizes = if fixed_size { &NOISE_SIZES[..] } else { &[] };
        let places = std::iter::once(place.clone()).chain(sizes.iter().copied().map(with)).collect();
        let found = with_likelihood(small, places, progress);
        let best = found.into_iter().reduce(|best, next| if next.1 > best.1 { next } else { best });
        best.unwrap_or((place, f64::NEG_INFINITY))
    };
    let (grid, values): (Vec<Vec<f64>>, Vec<f64>) = grid(small, parameter, first).into_iter().map(sized).unzip();
    let at = |k: usize| values.get(k).copied().unwrap_or(f64::NEG_INFINITY);
    let peak = |&k: &usize| values[k].is_finite() && (k == 0 || at(k - 1) < values[k]) && at(k + 1) < values[k];
    let alike = |(s, value): (usize, &f64)| {
        small.slots.slots()[s].parameter != parameter || (value / first[s]).ln().abs() <= 1.01 * TRIAL_FACTOR.ln()
    };
    let near = |k: usize| grid[k].iter().enumerate().all(alike);
    (0..values.len()).filter(peak).filter(|&k| !near(k)).take(3).map(|k| grid[k].clone()).collect()
}
