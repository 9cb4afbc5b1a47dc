//! The backward pass of tests with designs of one shape, a test in each lane.
#![expect(non_snake_case, reason = "the letters of the theory: K, T, N")]

use kalfit_lanes::{Kernel, Lanes, interleaved};

use crate::reduce::{DataBlock, DataView, Design, DesignBatch, Entries, Numbers, SideBySide, at, innovation};
use crate::score::backward::adjoint::{Adjoint, ScalarAdjoint};
use crate::score::backward::filtered::{Begin, FilterSnapshot, FilteredMoments};
use crate::score::backward::run::{AdjointsWanted, TerminalAdjoint};
use crate::score::backward::scalar_measurement::{PosteriorRoot, ScalarMeasurement};
use crate::score::backward::sink::TransitionAdjoint;
use crate::score::moments::Moments;

/// The backward pass of a batch of tests, after their filters.
#[derive(Debug)]
pub(crate) struct BatchBackward<'a> {
    pub(crate) block: &'a DataBlock,
    pub(crate) gained: &'a DesignBatch,
    pub(crate) longest: &'a Design,
    /// One for each test, with as many columns.
    pub(crate) moments: &'a [&'a Moments],
    /// One for each test, or none.
    pub(crate) endings: &'a [&'a TerminalAdjoint],
    pub(crate) wanted: AdjointsWanted,
}

/// The adjoints of all of them, each number of one test beside the same of the others.
#[derive(Debug, Clone)]
pub(crate) struct BatchAdjoints {
    lanes: usize,
    /// ∂ℓ/∂R, ∂ℓ/∂(z - d) and, if it is wanted, ∂ℓ/∂h, of each measurement.
    rows: Vec<f64>,
    /// ∂ℓ/∂φ, ∂ℓ/∂Q and ∂ℓ/∂b of each transition.
    moves: Vec<f64>,
    mean: Vec<f64>,
    variance: Vec<f64>,
    /// Numbers of a measurement; of a transition of each kind.
    sizes: (usize, [usize; 3]),
}

impl Kernel for BatchBackward<'_> {
    type Output = BatchAdjoints;

    #[inline(always)]
    fn run<T: Lanes>(self) -> BatchAdjoints {
        let numbers = BatchNumbers { shape: self.longest, gained: self.gained, data: self.block.side() };
        let root = interleaved::<T>(self.moments.len(), |lane| &self.moments[lane].root);
        let mean = interleaved::<T>(self.moments.len(), |lane| &self.moments[lane].mean);
        let columns = self.moments[0].columns;
        let unknown = PosteriorRoot { frame: &self.longest.frame, root: &root, columns, wanted: self.wanted };
        let forward = Forward::new(&numbers, &mean, &unknown);
        let mut ending = None;
        if let Some(first) = self.endings.first() {
            debug_assert!(first.r.len() == unknown.frame.n, "one for each state");
            let many = self.endings.len();
            ending = Some([
                interleaved::<T>(many, |lane| &self.endings[lane].r),
                interleaved::<T>(many, |lane| &self.endings[lane].rho),
                interleaved::<T>(many, |lane| &self.endings[lane].N),
            ]);
        }
        let ending = ending.as_ref().map(|[r, rho, N]| [&**r, &**rho, &**N]);
        forward.back(&numbers, &unknown, ending)
    }
}

/// What the forward filter passed through.
struct Forward<T> {
    /// ē of each measurement.
    e: Vec<T>,
    /// Before each transition, and before each measurement, as [`FilteredMoments::save`] keeps it.
    left: Vec<T>,
    before: Vec<T>,
    stride: usize,
}

/// What the pass reads of a batch, in lanes. A test that is shorter than the longest goes on with measurements that say nothing, and
/// transitions that forget everything.
struct BatchNumbers<'a> {
    /// Of the longest: its numbers do not count.
    shape: &'a Design,
    gained: &'a DesignBatch,
    data: DataView<'a>,
}

impl<'a> BatchNumbers<'a> {
    #[inline(always)]
    fn line<T: Lanes>(&self, (line, row): (usize, usize)) -> ScalarMeasurement<'a, T, SideBySide<'a>> {
        let gained = self.gained;
        let ((states, h, noise), (weight, K)) = (gained.line(self.shape, line), gained.gains(row));
        ScalarMeasurement { states, h, noise, weight, K, T: Numbers::<T>::sensitivities(gained, row) }
    }
}

impl<T: Lanes> Forward<T> {
    #[inline(always)]
    fn new(numbers: &BatchNumbers<'_>, mean: &[T], unknown: &PosteriorRoot<'_, T>) -> Forward<T> {
        let (design, driven) = (numbers.shape, unknown.frame.driven.len());
        let (n, r) = (unknown.frame.n, unknown.frame.r);
        let stride = n + r * r + n * unknown.columns;
        let steps = if unknown.wanted.motion { design.runs.iter().map(|run| run.count).sum() } else { 0 };
        let rows = if unknown.wanted.equation { design.rows() } else { 0 };
        let mut forward = Forward {
            e: Vec::with_capacity(design.rows()),
            left: Vec::with_capacity(steps * stride),
            before: Vec::with_capacity(rows * stride),
            stride,
        };
        let mut now = FilteredMoments::<T>::default();
        let (start, variance) = (SideBySide(numbers.data.start), SideBySide(&numbers.gained.variance));
        now.begin(&Begin { start, variance, mean }, unknown);
        let mut inputs = SideBySide(numbers.data.inputs);
        let (mut row, mut first) = (0, 0);
        for (at_run, run) in design.runs.iter().enumerate() {
            for _ in 0..run.count {
                if let Some(transition) = Numbers::<T>::transition(numbers.gained, design, at_run) {
                    if unknown.wanted.motion {
                        now.save(&mut forward.left);
                    }
                    now.advance(transition, inputs, unknown);
                    inputs = Entries::<T>::skip(inputs, driven);
                }
                for number in first..run.lines {
                    if unknown.wanted.equation {
                        now.save(&mut forward.before);
                    }
                    let line = numbers.line((number, row));
                    let e = innovation(&now.x, (line.states, line.h), at(numbers.data.values, row));
                    now.measure(&line, e, unknown);
                    forward.e.push(e);
                    row += 1;
                }
            }
            first = run.lines;
        }
        forward
    }

