//! Designs of one shape, their gains and their data as numbers side by side, for passes that are not the reduction's own.

use std::sync::Arc;

use kalfit_lanes::Lanes;

use crate::reduce::design::{Design, Transition};
use crate::reduce::lanes::Block;
use crate::reduce::lanes::designs::Gained;
use crate::reduce::lanes::numbers::{Numbers, at};

/// A test in each lane. Where one is shorter than the longest it goes on with measurements that say nothing, and transitions that
/// forget everything.
#[derive(Debug)]
pub(crate) struct Woven<T> {
    pub(crate) design: Design<T>,
    pub(crate) start: Vec<T>,
    pub(crate) inputs: Vec<T>,
    pub(crate) values: Vec<T>,
    /// 1/S, K and T of each row, r and p numbers of the latter.
    gains: Vec<T>,
    sizes: (usize, usize),
}

impl<T: Lanes> Woven<T> {
    /// 1/S, K, T of a row.
    #[inline(always)]
    pub(crate) fn row(&self, row: usize) -> (T, &[T], &[T]) {
        let (r, p) = self.sizes;
        let own = &self.gains[row * (1 + r + p)..][..1 + r + p];
        (own[0], &own[1..=r], &own[1 + r..])
    }
}

impl Block {
    /// The tests of the block, after [`Block::filter`] into `gained`; `longest` as there.
    #[inline(always)]
    pub(crate) fn woven<T: Lanes>(&self, longest: &Design, gained: &Gained) -> Woven<T> {
        let frame = &longest.frame;
        let side = self.side();
        let (r, p) = (frame.r, frame.p);
        let mut gains: Vec<T> = Vec::with_capacity(longest.rows() * (1 + r + p));
        for row in 0..longest.rows() {
            for k in 0..=r {
                gains.push(at(Numbers::<T>::gains(gained, row), k));
            }
            for k in 0..p {
                gains.push(at(Numbers::<T>::sensitivities(gained, row), k));
            }
        }
        let mut design = Design::<T>::new(frame.clone());
        (design.ends, design.states) = (longest.ends.clone(), longest.states.clone());
        design.variance = all(gained.variance());
        design.h = all(gained.coefficients());
        design.noise = all(gained.noise());
        design.runs.clone_from(&longest.runs);
        for (run, own) in design.runs.iter_mut().enumerate() {
            let Some(like) = own.transition.map(|number| &longest.moves[number as usize]) else { continue };
            let number = gained.transition(run);
            if number == design.moves.len() {
                let (mut phi, mut q) = (Vec::with_capacity(like.phi.len()), Vec::with_capacity(like.q.len()));
                for term in 0..like.phi.len() {
                    phi.push(gained.phi(run, term));
                }
                for pair in 0..like.q.len() {
                    q.push(at(gained.process_noise(), number * like.q.len() + pair));
                }
                design.moves.push(Arc::new(Transition { pattern: like.pattern.clone(), phi, q, digest: None }));
            }
            own.transition = Some(number as u32);
        }
        let (start, inputs, values) = (all(side.start), all(side.inputs), all(side.values));
        Woven { design, start, inputs, values, gains, sizes: (r, p) }
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
