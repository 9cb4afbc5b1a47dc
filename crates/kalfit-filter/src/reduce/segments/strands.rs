//! The data pass over the segments of a stretch, many segments in lanes.
//!
//! A *strand* is a sequence of consecutive segments of one test in one lane. From a reference x̄ for the state at its
//! start,
//!
//! ```text
//! e = z - d - h'φx̂        x̂ ← φx̂ + Ke        y ← y + (T/S)'e        q ← q + e²/S
//! ```
//!
//! and the rows of a segment say about x = x̄ + δ, up to log S: -½q + y'δ - ½δ'Jδ. The next segment of the strand starts
//! where this one has ended. Strands depend on the stretch alone, so that no bit depends on lanes, threads or other tests.
#![expect(non_snake_case, reason = "the letters of the theory: K, T")]

use std::marker::PhantomData;

use kalfit_lanes::{Isa, Kernel, Lanes, MAX_LANES, Part};
use rayon::prelude::*;

use crate::reduce::scan::with_states;
use crate::reduce::segments::prefix::Prefix;
use crate::reduce::segments::{MAX_STATES, SegmentedStretch, Vector};

/// Number of registers of lanes that run together, so that one computes while the other waits.
pub(crate) const GROUPS: usize = 2;
/// Largest number of strands that run together.
pub(crate) const MAX_STRANDS: usize = GROUPS * MAX_LANES;
/// Number of rows from one stored x̂ to the next.
pub(crate) const MARK_ROWS: usize = 32;
/// Largest number of segments of a strand: long records have enough strands for all threads.
const MAX_SEGMENTS: usize = 16;
/// Number of strands into which a record is divided where its segments are few.
const STRANDS: usize = 16;
/// Number of rows above which strands run on several threads.
pub(crate) const MAX_SERIAL_ROWS: usize = 1 << 15;

/// Evaluates `$work` with the number of states of a prefix as the constant `$N`, and with whether φ and Q are diagonal as
/// the constant `$DIAGONAL`.
macro_rules! with_steps {
    ($prefix:expr, $N:ident, $DIAGONAL:ident => $work:expr) => {
        match $prefix.diagonal {
            true => with_states!($prefix.size(), $N => {
                const $DIAGONAL: bool = true;
                $work
            }),
            false => with_states!($prefix.size(), $N => {
                const $DIAGONAL: bool = false;
                $work
            }),
        }
    };
}
pub(crate) use with_steps;

/// z - d of the rows of a stretch of several tests: that of row k of test t is at k × tests + t.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StretchData<'a> {
    pub(crate) values: &'a [f64],
    pub(crate) tests: usize,
}

/// Consecutive segments of one test.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Strand {
    pub(crate) test: usize,
    pub(crate) first: usize,
    pub(crate) segments: usize,
    /// Reference for the state before the first segment.
    reference: [f64; MAX_STATES],
}

/// Strands that run together, with segments of one length.
#[derive(Debug)]
pub(crate) struct Pack {
    pub(crate) strands: Vec<Strand>,
    /// Number of rows of each segment.
    pub(crate) rows: usize,
    /// x̂ before every block of [`MARK_ROWS`] rows: segment, block, state, strand; empty where not wanted.
    pub(crate) marks: Vec<f64>,
}

/// Log-likelihood of the rows of each segment of each test, as a quadratic function of the state before the segment.
#[derive(Debug)]
pub(crate) struct SegmentData {
    segments: usize,
    /// (reference, y, last x̂, q) of each segment, test after test: 3N + 1 numbers.
    numbers: Vec<f64>,
    pub(crate) packs: Vec<Pack>,
}

/// (reference, y, last x̂, q) of one segment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OneSegment<const N: usize> {
    pub(crate) reference: Vector<N>,
    pub(crate) y: Vector<N>,
    pub(crate) last: Vector<N>,
    pub(crate) q: f64,
}

impl SegmentData {
    /// The numbers of a segment of a test.
    #[inline]
    pub(crate) fn of<const N: usize>(&self, test: usize, segment: usize) -> OneSegment<N> {
        let at = &self.numbers[(test * self.segments + segment) * (3 * N + 1)..][..3 * N + 1];
        let vector = |k: usize| Vector::from_column_slice(&at[k * N..(k + 1) * N]);
        OneSegment { reference: vector(0), y: vector(1), last: vector(2), q: at[3 * N] }
    }
}

