//! First sizes of noise levels. The variation from row to row is noise of the measurement or of the motion, and ℓ often
//! has a maximum where all of it is attributed to one of them: a search over one level at a time that begins near the
//! wrong one ends there. So levels of measurements and levels of motion are first tried in combination.

use crate::Coordinate;
use crate::profile_likelihood::ProfileLikelihood;
use crate::scales::{measures, time_constants};
use crate::tries::{TRIAL_FACTOR, likelihoods_at};
use kalfit_estimate::Progress;

/// Powers of [`TRIAL_FACTOR`] tried where levels of one kind alone are unknown.
const POWERS_ALONE: [i32; 7] = [-3, -2, -1, 0, 1, 2, 3];
/// Powers tried for levels of measurements in combination: noise of a measurement is seldom far above the differences
/// of successive values.
const MEASUREMENT_POWERS: [i32; 5] = [-4, -2, -1, 0, 1];
/// Powers tried for levels of motion in combination: the data's units are not those of every state.
const MOTION_POWERS: [i32; 9] = [-7, -5, -4, -3, -2, -1, 0, 1, 3];

/// Sets the unknown noise levels to the likeliest of some points over both kinds. Returns other points that are
/// likelier than all their neighbours, the likeliest first.
pub(super) fn balance(
    small: &ProfileLikelihood<'_>,
    unknown: &[usize],
    values: &mut Vec<f64>,
    progress: &mut dyn Progress,
) -> Vec<Vec<f64>> {
    let (measured, moved) = unknown_levels(small, unknown);
    let (rows, columns): (&[i32], &[i32]) = match (measured.is_empty(), moved.is_empty()) {
        (true, true) => return Vec::new(),
        (false, true) => (&POWERS_ALONE, &[0]),
        (true, false) => (&[0], &POWERS_ALONE),
        (false, false) => (&MEASUREMENT_POWERS, &MOTION_POWERS),
    };
    let at = |a: i32, b: i32| -> Vec<f64> {
        let power = |s: usize| {
            if measured.contains(&s) {
                a
            } else if moved.contains(&s) {
                b
            } else {
                0
            }
        };
        let times = |(s, &value): (usize, &f64)| step(small.coordinates[s], value, power(s));
        values.iter().enumerate().map(times).collect()
    };
    let points: Vec<Vec<f64>> =
        rows.iter().flat_map(|&a| columns.iter().map(move |&b| (a, b))).map(|(a, b)| at(a, b)).collect();
    let heights = likelihoods_at(small, &points, progress);
    let heights: Vec<f64> = heights.into_iter().map(|height| height.unwrap_or(f64::NEG_INFINITY)).collect();
    let mut peaks = peaks(&heights, columns.len());
    peaks.sort_by(|&a, &b| heights[b].total_cmp(&heights[a]));
    let mut peaks = peaks.into_iter();
    if let Some(best) = peaks.next() {
        *values = points[best].clone();
    }
    // where measurements have hardly any noise ℓ may rise without end, as a free mean fits one of them ever more
    // exactly
    let inside = |k: &usize| rows.len() == 1 || *k >= columns.len();
    peaks.filter(inside).map(|k| points[k].clone()).collect()
}

fn step(coordinate: Coordinate, value: f64, power: i32) -> f64 {
    if power == 0 { value } else { coordinate.moved(value, f64::from(power) * TRIAL_FACTOR.ln()) }
}

/// Free values that are unknown noise levels: (of measurements, of motion).
fn unknown_levels(small: &ProfileLikelihood<'_>, unknown: &[usize]) -> (Vec<usize>, Vec<usize>) {
    let constants = time_constants(small.model);
    let slots = small.slots.slots();
    let level = |s: &usize| {
        let parameter = slots[*s].parameter;
        small.coordinates[*s].log && unknown.contains(&parameter) && !constants.contains(&parameter)
    };
    (0..slots.len()).filter(level).partition(|s| measures(small.model, slots[*s].parameter))
}

/// Indices, row by row, of the entries of a table that are higher than all neighbours; of equal neighbours the first.
fn peaks(heights: &[f64], columns: usize) -> Vec<usize> {
    let peak = |&k: &usize| {
        let (row, column) = (k / columns, k % columns);
        let beside = |other: &usize| {
            let (r, c) = (other / columns, other % columns);
            *other != k && r.abs_diff(row) <= 1 && c.abs_diff(column) <= 1
        };
        let below = |other: usize| heights[other] < heights[k] || (heights[other] == heights[k] && k < other);
        heights[k].is_finite() && (0..heights.len()).filter(beside).all(below)
    };
    (0..heights.len()).filter(peak).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peaks_of_a_table_are_higher_than_all_beside_them() {
        let low = f64::NEG_INFINITY;
        let heights = [5.0, 1.0, 2.0, 4.0, 0.0, 3.0, 3.0, low, low, low, low, 7.0];
        assert_eq!(peaks(&heights, 4), [0, 3, 11]);
        assert_eq!(peaks(&[1.0, 1.0, 0.0, 1.0], 4), [0, 3]);
        assert!(peaks(&[low, low], 2).is_empty());
    }
}
