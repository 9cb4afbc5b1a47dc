//! d and the residual sum of squares of each test of a block, from y and e'S⁻¹e. Where e'S⁻¹e is large, both are
//! computed from the innovations at the best ξ, e - Tξ, in which nothing cancels (corrected seminormal equations,
//! Björck 1987).

use std::ops::Range;

use kalfit_lanes::Lanes;

use crate::reduce::data::REFINE_ABOVE;
use crate::reduce::design::Design;
use crate::reduce::entries::Entries;
use crate::reduce::lanes::numbers::{Numbers, Repeats, at, put};
use crate::reduce::lanes::workspace::DataWorkspace;
use crate::reduce::scan::STEPS_PER_SUM;
use crate::reduce::segments::TestsInLanes;
use crate::reduce::segments::strands::StretchData;

/// Number of independent partial sums, so that no addition waits for the previous one.
const PARTIAL_SUMS: usize = 8;

/// Replaces y by d and computes the residual sum of squares; for a test with large e'S⁻¹e by way of the best ξ.
/// `values`: z - d of each row.
#[inline(always)]
pub(super) fn solve<T: Lanes, N: Numbers<T>>(
    (numbers, design): (&N, &Design),
    (square, values): (T, &[f64]),
    scratch: &mut DataWorkspace,
) {
    let p = design.frame.p;
    solve_lower::<T, N>(numbers, p, &mut scratch.d);
    scratch.residual.resize(T::COUNT, 0.0);
    (square - sum_of_squares::<T>(&scratch.d, p)).store(&mut scratch.residual);
    scratch.is_refined.clear();
    scratch.is_refined.resize(T::COUNT, false);
    if square.at_most(T::splat(REFINE_ABOVE)) || p == 0 {
        return;
    }
    let residual = refine::<T, N>((numbers, design), values, scratch);
    for lane in 0..T::COUNT {
        let small = square.lane(lane) <= REFINE_ABOVE; // false for NaN, which is then refined
        if !small {
            scratch.is_refined[lane] = true;
            scratch.residual[lane] = residual.lane(lane);
        }
    }
}

/// Computes d by way of the best ξ. Returns the residual sum of squares.
#[inline(always)]
fn refine<T: Lanes, N: Numbers<T>>((numbers, design): (&N, &Design), values: &[f64], scratch: &mut DataWorkspace) -> T {
    let p = design.frame.p;
    scratch.best.clone_from(&scratch.d);
    solve_upper::<T, N>(numbers, p, &mut scratch.best);
    scratch.refined.clear();
    scratch.refined.resize(p * T::COUNT, 0.0);
    let zero = T::splat(0.0);
    let (mut best, mut sum) = (vec![zero; p], vec![zero; p]);
    for k in 0..p {
        best[k] = at(&scratch.best, k);
    }
    let (mut total, mut row) = (zero, 0);
    for (stretch, filtered) in numbers.segments().iter().zip(&scratch.stretches) {
        total = total + weighted_sums::<T, N>((numbers, design), row..stretch.rows.start, &scratch.e, &best, &mut sum);
        row = stretch.rows.end;
        let (mut y, mut square) = (vec![0.0; p * T::COUNT], vec![0.0; T::COUNT]);
        let values = &values[stretch.rows.start * T::COUNT..stretch.rows.end * T::COUNT];
        let data = StretchData { values, tests: T::COUNT };
        stretch.add_at(TestsInLanes { data, y: &mut y, square: &mut square }, Some(&scratch.best), filtered);
        for (k, sum) in sum.iter_mut().enumerate() {
            *sum = *sum + at(&y, k);
        }
        total = total + at(&square, 0);
    }
    let rows = scratch.e.len() / T::COUNT;
    total = total + weighted_sums::<T, N>((numbers, design), row..rows, &scratch.e, &best, &mut sum);
    for (k, &sum) in sum.iter().enumerate() {
        put(&mut scratch.refined, k, sum);
    }
    solve_lower::<T, N>(numbers, p, &mut scratch.refined);
    let residual = total - sum_of_squares::<T>(&scratch.refined, p);
    for k in 0..p {
        let best = at::<T>(&scratch.best, k);
        for i in 0..=k {
            // d = Rξ + the refined remainder
            let d = numbers.R().entry(k * (k + 1) / 2 + i).fma(best, at::<T>(&scratch.refined, i));
            put(&mut scratch.refined, i, d);
        }
    }
    residual
}

/// Σ (e - Tξ)²/S over rows, in blocks; adds Σ T'(e - Tξ)/S to `sum`. Without `xi`, ξ = 0.
#[inline(always)]
pub(super) fn weighted_sums<T: Lanes, N: Numbers<T>>(
    (numbers, design): (&N, &Design),
    rows: Range<usize>,
    e: &[f64],
    xi: &[T],
    sum: &mut [T],
) -> T {
    let (mut total, mut first_row) = (T::splat(0.0), rows.start);
    while first_row < rows.end {
        let Repeats { steady, end, width } = numbers.repeats(first_row, rows.end);
        if first_row < steady {
            total = total + sums_of_different_rows::<T, N>((numbers, design), first_row..steady, (e, xi), sum);
        }
        if steady < end {
            total = total + sums_of_equal_rows::<T, N>(numbers, (steady..end, width), (e, xi), sum);
        }
        first_row = end;
    }
    total
}