impl SegmentedStretch {
    /// Runs the data of tests through the segments. `reference`: writes a state near that of a test before a segment,
    /// of which only those at the start of a strand are read. `marked`: whether x̂ is stored for a backward pass.
    pub(crate) fn run(
        &self,
        data: StretchData<'_>,
        reference: impl Fn(usize, usize, &mut [f64]),
        marked: bool,
    ) -> SegmentData {
        self.run_packs(data, (self.packs(data.tests, reference), self.segments()), marked)
    }

    /// Runs the data of tests through the first segment alone.
    pub(crate) fn run_first(&self, data: StretchData<'_>, reference: impl Fn(usize, usize, &mut [f64])) -> SegmentData {
        let strands: Vec<Strand> = (0..data.tests).map(|test| self.strand((test, 0, 1), &reference)).collect();
        self.run_packs(data, (packs(&strands, self.rows_of(0)).collect(), 1), false)
    }

    fn run_packs(&self, data: StretchData<'_>, (mut packs, segments): (Vec<Pack>, usize), marked: bool) -> SegmentData {
        let size = self.prefix.size();
        let run = |pack: &mut Pack| Isa::best().run(ValuePass { stretch: self, data, pack, marked });
        let found: Vec<Vec<f64>> = match data.values.len() > MAX_SERIAL_ROWS && segments > 1 {
            true => packs.par_iter_mut().map(run).collect(),
            false => packs.iter_mut().map(run).collect(),
        };
        let mut numbers = vec![0.0; data.tests * segments * (3 * size + 1)];
        for (pack, found) in packs.iter().zip(&found) {
            let mut found = found.chunks_exact(3 * size + 1);
            for strand in &pack.strands {
                let first = (strand.test * segments + strand.first) * (3 * size + 1);
                for to in numbers[first..].chunks_exact_mut(3 * size + 1).take(strand.segments) {
                    to.copy_from_slice(found.next().expect("a segment has its numbers"));
                }
            }
        }
        SegmentData { segments, numbers, packs }
    }

    fn strand(
        &self,
        (test, first, segments): (usize, usize, usize),
        reference: &impl Fn(usize, usize, &mut [f64]),
    ) -> Strand {
        let mut strand = Strand { test, first, segments, reference: [0.0; MAX_STATES] };
        reference(test, first, &mut strand.reference[..self.prefix.size()]);
        strand
    }

    /// The strands of all tests, full segments before the last, shorter one.
    fn packs(&self, tests: usize, reference: impl Fn(usize, usize, &mut [f64])) -> Vec<Pack> {
        let rows = self.prefix.rows();
        let (full, rest) = (self.rows.len() / rows, self.rows.len() % rows);
        let each = full.div_ceil(STRANDS).clamp(1, MAX_SEGMENTS);
        let of_all = |first: usize, segments: usize| {
            (0..tests).map(|test| self.strand((test, first, segments), &reference)).collect::<Vec<Strand>>()
        };
        let of_full: Vec<Strand> =
            (0..full).step_by(each).flat_map(|first| of_all(first, each.min(full - first))).collect();
        let of_rest = if rest > 0 { of_all(full, 1) } else { Vec::new() };
        packs(&of_full, rows).chain(packs(&of_rest, rest)).collect()
    }
}

/// Packs of strands with segments of one length.
fn packs(strands: &[Strand], rows: usize) -> impl Iterator<Item = Pack> {
    let pack = move |strands: &[Strand]| Pack { strands: strands.to_vec(), rows, marks: Vec::new() };
    strands.chunks(GROUPS * Isa::best().lanes()).map(pack)
}

/// Where the values of the strands of a pack are, one strand in each lane; lanes without a strand repeat the first strand.
pub(crate) struct PackValues<'a> {
    data: StretchData<'a>,
    /// Index of the first value of each lane, and the number of segments of the lane.
    lanes: [(usize, usize); MAX_STRANDS],
    /// Number of rows of each segment.
    rows: usize,
    together: usize,
}

/// Values of the rows of a block, of one register of lanes after the other.
pub(crate) type Block = [[f64; MAX_STRANDS]; MARK_ROWS];

