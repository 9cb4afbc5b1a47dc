//! The data's part of the backward pass over the rows of segments, many segments in lanes.
//!
//! ```text
//! x̄: mark + Ψδ̂ and 32 rows forward again        then, from the last row to the first:
//! u = ē/S - K'r        ∂ℓ/∂R: ½u²        ∂ℓ/∂d: u        r ← r + hu        ∂ℓ/∂h: u (x̄⁻ + P⁻r)
//! ∂ℓ/∂Q: ½rr'        ∂ℓ/∂φ: r (x̄ + Pφ'r)'        r ← φ'r
//! ```
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, K, S")]

use std::marker::PhantomData;

use kalfit_lanes::{Isa, Kernel, Lanes, MAX_LANES, Part};
use rayon::prelude::*;

use crate::reduce::segments::SegmentedStretch;
use crate::reduce::segments::prefix::Prefix;
use crate::reduce::segments::strands::{
    Block, GROUPS, MARK_ROWS, MAX_SERIAL_ROWS, MAX_STRANDS, Pack, PackValues, SegmentData, StepMatrices, StretchData,
    with_steps,
};
use crate::reduce::with_states;
use crate::score::backward::AdjointsWanted;

/// The data's part of the adjoints of the steps of a stretch of one test, summed over the steps: u, u², the terms of
/// ∂ℓ/∂h, rr' (lower triangle) and the terms of ∂ℓ/∂φ;
/// entries off the diagonal are zero where φ and Q are diagonal.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DataAdjoints {
    size: usize,
    numbers: Vec<f64>,
}

/// Number of sums over the rows of segments of N states.
const fn sums(N: usize) -> usize {
    2 + N + 2 * N * N
}

impl DataAdjoints {
    /// Adjoints of zero, of segments of `size` states.
    pub(crate) fn zeros(size: usize) -> DataAdjoints {
        DataAdjoints { size, numbers: vec![0.0; sums(size)] }
    }

    pub(crate) fn u(&self) -> f64 {
        self.numbers[0]
    }

    pub(crate) fn uu(&self) -> f64 {
        self.numbers[1]
    }

    pub(crate) fn h(&self, i: usize) -> f64 {
        self.numbers[2 + i]
    }

    pub(crate) fn rr(&self, i: usize, j: usize) -> f64 {
        self.numbers[2 + self.size + i.max(j) * self.size + i.min(j)]
    }

    pub(crate) fn phi(&self, i: usize, j: usize) -> f64 {
        self.numbers[2 + self.size + self.size * self.size + i * self.size + j]
    }
}

/// The adjoints of each test. `ends`: (δ̂, r after the segment) of each segment of each test.
pub(super) fn back(
    stretch: &SegmentedStretch,
    forward: &SegmentData,
    data: StretchData<'_>,
    ends: &[f64],
    wanted: AdjointsWanted,
) -> Vec<DataAdjoints> {
    let size = stretch.prefix.size();
    let run = |pack: &Pack| Isa::best().run(BackwardPass { stretch, data, pack, ends, wanted });
    let found: Vec<Vec<f64>> = match data.values.len() > MAX_SERIAL_ROWS {
        true => forward.packs.par_iter().map(run).collect(),
        false => forward.packs.iter().map(run).collect(),
    };
    let mut all = vec![DataAdjoints::zeros(size); data.tests];
    for (pack, found) in forward.packs.iter().zip(&found) {
        for (strand, found) in pack.strands.iter().zip(found.chunks_exact(sums(size))) {
            all[strand.test].numbers.iter_mut().zip(found).for_each(|(sum, own)| *sum += own);
        }
    }
    all
}

/// The backward pass over the strands of a pack. The result is the sums of each strand.
struct BackwardPass<'a> {
    stretch: &'a SegmentedStretch,
    data: StretchData<'a>,
    pack: &'a Pack,
    ends: &'a [f64],
    wanted: AdjointsWanted,
}

impl Kernel for BackwardPass<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Vec<f64> {
        with_steps!(self.stretch.prefix, N, DIAGONAL => T::apart(SizedPass::<T, N, DIAGONAL> { pass: self, lanes: PhantomData }))
    }
}

/// A [`BackwardPass`] over segments of `N` states.
struct SizedPass<'a, T, const N: usize, const DIAGONAL: bool> {
    pass: BackwardPass<'a>,
    lanes: PhantomData<T>,
}

