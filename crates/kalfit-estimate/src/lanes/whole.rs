//! Passes over blocks of classes, for few states with sizes known at compile time, else for any number of states.

use std::ops::Range;

use kalfit_lanes::{Counted, Flops, Kernel, Lanes};
use nalgebra::DMatrix;

use crate::lanes::accumulator::{Accumulator, ClassSums, Contribution};
use crate::lanes::any::ClassWorkspace;
use crate::lanes::layout::ClassLayout;
use crate::lanes::rows::add_one;
use crate::order::Order;
use crate::order::SumsWanted;
use crate::point::Point;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::symmetric::pairs;

/// A pass, at a point, over blocks of classes that are not in phases.
pub(super) struct BlockPass<'a> {
    pub(super) blocks: &'a [f64],
    pub(super) layout: ClassLayout,
    /// Factor on d and on the scatter vectors in the blocks.
    pub(super) unit: f64,
    pub(super) point: &'a Point,
    /// F with Σ = FF', lower triangular.
    pub(super) root: &'a DMatrix<f64>,
    pub(super) wanted: SumsWanted<'a>,
}

impl Kernel for BlockPass<'_> {
    type Output = ClassSums;

    /// For few states sizes are known at compile time, so that the likelihood terms of a block stay in registers.
    #[inline(always)]
    fn run<T: Lanes>(self) -> ClassSums {
        if self.layout.several || self.layout.covariates > 0 || self.wanted.flat.is_some() {
            return self.any::<T>();
        }
        match self.layout.p {
            1 if T::MAX_FIXED_SIZE >= 1 => self.sized::<T, 1>(),
            2 if T::MAX_FIXED_SIZE >= 2 => self.sized::<T, 2>(),
            3 if T::MAX_FIXED_SIZE >= 3 => self.sized::<T, 3>(),
            4 if T::MAX_FIXED_SIZE >= 4 => self.sized::<T, 4>(),
            5 if T::MAX_FIXED_SIZE >= 5 => self.sized::<T, 5>(),
            6 if T::MAX_FIXED_SIZE >= 6 => self.sized::<T, 6>(),
            7 if T::MAX_FIXED_SIZE >= 7 => self.sized::<T, 7>(),
            8 if T::MAX_FIXED_SIZE >= 8 => self.sized::<T, 8>(),
            9 if T::MAX_FIXED_SIZE >= 9 => self.sized::<T, 9>(),
            10 if T::MAX_FIXED_SIZE >= 10 => self.sized::<T, 10>(),
            _ => self.any::<T>(),
        }
    }
}

impl BlockPass<'_> {
    #[inline(always)]
    fn any<T: Lanes>(self) -> ClassSums {
        let columns = if self.layout.several { 1 + self.layout.p } else { 1 };
        let mut workspace = ClassWorkspace::<T>::new(&self.point.mean, self.root, columns);
        let mut sums = Accumulator::<T>::new(self.wanted);
        let mut covariates = vec![T::splat(0.0); self.layout.covariates];
        let count_at = self.layout.count() * T::COUNT;
        for block in self.blocks.chunks_exact(self.layout.size() * T::COUNT) {
            let own = block[self.layout.covariates() * T::COUNT..].chunks_exact(T::COUNT);
            for (to, x) in covariates.iter_mut().zip(own) {
                *to = T::load(x);
            }
            workspace.move_mean(&covariates, self.point, self.wanted.regressors);
            let det = workspace.evaluate(block, self.unit);
            let count = if self.layout.several { Some(T::load(&block[count_at..])) } else { None };
            sums.add(
                &BlockContribution { workspace: &workspace, det, count, phases: self.wanted.elements.blocks() },
                &covariates,
            );
        }
        sums.totals()
    }
}

/// Floating-point operations on one test of p states, counted by running the code: evaluation of the likelihood terms,
/// and addition of the terms to the sums of first derivatives.
pub(crate) fn flops_of_a_test(p: usize) -> Flops {
    let elements = Elements::single(p);
    let wanted = SumsWanted { elements: &elements, regressors: &[], order: Order::Mean, flat: None };
    let (mut sums, block) = (Accumulator::new(wanted), vec![0.0; pairs(p) + p]);
    let mut workspace = ClassWorkspace::<Counted>::new(&vec![0.0; p], &DMatrix::identity(p, p), 1);
    Counted::count(|| {
        let det = workspace.evaluate(&block, 1.0);
        sums.add(&BlockContribution { workspace: &workspace, det, count: None, phases: elements.blocks() }, &[]);
    })
}

/// Likelihood terms of a block, one class in each lane.
pub(crate) struct BlockContribution<'a, T> {
    pub(super) workspace: &'a ClassWorkspace<T>,
    pub(super) det: (T, T),
    pub(super) count: Option<T>,
    /// Range of the states of each phase.
    pub(super) phases: &'a [Range<usize>],
}

impl<T: Lanes> Contribution<T> for BlockContribution<'_, T> {
    #[inline(always)]
    fn phases(&self) -> usize {
        self.phases.len()
    }

    #[inline(always)]
    fn count(&self) -> Option<T> {
        self.count
    }

    #[inline(always)]
    fn det(&self) -> (T, T) {
        self.det
    }

    #[inline(always)]
    fn quadratic(&self) -> T {
        let mut sum = self.count.unwrap_or(T::splat(1.0)) * self.workspace.quadratic(0);
        for column in 1..self.workspace.columns() {
            sum = sum + self.workspace.quadratic(column);
        }
        sum
    }

    #[inline(always)]
    fn r(&self, k: usize, a: usize) -> T {
        self.workspace.r_of(0)[self.phases[k].start + a]
    }

    #[inline(always)]
    fn weight(&self, (k, a): (usize, usize), i: usize) -> &[T] {
        &self.workspace.row(self.phases[k].start + a)[self.phases[i].start..]
    }

    #[inline(always)]
    fn outer(&self, (k, a): (usize, usize), i: usize, to: &mut [T]) {
        to.fill(T::splat(0.0));
        for column in 0..self.workspace.columns() {
            let r = self.workspace.r_of(column);
            let own = r[self.phases[k].start + a];
            let weight = if column == 0 { self.count.unwrap_or(T::splat(1.0)) * own } else { own };
            add_one(to, weight, &r[self.phases[i].start..]);
        }
    }
}