impl<'a> PackValues<'a> {
    pub(crate) fn new(
        stretch: &SegmentedStretch,
        data: StretchData<'a>,
        pack: &Pack,
        together: usize,
    ) -> PackValues<'a> {
        let lane = |lane: usize| {
            let strand = pack.strands.get(lane).unwrap_or(&pack.strands[0]);
            (strand.first * stretch.prefix.rows() * data.tests + strand.test, strand.segments)
        };
        PackValues { data, lanes: std::array::from_fn(lane), rows: pack.rows, together }
    }

    /// Reads `many` rows from row `at` of a segment on; lanes that lack the segment read their last one.
    #[inline(always)]
    pub(crate) fn read(&self, segment: usize, at: usize, many: usize, block: &mut Block) {
        let StretchData { values, tests } = self.data;
        for lane in 0..self.together {
            let (first, segments) = self.lanes[lane];
            let start = first + (segment.min(segments - 1) * self.rows + at) * tests;
            let own = &values[start..start + (many - 1) * tests + 1];
            for k in 0..many {
                block[k][lane] = own[k * tests];
            }
        }
    }
}

/// The data pass over the strands of a pack. The result is (reference, y, last x̂, q) of each segment, strand after strand.
struct ValuePass<'a> {
    stretch: &'a SegmentedStretch,
    data: StretchData<'a>,
    pack: &'a mut Pack,
    marked: bool,
}

impl Kernel for ValuePass<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run<T: Lanes>(self) -> Vec<f64> {
        with_steps!(self.stretch.prefix, N, DIAGONAL => T::apart(SizedPass::<T, N, DIAGONAL> { pass: self, lanes: PhantomData }))
    }
}

/// A [`ValuePass`] over segments of `N` states.
struct SizedPass<'a, T, const N: usize, const DIAGONAL: bool> {
    pass: ValuePass<'a>,
    lanes: PhantomData<T>,
}

impl<T: Lanes, const N: usize, const DIAGONAL: bool> Part for SizedPass<'_, T, N, DIAGONAL> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run(self) -> Vec<f64> {
        let ValuePass { stretch, data, pack, marked } = self.pass;
        let (prefix, together, zero) = (&*stretch.prefix, GROUPS * T::COUNT, T::splat(0.0));
        let step = StepMatrices::<N, DIAGONAL>::of(prefix);
        let values = PackValues::new(stretch, data, pack, together);
        let (rows, segments) = (pack.rows, pack.strands.iter().map(|strand| strand.segments).max().unwrap_or(0));
        let mut out = vec![0.0; pack.strands.iter().map(|strand| strand.segments).sum::<usize>() * (3 * N + 1)];
        let mut x = references::<T, N>(&pack.strands);
        let mut block: Block = [[0.0; MAX_STRANDS]; MARK_ROWS];
        for segment in 0..segments {
            let (reference, mut y, mut q) = (x, [[zero; N]; GROUPS], [zero; GROUPS]);
            for from in (0..rows).step_by(MARK_ROWS) {
                let many = MARK_ROWS.min(rows - from);
                if marked {
                    store_mark(&x, &mut pack.marks);
                }
                values.read(segment, from, many, &mut block);
                let gains = prefix.gains[from * (2 * N + 1)..].chunks_exact(2 * N + 1);
                for (values, gains) in block[..many].iter().zip(gains) {
                    for group in 0..GROUPS {
                        let e = step.innovation(&x[group], T::load(&values[group * T::COUNT..]));
                        x[group] = step.state(&x[group], gains, e);
                        for i in 0..N {
                            y[group][i] = T::splat(gains[N + i]).fma(e, y[group][i]);
                        }
                        q[group] = (e * T::splat(gains[2 * N])).fma(e, q[group]);
                    }
                }
            }
            store_segment(&pack.strands, segment, ([&reference, &y, &x], &q), &mut out);
        }
        out
    }
}

/// The references of strands, in lanes.
#[inline(always)]
fn references<T: Lanes, const N: usize>(strands: &[Strand]) -> [[T; N]; GROUPS] {
    let mut x = [[T::splat(0.0); N]; GROUPS];
    for group in 0..GROUPS {
        for i in 0..N {
            let mut lanes = [0.0; MAX_LANES];
            for lane in 0..T::COUNT {
                lanes[lane] = strands.get(group * T::COUNT + lane).map_or(0.0, |strand| strand.reference[i]);
            }
            x[group][i] = T::load(&lanes);
        }
    }
    x
}