    #[inline(always)]
    fn back(
        self,
        numbers: &BatchNumbers<'_>,
        unknown: &PosteriorRoot<'_, T>,
        ending: Option<[&[T]; 3]>,
    ) -> BatchAdjoints {
        let (design, frame, wanted) = (numbers.shape, unknown.frame, unknown.wanted);
        let (n, zero) = (frame.n, T::splat(0.0));
        let sizes = (n, frame.r);
        let mut adjoint = Adjoint::<T>::default();
        adjoint.begin(unknown, ending);
        let width = 2 + if wanted.equation { n } else { 0 };
        let mut rows = vec![0.0; design.rows() * width * T::COUNT];
        let (mut moves, mut kinds) = (Vec::new(), [0; 3]);
        let (mut bar, mut moved) = (vec![zero; width], TransitionAdjoint::<T>::default());
        let (mut transitions, mut row) = (0, design.rows());
        for run in &design.runs {
            transitions += if run.transition.is_some() { run.count } else { 0 };
        }
        for at_run in (0..design.runs.len()).rev() {
            let run = &design.runs[at_run];
            let first = if at_run == 0 { 0 } else { design.runs[at_run - 1].lines };
            for _ in 0..run.count {
                for number in (first..run.lines).rev() {
                    row -= 1;
                    let (scalars, h) = bar.split_at_mut(2);
                    let (noise, value) = scalars.split_at_mut(1);
                    let mut equation = None;
                    if wanted.equation {
                        equation =
                            Some((h, FilterSnapshot::new(&self.before[row * self.stride..][..self.stride], sizes)));
                    }
                    let out = ScalarAdjoint { noise: &mut noise[0], value: &mut value[0], h: equation };
                    adjoint.measured(&numbers.line((number, row)), self.e[row], unknown, out);
                    for k in 0..width {
                        bar[k].store(&mut rows[(row * width + k) * T::COUNT..]);
                    }
                }
                let Some(transition) = Numbers::<T>::transition(numbers.gained, design, at_run) else { continue };
                if moves.is_empty() {
                    kinds = [transition.pattern.columns.len(), transition.pattern.pairs.len(), frame.driven.len()];
                    moves.resize(transitions * kinds.iter().sum::<usize>() * T::COUNT, 0.0);
                }
                transitions -= 1;
                let mut left = None;
                if wanted.motion {
                    left = Some(FilterSnapshot::new(&self.left[transitions * self.stride..][..self.stride], sizes));
                }
                adjoint.moved(unknown, transition, left, &mut moved);
                let mut at = transitions * kinds.iter().sum::<usize>();
                for list in [&moved.phi, &moved.q, &moved.input] {
                    for x in list {
                        x.store(&mut moves[at * T::COUNT..]);
                        at += 1;
                    }
                }
            }
        }
        let mut variance = Vec::new();
        adjoint.variance(unknown, &mut variance);
        let (mean, variance) = (apart(&adjoint.r), apart(&variance));
        BatchAdjoints { lanes: T::COUNT, rows, moves, mean, variance, sizes: (width, kinds) }
    }
}

#[inline(always)]
fn apart<T: Lanes>(numbers: &[T]) -> Vec<f64> {
    let mut all = vec![0.0; numbers.len() * T::COUNT];
    for (k, x) in numbers.iter().enumerate() {
        x.store(&mut all[k * T::COUNT..]);
    }
    all
}

impl BatchAdjoints {
    /// ∂ℓ/∂R, ∂ℓ/∂(z - d) and, if it is wanted, ∂ℓ/∂h to all states, of each measurement; how many numbers those are.
    pub(crate) fn rows(&self) -> (&[f64], usize) {
        (&self.rows, self.sizes.0)
    }

    /// The same, to be changed.
    pub(crate) fn rows_mut(&mut self) -> (&mut [f64], usize) {
        (&mut self.rows, self.sizes.0)
    }

    /// ∂ℓ/∂φ, ∂ℓ/∂Q and ∂ℓ/∂b of each transition; how many numbers those are.
    pub(crate) fn moves(&self) -> (&[f64], usize) {
        (&self.moves, self.sizes.1.iter().sum())
    }

    /// ∂ℓ/∂a and ∂ℓ/∂P0 of the test in a lane.
    pub(crate) fn start(&self, lane: usize) -> [Vec<f64>; 2] {
        [&self.mean, &self.variance].map(|all| all.iter().skip(lane).step_by(self.lanes).copied().collect())
    }
}
