//! The backward pass of tests with designs of one shape, a test in each lane.
#![expect(non_snake_case, reason = "the letters of the theory: K, T, N")]

use std::ops::Range;

use kalfit_lanes::{Kernel, Lanes, interleaved};

use crate::reduce::{
    DataBlock, DataView, Design, DesignBatch, Entries, Numbers, SideBySide, TransitionView, at as number_at, innovation,
};
use crate::score::backward::adjoint::{Adjoint, ScalarAdjoint};
use crate::score::backward::filtered::{FilterSnapshot, FilteredMoments, InitialState};
use crate::score::backward::input::{AdjointsWanted, TerminalAdjoint};
use crate::score::backward::scalar_measurement::{PosteriorRoot, ScalarMeasurement};
use crate::score::backward::sink::TransitionAdjoint;
use crate::score::moments::Moments;

/// The backward pass of a batch of tests that the filters have passed.
#[derive(Debug)]
pub(crate) struct BatchBackward<'a> {
    pub(crate) block: &'a DataBlock,
    pub(crate) designs: &'a DesignBatch,
    pub(crate) shape: &'a Design,
    /// Moments of each test, all with the same number of columns.
    pub(crate) moments: &'a [&'a Moments],
    /// Terminal adjoints of each test; empty where all are zero.
    pub(crate) endings: &'a [&'a TerminalAdjoint],
    pub(crate) wanted: AdjointsWanted,
}

/// The adjoints of all tests of a batch, in lanes: number k of the test in lane l is at index k × lanes + l of a list.
#[derive(Debug, Clone)]
pub(crate) struct BatchAdjoints {
    lanes: usize,
    /// ∂ℓ/∂R, ∂ℓ/∂(z - d) and, if wanted, ∂ℓ/∂h, of each measurement.
    rows: Vec<f64>,
    /// ∂ℓ/∂φ, ∂ℓ/∂Q and ∂ℓ/∂b of each transition.
    transition_adjoints: Vec<f64>,
    mean: Vec<f64>,
    variance: Vec<f64>,
    /// (adjoints per measurement, adjoints per transition of [φ, Q, b]), as counts.
    sizes: (usize, [usize; 3]),
}

impl Kernel for BatchBackward<'_> {
    type Output = BatchAdjoints;

    #[inline(always)]
    fn run<T: Lanes>(self) -> BatchAdjoints {
        let numbers = BatchNumbers { shape: self.shape, designs: self.designs, data: self.block.view() };
        let root = interleaved::<T>(self.moments.len(), |lane| &self.moments[lane].root);
        let mean = interleaved::<T>(self.moments.len(), |lane| &self.moments[lane].mean);
        let columns = self.moments[0].columns;
        let posterior = PosteriorRoot { frame: &self.shape.frame, root: &root, columns, wanted: self.wanted };
        let mut ending = None;
        if let Some(first) = self.endings.first() {
            debug_assert!(first.r.len() == posterior.frame.n, "one for each state");
            let many = self.endings.len();
            ending = Some([
                interleaved::<T>(many, |lane| &self.endings[lane].r),
                interleaved::<T>(many, |lane| &self.endings[lane].rho),
                interleaved::<T>(many, |lane| &self.endings[lane].N),
            ]);
        }
        let ending = ending.as_ref().map(|[r, rho, N]| [&**r, &**rho, &**N]);
        BatchPass::new(numbers, posterior).run(&mean, ending)
    }
}

/// The coefficients and data of a batch, in lanes; each step is a run. A step or a measurement that a test lacks has no
/// effect: φ = I, Q = 0, h = 0, R = 1.
struct BatchNumbers<'a> {
    /// A design with the shape that all designs share; the coefficients of this design are not read.
    shape: &'a Design,
    designs: &'a DesignBatch,
    data: DataView<'a>,
}

impl<'a> BatchNumbers<'a> {
    #[inline(always)]
    fn line<T: Lanes>(&self, (line, row): (usize, usize)) -> ScalarMeasurement<'a, T, SideBySide<'a>> {
        let designs = self.designs;
        let ((states, h, noise), (weight, K)) = (designs.line(self.shape, line), designs.gains(row));
        ScalarMeasurement { states, h, noise, weight, K, T: Numbers::<T>::sensitivities(designs, row) }
    }

    /// The lines of a run.
    #[inline(always)]
    fn lines(&self, run: usize) -> Range<usize> {
        let first = if run == 0 { 0 } else { self.shape.runs[run - 1].lines };
        first..self.shape.runs[run].lines
    }
}

/// Most numbers per test that are stored for the backward pass; for longer tests, the filter is run again from stored
/// states.
const MAX_STORED_NUMBERS: usize = 1 << 16;

/// The filter over a batch, and the stored states of the filter.
struct BatchPass<'a, T> {
    numbers: BatchNumbers<'a>,
    posterior: PosteriorRoot<'a, T>,
    now: FilteredMoments<T>,
    /// ē of each measurement.
    e: Vec<T>,
    /// States of the filter before each transition of the current block of steps (`left`), and before each measurement
    /// (`before`), as [`FilteredMoments::save`] writes them.
    left: Vec<T>,
    before: Vec<T>,
    stride: usize,
}

