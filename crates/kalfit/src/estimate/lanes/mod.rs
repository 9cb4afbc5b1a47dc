//! Tests side by side: blocks of tests with one J each, whose numbers stand in lanes, and passes over them.

mod any;
mod chains;
mod dense;
mod gather;
mod plain;
mod rows;

use kalfit_lanes::Isa;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::estimate::classes::Class;
use crate::estimate::pass::Order;
use crate::estimate::terms::Point;
pub(crate) use chains::{Pass as ChainPass, Totals as ChainTotals};
pub(crate) use plain::Totals;

/// Tests of p states with one J each, without covariates and not in phases, in blocks of as many as the machine has lanes.
/// Places that no test takes hold zeros, which add nothing.
#[derive(Debug, Clone)]
pub(crate) struct Blocks {
    isa: Isa,
    p: usize,
    numbers: Vec<f64>,
    tests: usize,
    /// Σ constant.
    constant: f64,
}

/// Fewest and most blocks that one task sums. How many it is depends on nothing but the number of blocks, so that sums have the same
/// bits for any number of threads.
const FEWEST: usize = 16;
const MOST: usize = 512;
/// Tasks there are at least, where blocks are many.
const TASKS: usize = 64;

impl Blocks {
    /// No blocks, to be filled with tests of p states.
    pub(crate) fn new(p: usize, isa: Isa) -> Blocks {
        Blocks { isa, p, numbers: Vec::new(), tests: 0, constant: 0.0 }
    }

    /// Whether a class can stand in a block: one test, with no need of rotations.
    pub(crate) fn takes(&self, class: &Class) -> bool {
        let alone = class.count == 1.0 && class.scatter.is_none() && class.covariates.is_empty();
        alone && !class.square_root && class.chain.is_none() && self.p > 0
    }

    /// Puts a class that it takes into the next free lane.
    pub(crate) fn push(&mut self, class: &Class) {
        let (lanes, p) = (self.isa.lanes(), self.p);
        let lane = self.tests % lanes;
        let size = dense::entries(p) * lanes;
        if lane == 0 {
            self.numbers.resize(self.numbers.len() + size, 0.0);
        }
        let start = self.numbers.len() - size;
        let triangle = (0..p).flat_map(|k| (0..=k).map(move |i| class.factor[i * p + k]));
        let block = self.numbers[start..].chunks_exact_mut(lanes);
        block.zip(triangle.chain(class.mean.iter().copied())).for_each(|(entry, x)| entry[lane] = x);
        self.tests += 1;
        self.constant += class.constant;
    }

    /// What it is worked on with.
    pub(crate) fn isa(&self) -> Isa {
        self.isa
    }

    /// Σ constant over the tests.
    pub(crate) fn constant(&self) -> f64 {
        self.constant
    }

    /// What all tests say at a point, one part after the other.
    pub(crate) fn totals(&self, point: &Point, order: Order) -> Vec<Totals> {
        if self.tests == 0 {
            return Vec::new();
        }
        let size = dense::entries(self.p) * self.isa.lanes();
        let blocks = self.numbers.len() / size;
        let each = (blocks / TASKS).clamp(FEWEST, MOST);
        let root = lower(&point.root);
        let of =
            |blocks: &[f64]| self.isa.run(plain::Pass { blocks, mean: &point.mean, root: &root, order, isa: self.isa });
        self.numbers.par_chunks(each * size).map(of).collect()
    }
}

/// The lower triangular root of FF'.
fn lower(root: &DMatrix<f64>) -> DMatrix<f64> {
    let p = root.nrows();
    if (0..p).all(|i| (i + 1..p).all(|c| root[(i, c)] == 0.0)) {
        return root.clone();
    }
    root.transpose().qr().r().transpose()
}

#[cfg(test)]
mod tests;