/// Sums over rows, in lanes.
#[derive(Clone, Copy)]
struct RowSums<T, const N: usize> {
    u: T,
    uu: T,
    h: [T; N],
    rr: [[T; N]; N],
    phi: [[T; N]; N],
}

impl<T: Lanes, const N: usize> RowSums<T, N> {
    #[inline(always)]
    fn zeros() -> RowSums<T, N> {
        let zero = T::splat(0.0);
        RowSums { u: zero, uu: zero, h: [zero; N], rr: [[zero; N]; N], phi: [[zero; N]; N] }
    }

    /// Adds sums where `present` is one, and not where it is zero.
    #[inline(always)]
    fn add(&mut self, present: T, others: &RowSums<T, N>) {
        self.u = present.fma(others.u, self.u);
        self.uu = present.fma(others.uu, self.uu);
        for i in 0..N {
            self.h[i] = present.fma(others.h[i], self.h[i]);
            for j in 0..N {
                self.rr[i][j] = present.fma(others.rr[i][j], self.rr[i][j]);
                self.phi[i][j] = present.fma(others.phi[i][j], self.phi[i][j]);
            }
        }
    }

    #[inline(always)]
    fn store(&self, lane: usize, out: &mut [f64]) {
        out[0] = self.u.lane(lane);
        out[1] = self.uu.lane(lane);
        for i in 0..N {
            out[2 + i] = self.h[i].lane(lane);
            for j in 0..N {
                out[2 + N + i * N + j] = self.rr[i][j].lane(lane);
                out[2 + N + N * N + i * N + j] = self.phi[i][j].lane(lane);
            }
        }
    }
}

/// x̄ before each row of a block, and ē of each row.
struct BlockStates<T, const N: usize> {
    x: [[[T; N]; GROUPS]; MARK_ROWS],
    e: [[T; GROUPS]; MARK_ROWS],
}

impl<T: Lanes, const N: usize, const DIAGONAL: bool> Part for SizedPass<'_, T, N, DIAGONAL> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run(self) -> Vec<f64> {
        let BackwardPass { stretch, data, pack, ends, wanted } = self.pass;
        let (prefix, together, zero) = (&*stretch.prefix, GROUPS * T::COUNT, T::splat(0.0));
        let step = StepMatrices::<N, DIAGONAL>::of(prefix);
        let values = PackValues::new(stretch, data, pack, together);
        let (rows, segments) = (pack.rows, pack.strands.iter().map(|strand| strand.segments).max().unwrap_or(0));
        let blocks = rows.div_ceil(MARK_ROWS);
        let mut totals = [RowSums::<T, N>::zeros(); GROUPS];
        let mut block: Block = [[0.0; MAX_STRANDS]; MARK_ROWS];
        let mut states = BlockStates { x: [[[zero; N]; GROUPS]; MARK_ROWS], e: [[zero; GROUPS]; MARK_ROWS] };
        for segment in 0..segments {
            let (delta, mut r, present) = segment_ends::<T, N>(stretch, (pack, segment), ends);
            let mut own = [RowSums::<T, N>::zeros(); GROUPS];
            for number in (0..blocks).rev() {
                let from = number * MARK_ROWS;
                let many = MARK_ROWS.min(rows - from);
                let mark = &pack.marks[(segment * blocks + number) * together * N..][..together * N];
                values.read(segment, from, many, &mut block);
                let gains = &prefix.gains[from * (2 * N + 1)..(from + many) * (2 * N + 1)];
                let Psi = prefix.sensitivity(from);
                let mut x = [[zero; N]; GROUPS];
                for group in 0..GROUPS {
                    for i in 0..N {
                        x[group][i] = T::load(&mark[(group * N + i) * T::COUNT..]);
                        for j in 0..N {
                            x[group][i] = T::splat(Psi[i * N + j]).fma(delta[group][j], x[group][i]);
                        }
                    }
                }
                for (k, gains) in gains.chunks_exact(2 * N + 1).enumerate() {
                    states.x[k] = x;
                    for group in 0..GROUPS {
                        let e = step.innovation(&x[group], T::load(&block[k][group * T::COUNT..]));
                        states.e[k][group] = e;
                        x[group] = step.state(&x[group], gains, e);
                    }
                }
                r = rows_back(&step, (prefix, from, many), &states, r, wanted, &mut own);
            }
            for group in 0..GROUPS {
                totals[group].add(present[group], &own[group]);
            }
        }
        let mut out = vec![0.0; pack.strands.len() * sums(N)];
        for (lane, out) in out.chunks_exact_mut(sums(N)).enumerate() {
            totals[lane / T::COUNT].store(lane % T::COUNT, out);
        }
        out
    }
}

