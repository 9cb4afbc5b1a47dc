//! Designs of one shape, their gains and their data as numbers side by side, for passes that are not the reduction's own.

use kalfit_lanes::Lanes;

use crate::reduce::design::{Design, Transition};
use crate::reduce::lanes::DataBlock;
use crate::reduce::lanes::design_batch::DesignBatch;
use crate::reduce::lanes::numbers::{Numbers, at};

/// A test in each lane. Where one is shorter than the longest it goes on with measurements that say nothing, and transitions that
/// forget everything.
#[derive(Debug)]
pub(crate) struct Interleaved<'a, T> {
    /// Of the longest: its numbers do not count.
    pub(crate) shape: &'a Design,
    gained: &'a DesignBatch,
    pub(crate) variance: Vec<T>,
    h: Vec<T>,
    noise: Vec<T>,
    pub(crate) start: Vec<T>,
    pub(crate) inputs: Vec<T>,
    pub(crate) values: Vec<T>,
    /// 1/S, K and T of each row, r and p numbers of the latter.
    gains: Vec<T>,
    sizes: (usize, usize),
}

impl<T: Lanes> Interleaved<'_, T> {
    /// (states, h, R) of a line.
    #[inline(always)]
    pub(crate) fn line(&self, line: usize) -> (&[u32], &[T], T) {
        let start = if line == 0 { 0 } else { self.shape.ends[line - 1] };
        let terms = start..self.shape.ends[line];
        (&self.shape.states[terms.clone()], &self.h[terms], self.noise[line])
    }

    /// 1/S, K, T of a row.
    #[inline(always)]
    pub(crate) fn row(&self, row: usize) -> (T, &[T], &[T]) {
        let (r, p) = self.sizes;
        let own = &self.gains[row * (1 + r + p)..][..1 + r + p];
        (own[0], &own[1..=r], &own[1 + r..])
    }

    /// Room for a transition.
    #[inline(always)]
    pub(crate) fn transition(&self) -> Transition<T> {
        self.shape.blank_transition()
    }

    /// Takes the transition of a run; false, and nothing is taken, where it has none.
    #[inline(always)]
    pub(crate) fn take(&self, run: usize, transition: &mut Transition<T>) -> bool {
        let moves = self.shape.runs[run].transition.is_some();
        if moves {
            self.gained.take(run, transition);
        }
        moves
    }
}

impl DataBlock {
    /// The tests of the batch, after [`BatchFilter::filter`](crate::reduce::lanes::BatchFilter::filter) into `gained`; `longest`: the
    /// shape of their designs.
    #[inline(always)]
    pub(crate) fn interleave<'a, T: Lanes>(&self, longest: &'a Design, gained: &'a DesignBatch) -> Interleaved<'a, T> {
        let side = self.side();
        let (r, p) = (longest.frame.r, longest.frame.p);
        let mut gains: Vec<T> = Vec::with_capacity(longest.rows() * (1 + r + p));
        for row in 0..longest.rows() {
            for k in 0..=r {
                gains.push(at(Numbers::<T>::gains(gained, row), k));
            }
            for k in 0..p {
                gains.push(at(Numbers::<T>::sensitivities(gained, row), k));
            }
        }
        let (start, inputs, values) = (all(side.start), all(side.inputs), all(side.values));
        let (variance, h, noise) = (all(&gained.variance), all(&gained.h), all(&gained.noise));
        Interleaved { shape: longest, gained, variance, h, noise, start, inputs, values, gains, sizes: (r, p) }
    }
}

/// Numbers in lanes.
#[inline(always)]
fn all<T: Lanes>(numbers: &[f64]) -> Vec<T> {
    let mut all = Vec::with_capacity(numbers.len() / T::COUNT);
    for k in 0..numbers.len() / T::COUNT {
        all.push(at(numbers, k));
    }
    all
}