/// [`weighted_sums`] of rows with different 1/S and T.
#[inline(always)]
fn sums_of_different_rows<T: Lanes, N: Numbers<T>>(
    (numbers, design): (&N, &Design),
    rows: Range<usize>,
    (e, xi): (&[f64], &[T]),
    sum: &mut [T],
) -> T {
    let zero = T::splat(0.0);
    let (mut total, mut part, mut start) = (zero, vec![zero; sum.len()], rows.start);
    while start < rows.end {
        part.fill(zero);
        let (mut square, end) = (zero, rows.end.min(design.block_end(start, STEPS_PER_SUM)));
        for row in start..end {
            let sensitivities = numbers.sensitivities(row);
            let remainder = remainder(sensitivities, xi, at(e, row));
            let weighted = remainder * numbers.gains(row).0;
            square = remainder.fma(weighted, square);
            add_weighted_row(sensitivities, weighted, &mut part);
        }
        total = total + square;
        for (sum, &part) in sum.iter_mut().zip(&part) {
            *sum = *sum + part;
        }
        start = end;
    }
    total
}

/// [`weighted_sums`] of rows of which every `width`-th shares one 1/S and T.
#[inline(always)]
fn sums_of_equal_rows<T: Lanes, N: Numbers<T>>(
    numbers: &N,
    (rows, width): (Range<usize>, usize),
    (e, xi): (&[f64], &[T]),
    sum: &mut [T],
) -> T {
    let mut total = T::splat(0.0);
    for row in rows.start..rows.end.min(rows.start + width) {
        let (weight, sensitivities) = (numbers.gains(row).0, numbers.sensitivities(row));
        let (remainder, squares) =
            sum_and_squares(e, (row..rows.end, width), remainder(sensitivities, xi, T::splat(0.0)));
        total = squares.fma(weight, total);
        add_weighted_row(sensitivities, remainder * weight, sum);
    }
    total
}

/// Σ (e + t) and Σ (e + t)² over every `width`-th row, in blocks.
#[inline(always)]
fn sum_and_squares<T: Lanes>(e: &[f64], (rows, width): (Range<usize>, usize), t: T) -> (T, T) {
    let zero = T::splat(0.0);
    let (mut sum, mut squares) = (zero, zero);
    for start in rows.clone().step_by(STEPS_PER_SUM * width) {
        let end = rows.end.min(start + STEPS_PER_SUM * width);
        let (mut sums, mut parts) = ([zero; PARTIAL_SUMS], [zero; PARTIAL_SUMS]);
        for group in (start..end).step_by(PARTIAL_SUMS * width) {
            for (partial_index, row) in (group..end).step_by(width).take(PARTIAL_SUMS).enumerate() {
                let remainder = at::<T>(e, row) + t;
                sums[partial_index] = sums[partial_index] + remainder;
                parts[partial_index] = remainder.fma(remainder, parts[partial_index]);
            }
        }
        for partial_index in 0..PARTIAL_SUMS {
            (sum, squares) = (sum + sums[partial_index], squares + parts[partial_index]);
        }
    }
    (sum, squares)
}

/// e - Tξ of a row.
#[inline(always)]
fn remainder<T: Lanes, E: Entries<T>>(sensitivities: E, xi: &[T], e: T) -> T {
    let mut remainder = e;
    for (k, &xi) in xi.iter().enumerate() {
        remainder = sensitivities.entry(k).fnma(xi, remainder);
    }
    remainder
}

/// sum ← sum + T'x, with T of a row.
#[inline(always)]
pub(super) fn add_weighted_row<T: Lanes, E: Entries<T>>(sensitivities: E, x: T, sum: &mut [T]) {
    for (k, sum) in sum.iter_mut().enumerate() {
        *sum = sensitivities.entry(k).fma(x, *sum);
    }
}

/// Σ x².
#[inline(always)]
fn sum_of_squares<T: Lanes>(x: &[f64], p: usize) -> T {
    let mut sum = T::splat(0.0);
    for k in 0..p {
        sum = at::<T>(x, k).fma(at::<T>(x, k), sum);
    }
    sum
}

/// d ← R'⁻¹ d, zero for zero rows of R.
#[inline(always)]
fn solve_lower<T: Lanes, N: Numbers<T>>(numbers: &N, p: usize, d: &mut [f64]) {
    for k in 0..p {
        let mut sum = at::<T>(d, k);
        for i in 0..k {
            sum = numbers.R().entry(k * (k + 1) / 2 + i).fnma(at::<T>(d, i), sum);
        }
        put(d, k, sum * numbers.R().entry(k * (k + 3) / 2).recip_or_zero());
    }
}

/// ξ ← R⁻¹ ξ, zero for zero rows of R.
#[inline(always)]
fn solve_upper<T: Lanes, N: Numbers<T>>(numbers: &N, p: usize, x: &mut [f64]) {
    for k in (0..p).rev() {
        let best = at::<T>(x, k) * numbers.R().entry(k * (k + 3) / 2).recip_or_zero();
        put(x, k, best);
        for i in 0..k {
            let remainder = numbers.R().entry(k * (k + 1) / 2 + i).fnma(best, at::<T>(x, i));
            put(x, i, remainder);
        }
    }
}