/// r before the rows `from..from + many` of segments, from r after them.
#[inline(always)]
fn rows_back<T: Lanes, const N: usize, const DIAGONAL: bool>(
    step: &StepMatrices<N, DIAGONAL>,
    (prefix, from, many): (&Prefix, usize, usize),
    states: &BlockStates<T, N>,
    mut r: [[T; N]; GROUPS],
    wanted: AdjointsWanted,
    sums: &mut [RowSums<T, N>; GROUPS],
) -> [[T; N]; GROUPS] {
    let mut own = *sums;
    for k in (0..many).rev() {
        let gains = &prefix.gains[(from + k) * (2 * N + 1)..][..2 * N + 1];
        let (before, after) = (&prefix.variance(from + k)[..N * N], &prefix.variance(from + k + 1)[..N * N]);
        for group in 0..GROUPS {
            let (r, own, x) = (&mut r[group], &mut own[group], &states.x[k][group]);
            let u = step.smoothing_error(r, gains, states.e[k][group]);
            own.u = own.u + u;
            own.uu = u.fma(u, own.uu);
            for i in 0..N {
                r[i] = T::splat(step.h[i]).fma(u, r[i]);
            }
            if wanted.equation {
                own.add_h(step, (x, after), (gains, r), u);
            }
            let r_before = step.adjoint(r);
            for i in 0..N {
                for j in 0..=i {
                    if !DIAGONAL || j == i {
                        own.rr[i][j] = r[i].fma(r[j], own.rr[i][j]);
                    }
                }
            }
            if wanted.motion {
                for j in 0..N {
                    let mut smoothed = x[j];
                    for i in 0..N {
                        smoothed = T::splat(before[j * N + i]).fma(r_before[i], smoothed);
                    }
                    for i in 0..N {
                        if !DIAGONAL || j == i {
                            own.phi[i][j] = r[i].fma(smoothed, own.phi[i][j]);
                        }
                    }
                }
            }
            *r = r_before;
        }
    }
    *sums = own;
    r
}

impl<T: Lanes, const N: usize> RowSums<T, N> {
    /// Adds u (x̄⁻ + P⁻r), where the measurement has reduced P⁻ by KSK' to P.
    #[inline(always)]
    fn add_h<const DIAGONAL: bool>(
        &mut self,
        step: &StepMatrices<N, DIAGONAL>,
        (x, P): (&[T; N], &[f64]),
        (gains, r): (&[f64], &[T; N]),
        u: T,
    ) {
        let S = 1.0 / gains[2 * N];
        for i in 0..N {
            let mut smoothed = step.predicted(x, i);
            for j in 0..N {
                smoothed = T::splat(P[i * N + j] + S * gains[i] * gains[j]).fma(r[j], smoothed);
            }
            self.h[i] = u.fma(smoothed, self.h[i]);
        }
    }
}

/// δ̂, r after a segment, and one where a lane has the segment, else zero.
#[inline(always)]
fn segment_ends<T: Lanes, const N: usize>(
    stretch: &SegmentedStretch,
    (pack, segment): (&Pack, usize),
    ends: &[f64],
) -> ([[T; N]; GROUPS], [[T; N]; GROUPS], [T; GROUPS]) {
    let zero = T::splat(0.0);
    let (mut delta, mut r, mut present) = ([[zero; N]; GROUPS], [[zero; N]; GROUPS], [zero; GROUPS]);
    for group in 0..GROUPS {
        let strands = |lane: usize| {
            let strand = pack.strands.get(group * T::COUNT + lane).filter(|strand| segment < strand.segments)?;
            Some(&ends[(strand.test * stretch.segments() + strand.first + segment) * 2 * N..][..2 * N])
        };
        let in_lanes = |number: &dyn Fn(usize) -> f64| {
            let mut lanes = [0.0; MAX_LANES];
            (0..T::COUNT).for_each(|lane| lanes[lane] = number(lane));
            T::load(&lanes)
        };
        for i in 0..N {
            delta[group][i] = in_lanes(&|lane| strands(lane).map_or(0.0, |ends| ends[i]));
            r[group][i] = in_lanes(&|lane| strands(lane).map_or(0.0, |ends| ends[N + i]));
        }
        present[group] = in_lanes(&|lane| if strands(lane).is_some() { 1.0 } else { 0.0 });
    }
    (delta, r, present)
}
