//! The data pass over equal steps of one measurement, for few moving states: a linear scan, for one test or for tests
//! in lanes.
#![expect(non_snake_case, reason = "the letters of the theory: K, h, phi, T")]

use crate::reduce::design::{Design, Stretch};
use crate::reduce::equal_steps::MAX_UNSCANNED_STEPS;
use crate::reduce::gains::{GainSpan, Gains};
use kalfit_lanes::{Lanes, Part, Real};

/// Number of steps whose terms are summed before the sum is added to the total: rounding then grows with the number of
/// blocks, not of steps.
pub(crate) const STEPS_PER_SUM: usize = 512;

/// A step of one scalar measurement z = h'x + v: x ← φx + c + Ke on the N moving states, e = z - h'(φx + c) - d. Tests
/// in lanes share φ and h.
#[derive(Debug, Clone, Copy)]
pub(crate) struct InvariantStep<T, const N: usize> {
    pub(crate) phi: [[f64; N]; N],
    /// Contribution of the resting states to φx.
    pub(crate) c: [T; N],
    pub(crate) h: [f64; N],
    /// φ'h, so that e needs no predicted x.
    g: [f64; N],
    /// h'c plus the contribution of the resting states to z.
    d: T,
}

/// Forward pass over the steps of a stretch, for one test or for tests in lanes that share the gains of the stretch.
pub(crate) struct Scan<'a, T> {
    pub(crate) design: &'a Design,
    pub(crate) stretch: &'a Stretch<'a>,
    /// The gains, and the piece that contains the first row of the stretch.
    pub(crate) gains: (&'a Gains, &'a GainSpan),
    /// x̂ before the steps, overwritten by x̂ after the steps.
    pub(crate) x: &'a mut [T],
    /// z - d of each step, overwritten by e; numbers of tests in lanes are interleaved.
    pub(crate) e: &'a mut [f64],
    /// (List, interval): x̂ of the moving states is appended to the list before the first step and then once per
    /// interval of steps.
    pub(crate) marks: Option<(&'a mut Vec<T>, usize)>,
}

/// Evaluates `$work` with the number of moving states, at most [`MOST_MOVING`], as the constant `$N`.
macro_rules! with_states {
    ($states:expr, $N:ident => $work:expr) => {
        match $states {
            0 => with_states!(@ 0, $N => $work),
            1 => with_states!(@ 1, $N => $work),
            2 => with_states!(@ 2, $N => $work),
            3 => with_states!(@ 3, $N => $work),
            4 => with_states!(@ 4, $N => $work),
            5 => with_states!(@ 5, $N => $work),
            _ => with_states!(@ 6, $N => $work),
        }
    };
    (@ $n:literal, $N:ident => $work:expr) => {{
        const $N: usize = $n;
        $work
    }};
}
pub(crate) use with_states;

/// Largest number of moving states of a stretch that is scanned.
const MOST_MOVING: usize = 6;

/// Number of moving states of a stretch that is scanned; `None` for any other stretch.
pub(crate) fn scanned(design: &Design, stretch: &Stretch<'_>) -> Option<usize> {
    design.moving_in_equal_steps(stretch, MAX_UNSCANNED_STEPS).filter(|&states| states <= MOST_MOVING)
}

/// A [`Scan`] compiled for `N` moving states.
pub(crate) struct ScanKernel<'a, T, const N: usize>(pub(crate) Scan<'a, T>);

impl<T: Lanes> Scan<'_, T> {
    /// Runs the scan with `states` moving states.
    #[inline(always)]
    pub(crate) fn run(self, states: usize) {
        with_states!(states, N => T::apart(ScanKernel::<T, N>(self)));
    }
}