/// Position of a pass: the indices of the next run, row and transition.
#[derive(Debug, Clone, Copy, Default)]
struct BatchPosition {
    run: usize,
    row: usize,
    transition: usize,
}

impl<'a, T: Lanes> BatchPass<'a, T> {
    #[inline(always)]
    fn new(numbers: BatchNumbers<'a>, posterior: PosteriorRoot<'a, T>) -> BatchPass<'a, T> {
        let (n, r) = (posterior.frame.n, posterior.frame.r);
        let (e, stride) = (Vec::with_capacity(numbers.shape.rows()), n + r * r + n * posterior.columns);
        BatchPass {
            numbers,
            posterior,
            now: FilteredMoments::default(),
            e,
            left: Vec::new(),
            before: Vec::new(),
            stride,
        }
    }

    /// The forward and the backward pass over all steps.
    #[inline(always)]
    fn run(mut self, mean: &[T], ending: Option<[&[T]; 3]>) -> BatchAdjoints {
        let (start, variance) = (SideBySide(self.numbers.data.start), SideBySide(&self.numbers.designs.variance));
        self.now.begin(&InitialState { start, variance, mean }, &self.posterior);
        let (frame, needs_covariance) = (self.posterior.frame, self.posterior.needs_covariance());
        let (runs, block) = (self.numbers.shape.runs.len(), self.block());
        let (mut positions, mut marks) = (vec![BatchPosition::default()], Vec::new());
        for first in (0..runs).step_by(block) {
            if needs_covariance {
                self.now.save(&mut marks);
            }
            positions.push(self.forward(positions[positions.len() - 1], runs.min(first + block)));
        }
        let mut back = BatchBack::new(&self, ending);
        for part in (1..positions.len()).rev() {
            let (from, to) = (positions[part - 1], positions[part]);
            if needs_covariance && to.run < runs {
                self.now.load(&marks[(part - 1) * self.stride..][..self.stride], (frame.n, frame.r));
                self.forward(from, to.run);
            }
            back.pass_back(&self, from, to);
        }
        back.end(&self.posterior)
    }

    /// Number of steps in a block.
    fn block(&self) -> usize {
        let (design, wanted) = (self.numbers.shape, self.posterior.wanted);
        let rows = if wanted.equation { design.rows().div_ceil(design.runs.len().max(1)) } else { 0 };
        (MAX_STORED_NUMBERS / self.stride.max(1) / (usize::from(wanted.motion) + rows).max(1)).max(1)
    }

    /// Runs the filter from position `at` to the position before run `to`, and returns the latter position.
    #[inline(always)]
    fn forward(&mut self, mut at: BatchPosition, to: usize) -> BatchPosition {
        let BatchPass { numbers, posterior, now, e, left, before, .. } = self;
        let (design, driven) = (numbers.shape, posterior.frame.driven.len());
        left.clear();
        before.clear();
        while at.run < to {
            if let Some(transition) = Numbers::<T>::transition(numbers.designs, design, at.run) {
                if posterior.wanted.motion {
                    now.save(left);
                }
                let inputs = Entries::<T>::skip(SideBySide(numbers.data.inputs), at.transition * driven);
                now.advance(transition, inputs, posterior);
                at.transition += 1;
            }
            for number in numbers.lines(at.run) {
                if posterior.wanted.equation {
                    now.save(before);
                }
                let line = numbers.line((number, at.row));
                if at.row == e.len() {
                    e.push(innovation(&now.x, (line.states, line.h), number_at(numbers.data.values, at.row)));
                }
                now.measure(&line, e[at.row], posterior);
                at.row += 1;
            }
            at.run += 1;
        }
        at
    }
}

/// The backward pass over a batch.
struct BatchBack<T> {
    adjoint: Adjoint<T>,
    /// Adjoints of one measurement (`bar`), and of one transition (`moved`).
    bar: Vec<T>,
    moved: TransitionAdjoint<T>,
    all: BatchAdjoints,
}

impl<T: Lanes> BatchBack<T> {
    #[inline(always)]
    fn new(pass: &BatchPass<'_, T>, ending: Option<[&[T]; 3]>) -> BatchBack<T> {
        let (design, frame) = (pass.numbers.shape, pass.posterior.frame);
        let mut adjoint = Adjoint::<T>::default();
        adjoint.begin(&pass.posterior, ending);
        let width = 2 + if pass.posterior.wanted.equation { frame.n } else { 0 };
        let kinds =
            design.pattern().map_or([0; 3], |pattern| [pattern.columns.len(), pattern.pairs.len(), frame.driven.len()]);
        let transition_adjoints =
            design.runs.iter().filter(|run| run.transition.is_some()).count() * kinds.iter().sum::<usize>();
        let all = BatchAdjoints {
            lanes: T::COUNT,
            rows: vec![0.0; design.rows() * width * T::COUNT],
            transition_adjoints: vec![0.0; transition_adjoints * T::COUNT],
            mean: Vec::new(),
            variance: Vec::new(),
            sizes: (width, kinds),
        };
        BatchBack { adjoint, bar: vec![T::splat(0.0); width], moved: TransitionAdjoint::default(), all }
    }

