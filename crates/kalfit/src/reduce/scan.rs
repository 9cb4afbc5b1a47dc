//! The data pass over equal steps of one measurement, for few moving states: a linear scan, of one test or of several side by side.
#![expect(non_snake_case, reason = "the letters of the theory: K, h, phi, T")]

use std::ops::Range;

use crate::reduce::data::{Data, DataWork, FEW};
use crate::reduce::design::{Design, Stretch};
use crate::reduce::gains::{Gains, Piece};
use crate::reduce::small::moving;
use kalfit_lanes::{Lanes, Part, Real};

/// Terms that are added up before they join the sum: rounding grows with the number of blocks, not of rows.
pub(crate) const BLOCK: usize = 512;
/// Sums side by side.
const LANES: usize = 8;

/// Steps of one scalar measurement z = h'x + v: x ← φx + c + Ke on the N states that move, e = z - h'(φx + c) - d. Tests side by
/// side share φ and h.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Steady<T, const N: usize> {
    pub(crate) phi: [[f64; N]; N],
    /// What the states that rest add to φx.
    pub(crate) c: [T; N],
    pub(crate) h: [f64; N],
    /// φ'h, so that e needs no predicted x.
    g: [f64; N],
    /// h'c and what the states that rest add to z.
    d: T,
}

/// Forth over steps of a stretch, of one test or of several side by side under the gains of one.
pub(crate) struct Scan<'a, T> {
    pub(crate) design: &'a Design,
    pub(crate) stretch: &'a Stretch<'a>,
    /// The piece that its first row is in.
    pub(crate) gains: (&'a Gains, &'a Piece),
    /// x̂ before the steps, then after them.
    pub(crate) x: &'a mut [T],
    /// z - d of each, then e; of several tests beside each other.
    pub(crate) e: &'a mut [f64],
    /// Where x̂ of the states that move goes every so many steps, the first ones included.
    pub(crate) marks: Option<(&'a mut Vec<T>, usize)>,
}

/// Does something with the number of states that move as a constant: there are no more than [`MOST_MOVING`].
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

/// Most states that move in a stretch that is scanned.
const MOST_MOVING: usize = 6;

/// How many states move in a stretch, if it is of the kind that is scanned.
pub(crate) fn scanned(design: &Design, stretch: &Stretch<'_>) -> Option<usize> {
    let plain = stretch.count > FEW && stretch.lines.len() == 1 && design.frame.driven.is_empty();
    plain.then(|| moving(design, stretch)).filter(|&states| states <= MOST_MOVING)
}

/// [`Scan`] where so many states move.
pub(crate) struct Moving<'a, T, const N: usize>(pub(crate) Scan<'a, T>);

impl<T: Lanes> Scan<'_, T> {
    /// Runs it, where so many states move.
    #[inline(always)]
    pub(crate) fn run(self, states: usize) {
        with_states!(states, N => T::apart(Moving::<T, N>(self)));
    }
}

impl<T: Lanes, const N: usize> Part for Moving<'_, T, N> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Scan { design, stretch, gains: (gains, piece), x: all, e, mut marks } = self.0;
        let step = Steady::<T, N>::new(design, stretch, all);
        let (mut x, mut K) = ([T::splat(0.0); N], [0.0; N]);
        x.copy_from_slice(&all[..N]);
        let (first, r, count) = (stretch.rows.start, design.frame.r, stretch.count);
        let moving = piece.moving_gains(first).min(count);
        let block = marks.as_ref().map_or(count, |(_, block)| *block).max(1);
        for from in (0..count).step_by(block) {
            if let Some((marks, _)) = &mut marks {
                marks.extend_from_slice(&x);
            }
            let to = count.min(from + block);
            let still = moving.clamp(from, to);
            for k in from..still {
                K[..r].copy_from_slice(&gains.weighted(piece, first + k)[1..]);
                let e = &mut e[k * T::COUNT..][..T::COUNT];
                step.take(&mut x, &K, T::load(e)).store(e);
            }
            if still < to {
                K[..r].copy_from_slice(&gains.weighted(piece, first + still)[1..]);
                for e in e[still * T::COUNT..to * T::COUNT].chunks_exact_mut(T::COUNT) {
                    step.take(&mut x, &K, T::load(e)).store(e);
                }
            }
        }
        all[..N].copy_from_slice(&x);
    }
}