impl<T: Lanes, const N: usize> Part for ScanKernel<'_, T, N> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Scan { design, stretch, gains: (gains, piece), x: all, e, mut marks } = self.0;
        let step = InvariantStep::<T, N>::new(design, stretch, all);
        let (mut x, mut K) = ([T::splat(0.0); N], [0.0; N]);
        x.copy_from_slice(&all[..N]);
        let (first, r, count) = (stretch.rows.start, design.frame.r, stretch.count);
        let moving = piece.steps_to_steady_gains(first).min(count);
        let block = marks.as_ref().map_or(count, |(_, block)| *block).max(1);
        for block_start in (0..count).step_by(block) {
            if let Some((marks, _)) = &mut marks {
                marks.extend_from_slice(&x);
            }
            let block_end = count.min(block_start + block);
            let still = moving.clamp(block_start, block_end);
            for k in block_start..still {
                K[..r].copy_from_slice(&gains.weighted(piece, first + k)[1..]);
                let e = &mut e[k * T::COUNT..][..T::COUNT];
                step.take(&mut x, &K, T::load(e)).store(e);
            }
            if still < block_end {
                K[..r].copy_from_slice(&gains.weighted(piece, first + still)[1..]);
                for e in e[still * T::COUNT..block_end * T::COUNT].chunks_exact_mut(T::COUNT) {
                    step.take(&mut x, &K, T::load(e)).store(e);
                }
            }
        }
        all[..N].copy_from_slice(&x);
    }
}

impl<T: Real, const N: usize> InvariantStep<T, N> {
    /// The step that a stretch repeats. `x`: x̂ before the stretch.
    #[inline(always)]
    pub(crate) fn new(design: &Design, stretch: &Stretch<'_>, x: &[T]) -> InvariantStep<T, N> {
        let zero = T::splat(0.0);
        let mut step = InvariantStep { phi: [[0.0; N]; N], c: [zero; N], h: [0.0; N], g: [0.0; N], d: zero };
        (0..N).for_each(|i| step.phi[i][i] = 1.0);
        if let Some(transition) = stretch.transition {
            transition.pattern.moved.iter().for_each(|row| step.phi[row.state as usize] = [0.0; N]);
            for (i, j, phi) in transition.entries() {
                if j < N {
                    step.phi[i][j] = phi;
                } else {
                    step.c[i] = T::splat(phi).fma(x[j], step.c[i]);
                }
            }
        }
        let (states, h) = design.terms(stretch.lines.start);
        for (&state, &h) in states.iter().zip(h) {
            match state as usize {
                i if i < N => {
                    step.h[i] = h;
                    (0..N).for_each(|j| step.g[j] += h * step.phi[i][j]);
                    step.d = T::splat(h).fma(step.c[i], step.d);
                }
                i => step.d = T::splat(h).fma(x[i], step.d),
            }
        }
        step
    }

    /// e of a measurement z after a step from x.
    #[inline(always)]
    pub(crate) fn innovation(&self, x: &[T; N], z: T) -> T {
        let mut e = z - self.d;
        for j in 0..N {
            e = T::splat(self.g[j]).fnma(x[j], e);
        }
        e
    }

    /// φx + c.
    #[inline(always)]
    pub(crate) fn predicted(&self, x: &[T; N]) -> [T; N] {
        let mut next = self.c;
        for i in 0..N {
            for j in 0..N {
                next[i] = T::splat(self.phi[i][j]).fma(x[j], next[i]);
            }
        }
        next
    }

    /// φx + c + Ke.
    #[inline(always)]
    pub(crate) fn state(&self, x: &[T; N], K: &[f64; N], e: T) -> [T; N] {
        let mut next = self.predicted(x);
        for i in 0..N {
            next[i] = T::splat(K[i]).fma(e, next[i]);
        }
        next
    }

    /// x ← φx + c + Ke; returns e.
    #[inline(always)]
    fn take(&self, x: &mut [T; N], K: &[f64; N], z: T) -> T {
        let e = self.innovation(x, z);
        *x = self.state(x, K, e);
        e
    }

    /// φ'r.
    #[inline(always)]
    pub(crate) fn adjoint(&self, r: &[T; N]) -> [T; N] {
        let mut out = [T::splat(0.0); N];
        for k in 0..N {
            for i in 0..N {
                out[i] = T::splat(self.phi[k][i]).fma(r[k], out[i]);
            }
        }
        out
    }
}