    /// The backward pass over the steps between two positions, which the filter has just passed.
    #[inline(always)]
    fn pass_back(&mut self, pass: &BatchPass<'_, T>, from: BatchPosition, to: BatchPosition) {
        let BatchPass { numbers, posterior, stride, .. } = pass;
        let (sizes, (mut row, mut transition)) = ((posterior.frame.n, posterior.frame.r), (to.row, to.transition));
        for run in (from.run..to.run).rev() {
            for number in numbers.lines(run).rev() {
                row -= 1;
                let mut before = None;
                if posterior.wanted.equation {
                    before = Some(FilterSnapshot::new(&pass.before[(row - from.row) * stride..][..*stride], sizes));
                }
                self.measured(&numbers.line((number, row)), (row, pass.e[row]), posterior, before);
            }
            if let Some(of) = Numbers::<T>::transition(numbers.designs, numbers.shape, run) {
                transition -= 1;
                let mut left = None;
                if posterior.wanted.motion {
                    let kept = &pass.left[(transition - from.transition) * stride..][..*stride];
                    left = Some(FilterSnapshot::new(kept, sizes));
                }
                self.moved(of, transition, posterior, left);
            }
        }
    }

    #[inline(always)]
    fn measured<E: Entries<T>>(
        &mut self,
        line: &ScalarMeasurement<'_, T, E>,
        (row, e): (usize, T),
        posterior: &PosteriorRoot<'_, T>,
        before: Option<FilterSnapshot<'_, T>>,
    ) {
        let BatchBack { adjoint, bar, all, .. } = self;
        let (scalars, h) = bar.split_at_mut(2);
        let (noise, value) = scalars.split_at_mut(1);
        let h = before.map(|before| (h, before));
        adjoint.measured(line, e, posterior, ScalarAdjoint { noise: &mut noise[0], value: &mut value[0], h });
        let width = bar.len();
        for k in 0..width {
            bar[k].store(&mut all.rows[(row * width + k) * T::COUNT..]);
        }
    }

    #[inline(always)]
    fn moved<E: Entries<T>>(
        &mut self,
        transition: TransitionView<'_, E>,
        number: usize,
        posterior: &PosteriorRoot<'_, T>,
        left: Option<FilterSnapshot<'_, T>>,
    ) {
        let BatchBack { adjoint, moved, all, .. } = self;
        adjoint.moved(posterior, transition, left, moved);
        let mut at = number * all.sizes.1.iter().sum::<usize>();
        for list in [&moved.phi, &moved.q, &moved.input] {
            for x in list {
                x.store(&mut all.transition_adjoints[at * T::COUNT..]);
                at += 1;
            }
        }
    }

    #[inline(always)]
    fn end(mut self, posterior: &PosteriorRoot<'_, T>) -> BatchAdjoints {
        let mut variance = Vec::new();
        self.adjoint.start_covariance_adjoint(posterior, &mut variance);
        (self.all.mean, self.all.variance) = (to_numbers(&self.adjoint.r), to_numbers(&variance));
        self.all
    }
}

#[inline(always)]
fn to_numbers<T: Lanes>(numbers: &[T]) -> Vec<f64> {
    let mut all = vec![0.0; numbers.len() * T::COUNT];
    for (k, x) in numbers.iter().enumerate() {
        x.store(&mut all[k * T::COUNT..]);
    }
    all
}

impl BatchAdjoints {
    /// ∂ℓ/∂R, ∂ℓ/∂(z - d) and, if wanted, ∂ℓ/∂h over all states, of each measurement; and the number of adjoints per
    /// measurement.
    pub(crate) fn rows(&self) -> (&[f64], usize) {
        (&self.rows, self.sizes.0)
    }

    /// The adjoints of the measurements, mutable, and the number of adjoints per measurement.
    pub(crate) fn rows_mut(&mut self) -> (&mut [f64], usize) {
        (&mut self.rows, self.sizes.0)
    }

    /// ∂ℓ/∂φ, ∂ℓ/∂Q and ∂ℓ/∂b of each transition, and the number of adjoints per transition.
    pub(crate) fn transition_adjoints(&self) -> (&[f64], usize) {
        (&self.transition_adjoints, self.sizes.1.iter().sum())
    }

    /// ∂ℓ/∂a and ∂ℓ/∂P0 of the test in a lane.
    pub(crate) fn start(&self, lane: usize) -> [Vec<f64>; 2] {
        [&self.mean, &self.variance].map(|all| all.iter().skip(lane).step_by(self.lanes).copied().collect())
    }
}
