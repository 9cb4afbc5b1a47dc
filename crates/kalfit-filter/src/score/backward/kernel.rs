//! Backward steps on flat arrays, for plain numbers and for lanes.
#![expect(non_snake_case, reason = "the letters of the theory: N, K")]

use kalfit_lanes::Real;

use crate::reduce::{Entries, TransitionView};

/// X ← φ'X with X = `x`, rows × width; rows and columns of φ beyond the rows of X are omitted.
#[inline(always)]
pub(crate) fn advance_transposed<T: Real, E: Entries<T>>(
    x: &mut [T],
    (rows, width): (usize, usize),
    transition: TransitionView<'_, E>,
    work: &mut Vec<T>,
) {
    let TransitionView { pattern, phi, .. } = transition;
    if let Some(states) = pattern.diagonal() {
        for (k, state) in states.take_while(|state| *state < rows).enumerate() {
            let phi = phi.entry(k);
            for x in &mut x[state * width..][..width] {
                *x = phi * *x;
            }
        }
        return;
    }
    let moved = pattern.moved.partition_point(|row| (row.state as usize) < rows);
    let moved = &pattern.moved[..moved];
    work.clear();
    for row in moved {
        let own = &mut x[row.state as usize * width..][..width];
        work.extend_from_slice(own);
        own.fill(T::splat(0.0));
    }
    for (m, row) in moved.iter().enumerate() {
        let own = &work[m * width..][..width];
        for k in row.start as usize..row.end as usize {
            let column = pattern.columns[k] as usize;
            if column < rows {
                let phi = phi.entry(k);
                for (x, &own) in x[column * width..][..width].iter_mut().zip(own) {
                    *x = phi.fma(own, *x);
                }
            }
        }
    }
}

/// N ← Nφ on the r noisy states.
#[inline(always)]
pub(super) fn times_phi<T: Real, E: Entries<T>>(
    N: &mut [T],
    r: usize,
    transition: TransitionView<'_, E>,
    work: &mut Vec<T>,
) {
    let TransitionView { pattern, phi, .. } = transition;
    if let Some(states) = pattern.diagonal() {
        for (k, state) in states.take_while(|state| *state < r).enumerate() {
            let phi = phi.entry(k);
            for i in 0..r {
                N[i * r + state] = phi * N[i * r + state];
            }
        }
        return;
    }
    let moved = pattern.moved.partition_point(|row| (row.state as usize) < r);
    let moved = &pattern.moved[..moved];
    for i in 0..r {
        let line = &mut N[i * r..][..r];
        work.clear();
        for row in moved {
            work.push(std::mem::replace(&mut line[row.state as usize], T::splat(0.0)));
        }
        for (row, &own) in moved.iter().zip(work.iter()) {
            for k in row.start as usize..row.reach as usize {
                let column = pattern.columns[k] as usize;
                line[column] = phi.entry(k).fma(own, line[column]);
            }
        }
    }
}

/// u = e/S - K'r; `weight` is 1/S, and r has the noise-reachable states only.
#[inline(always)]
pub(crate) fn smoothing_error<T: Real, E: Entries<T>>(e: T, (weight, K): (T, E), r: &[T]) -> T {
    let mut u = e * weight;
    for (i, &r) in r.iter().enumerate() {
        u = K.entry(i).fnma(r, u);
    }
    u
}

/// X ← X + hu', with X = `x`, n × length of u, and h zero except on `states`.
#[inline(always)]
pub(crate) fn absorb<T: Real, E: Entries<T>>((states, h): (&[u32], E), u: &[T], x: &mut [T]) {
    for (k, &state) in states.iter().enumerate() {
        let h = h.entry(k);
        for (x, &u) in x[state as usize * u.len()..][..u.len()].iter_mut().zip(u) {
            *x = h.fma(u, *x);
        }
    }
}

/// The entry r_i r_j + (ρρ')_ij.
#[inline(always)]
pub(super) fn outer_entry<T: Real>(adjoint: &[T], rho: &[T], c: usize, i: usize, j: usize) -> T {
    adjoint[i].fma(adjoint[j], dot(&rho[i * c..][..c], &rho[j * c..][..c]))
}

/// The inner product Σ a_k b_k.
#[inline(always)]
pub(super) fn dot<T: Real, E: Entries<T>>(a: E, b: &[T]) -> T {
    let mut sum = T::splat(0.0);
    for (k, &b) in b.iter().enumerate() {
        sum = a.entry(k).fma(b, sum);
    }
    sum
}