#[inline(always)]
fn store_mark<T: Lanes, const N: usize>(x: &[[T; N]; GROUPS], marks: &mut Vec<f64>) {
    let mut lanes = [0.0; MAX_LANES];
    for x in x {
        for x in x {
            x.store(&mut lanes);
            marks.extend_from_slice(&lanes[..T::COUNT]);
        }
    }
}

/// Writes (reference, y, last x̂, q) of a segment of each strand that has it.
#[inline(always)]
fn store_segment<T: Lanes, const N: usize>(
    strands: &[Strand],
    segment: usize,
    ([reference, y, last], q): ([&[[T; N]; GROUPS]; 3], &[T; GROUPS]),
    out: &mut [f64],
) {
    let mut first = 0;
    for (lane, strand) in strands.iter().enumerate() {
        let (group, lane) = (lane / T::COUNT, lane % T::COUNT);
        if segment < strand.segments {
            let own = &mut out[(first + segment) * (3 * N + 1)..][..3 * N + 1];
            for i in 0..N {
                own[i] = reference[group][i].lane(lane);
                own[N + i] = y[group][i].lane(lane);
                own[2 * N + i] = last[group][i].lane(lane);
            }
            own[3 * N] = q[group].lane(lane);
        }
        first += strand.segments;
    }
}

/// φ, h and φ'h of a step.
///
/// `DIAGONAL`: φ and Q are diagonal.
pub(crate) struct StepMatrices<const N: usize, const DIAGONAL: bool> {
    pub(crate) phi: [[f64; N]; N],
    pub(crate) h: [f64; N],
    g: [f64; N],
}

impl<const N: usize, const DIAGONAL: bool> StepMatrices<N, DIAGONAL> {
    pub(crate) fn of(prefix: &Prefix) -> StepMatrices<N, DIAGONAL> {
        let phi: [[f64; N]; N] = std::array::from_fn(|i| std::array::from_fn(|j| prefix.phi[i * N + j]));
        let h: [f64; N] = std::array::from_fn(|i| prefix.h[i]);
        let g = std::array::from_fn(|j| (0..N).map(|i| h[i] * phi[i][j]).sum());
        StepMatrices { phi, h, g }
    }

    /// e of a value z after a step from x.
    #[inline(always)]
    pub(crate) fn innovation<T: Lanes>(&self, x: &[T; N], z: T) -> T {
        // two sums, so that no addition waits for all others
        let mut sums = [z, T::splat(0.0)];
        for i in 0..N {
            sums[i % 2] = T::splat(self.g[i]).fnma(x[i], sums[i % 2]);
        }
        sums[0] + sums[1]
    }

    /// u = e/S - K'r; `gains`: (K, T'/S, 1/S) of the row.
    #[inline(always)]
    pub(crate) fn smoothing_error<T: Lanes>(&self, r: &[T; N], gains: &[f64], e: T) -> T {
        // two sums, so that no addition waits for all others
        let mut sums = [e * T::splat(gains[2 * N]), T::splat(0.0)];
        for i in 0..N {
            sums[i % 2] = T::splat(gains[i]).fnma(r[i], sums[i % 2]);
        }
        sums[0] + sums[1]
    }

    /// φ'r.
    #[inline(always)]
    pub(crate) fn adjoint<T: Lanes>(&self, r: &[T; N]) -> [T; N] {
        let mut before = [T::splat(0.0); N];
        for i in 0..N {
            before[i] = T::splat(self.phi[i][i]) * r[i];
            for j in 0..N {
                if !DIAGONAL && j != i {
                    before[i] = T::splat(self.phi[j][i]).fma(r[j], before[i]);
                }
            }
        }
        before
    }

    /// Entry i of φx.
    #[inline(always)]
    pub(crate) fn predicted<T: Lanes>(&self, x: &[T; N], i: usize) -> T {
        let mut next = T::splat(self.phi[i][i]) * x[i];
        for j in 0..N {
            if !DIAGONAL && j != i {
                next = T::splat(self.phi[i][j]).fma(x[j], next);
            }
        }
        next
    }

    /// φx + Ke.
    #[inline(always)]
    pub(crate) fn state<T: Lanes>(&self, x: &[T; N], K: &[f64], e: T) -> [T; N] {
        let mut next = [T::splat(0.0); N];
        for i in 0..N {
            next[i] = self.predicted(x, i);
            next[i] = T::splat(K[i]).fma(e, next[i]);
        }
        next
    }
}
