//! d and the residual sum of squares of each test of a block, from y and e'S⁻¹e: see [`data_pass`](crate::reduce::data_pass).

use std::ops::Range;

use kalfit_lanes::Lanes;

use crate::reduce::data::REFINE;
use crate::reduce::lanes::numbers::{Numbers, at, put};
use crate::reduce::lanes::room::Room;
use crate::reduce::scan::BLOCK;

/// y → d. Where a test's squares are large, by way of its best ξ.
#[inline(always)]
pub(super) fn solve<T: Lanes, N: Numbers<T>>(numbers: &N, p: usize, square: T, room: &mut Room) {
    forward::<T, N>(numbers, p, &mut room.d);
    room.residual.resize(T::COUNT, 0.0);
    (square - squares::<T>(&room.d, p)).store(&mut room.residual);
    room.is_refined.clear();
    room.is_refined.resize(T::COUNT, false);
    if square.at_most(T::splat(REFINE)) || p == 0 {
        return;
    }
    let residual = refine::<T, N>(numbers, p, room);
    for lane in 0..T::COUNT {
        let small = square.lane(lane) <= REFINE; // not so where it is not a number
        if !small {
            room.is_refined[lane] = true;
            room.residual[lane] = residual.lane(lane);
        }
    }
}

/// d by way of the best ξ; the residual sum of squares.
#[inline(always)]
fn refine<T: Lanes, N: Numbers<T>>(numbers: &N, p: usize, room: &mut Room) -> T {
    room.best.clone_from(&room.d);
    backward::<T, N>(numbers, p, &mut room.best);
    room.refined.clear();
    room.refined.resize(p * T::COUNT, 0.0);
    let (zero, rows) = (T::splat(0.0), room.e.len() / T::COUNT);
    let (mut best, mut sum) = (vec![zero; p], vec![zero; p]);
    for k in 0..p {
        best[k] = at(&room.best, k);
    }
    let total = weigh::<T, N>(numbers, 0..rows, &room.e, &best, &mut sum);
    for (k, &sum) in sum.iter().enumerate() {
        put(&mut room.refined, k, sum);
    }
    forward::<T, N>(numbers, p, &mut room.refined);
    let residual = total - squares::<T>(&room.refined, p);
    for k in 0..p {
        let best = at::<T>(&room.best, k);
        for i in 0..=k {
            // d = R ξ + what is left
            let d = numbers.R(k * (k + 1) / 2 + i).fma(best, at::<T>(&room.refined, i));
            put(&mut room.refined, i, d);
        }
    }
    residual
}

/// Σ (e - Tξ)²/S over rows, in blocks; adds Σ T'(e - Tξ)/S to `sum`. Without `xi`, ξ = 0.
#[inline(always)]
pub(super) fn weigh<T: Lanes, N: Numbers<T>>(numbers: &N, rows: Range<usize>, e: &[f64], xi: &[T], sum: &mut [T]) -> T {
    let zero = T::splat(0.0);
    let (mut total, mut part) = (zero, vec![zero; sum.len()]);
    for start in rows.clone().step_by(BLOCK) {
        part.fill(zero);
        let mut square = zero;
        for row in start..rows.end.min(start + BLOCK) {
            let sensitivities = numbers.sensitivities(row);
            let mut left = at::<T>(e, row);
            for (k, &xi) in xi.iter().enumerate() {
                left = N::of(sensitivities, k).fnma(xi, left);
            }
            let weighted = left * N::of(numbers.gains(row), 0);
            square = left.fma(weighted, square);
            add::<T, N>(sensitivities, weighted, &mut part);
        }
        total = total + square;
        for (sum, &part) in sum.iter_mut().zip(&part) {
            *sum = *sum + part;
        }
    }
    total
}

/// sum ← sum + T'x, with T of a row.
#[inline(always)]
pub(super) fn add<T: Lanes, N: Numbers<T>>(sensitivities: &[f64], x: T, sum: &mut [T]) {
    for (k, sum) in sum.iter_mut().enumerate() {
        *sum = N::of(sensitivities, k).fma(x, *sum);
    }
}

/// Σ x².
#[inline(always)]
fn squares<T: Lanes>(x: &[f64], p: usize) -> T {
    let mut sum = T::splat(0.0);
    for k in 0..p {
        sum = at::<T>(x, k).fma(at::<T>(x, k), sum);
    }
    sum
}

/// d ← R'⁻¹ d, zero for zero rows of R.
#[inline(always)]
fn forward<T: Lanes, N: Numbers<T>>(numbers: &N, p: usize, d: &mut [f64]) {
    for k in 0..p {
        let mut sum = at::<T>(d, k);
        for i in 0..k {
            sum = numbers.R(k * (k + 1) / 2 + i).fnma(at::<T>(d, i), sum);
        }
        put(d, k, sum * numbers.R(k * (k + 3) / 2).recip_or_zero());
    }
}

/// ξ ← R⁻¹ ξ, zero for zero rows of R.
#[inline(always)]
fn backward<T: Lanes, N: Numbers<T>>(numbers: &N, p: usize, x: &mut [f64]) {
    for k in (0..p).rev() {
        let best = at::<T>(x, k) * numbers.R(k * (k + 3) / 2).recip_or_zero();
        put(x, k, best);
        for i in 0..k {
            let left = numbers.R(k * (k + 1) / 2 + i).fnma(best, at::<T>(x, i));
            put(x, i, left);
        }
    }
}