/// Runs the steps of a stretch that begins a piece; appends the innovations of each, and adds to e'S⁻¹e and y. False, and
/// nothing is done, where the steps are not of the kind that it knows.
pub(crate) fn scan(
    design: &Design,
    stretch: &Stretch<'_>,
    (gains, piece): (&Gains, &Piece),
    data: &Data,
    work: &mut DataWork,
    square: &mut f64,
) -> bool {
    let Some(states) = scanned(design, stretch) else { return false };
    let start = work.e.len();
    work.e.extend_from_slice(&data.values[stretch.rows.clone()]);
    let (x, e) = (&mut *work.x, &mut work.e[start..]);
    Scan { design, stretch, gains: (gains, piece), x, e, marks: None }.run(states);
    let mut correction = vec![0.0; design.frame.p];
    *square += gains.weigh((piece, stretch.rows.clone()), &work.e[start..], &[], &mut correction);
    for (y, sum) in work.y.iter_mut().zip(&correction) {
        *y += sum;
    }
    true
}

impl<T: Real, const N: usize> Steady<T, N> {
    /// `x`: the filter before them.
    #[inline(always)]
    pub(crate) fn new(design: &Design, stretch: &Stretch<'_>, x: &[T]) -> Steady<T, N> {
        let zero = T::splat(0.0);
        let mut step = Steady { phi: [[0.0; N]; N], c: [zero; N], h: [0.0; N], g: [0.0; N], d: zero };
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

    /// e of a measurement after the step from x.
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

    /// e; x is updated.
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

impl Gains {
    /// Σ (e - Tξ)²/S over rows of a piece, in blocks; adds Σ T'(e - Tξ)/S to `sum`. Without `xi`, ξ = 0.
    pub(crate) fn weigh(&self, (piece, rows): (&Piece, Range<usize>), e: &[f64], xi: &[f64], sum: &mut [f64]) -> f64 {
        let predicted = |T: &[f64]| T.iter().zip(xi).map(|(T, x)| T * x).sum::<f64>();
        let (mut squares, width) = (0.0, piece.width);
        let kept = (piece.row + piece.moving() * width).clamp(rows.start, rows.end);
        let mut part = vec![0.0; sum.len()];
        for start in (rows.start..kept).step_by(BLOCK) {
            let block = start..kept.min(start + BLOCK);
            let mut square = 0.0;
            part.fill(0.0);
            for row in block {
                let (weight, _, T) = self.of(piece, row);
                let left = e[row - rows.start] - predicted(T);
                square += left * left * weight;
                for (part, T) in part.iter_mut().zip(T) {
                    *part += T * (left * weight);
                }
            }
            squares += square;
            for (sum, part) in sum.iter_mut().zip(&part) {
                *sum += part;
            }
        }
        for row in kept..rows.end.min(kept + width) {
            let (weight, _, T) = self.of(piece, row);
            let (total, square) = sums(&e[row - rows.start..], width, predicted(T));
            squares += square * weight;
            for (sum, T) in sum.iter_mut().zip(T) {
                *sum += T * (total * weight);
            }
        }
        squares
    }
}

/// (Σ (e - t), Σ (e - t)²) of every `width`-th e, in blocks.
fn sums(e: &[f64], width: usize, t: f64) -> (f64, f64) {
    if width > 1 {
        let add = |(sum, squares): (f64, f64), e: &f64| (sum + (e - t), squares + (e - t) * (e - t));
        let block = |block: &[f64]| block.iter().step_by(width).fold((0.0, 0.0), add);
        return e.chunks(BLOCK * width).map(block).fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d));
    }
    let (mut sum, mut squares) = (0.0, 0.0);
    for block in e.chunks(BLOCK) {
        let (mut lanes, mut lane_squares) = ([0.0; LANES], [0.0; LANES]);
        let chunks = block.chunks_exact(LANES);
        let rest = chunks.remainder();
        for chunk in chunks {
            for l in 0..LANES {
                let left = chunk[l] - t;
                lanes[l] += left;
                lane_squares[l] += left * left;
            }
        }
        for (l, e) in rest.iter().enumerate() {
            let left = e - t;
            lanes[l] += left;
            lane_squares[l] += left * left;
        }
        sum += lanes.iter().sum::<f64>();
        squares += lane_squares.iter().sum::<f64>();
    }
    (sum, squares)
}
