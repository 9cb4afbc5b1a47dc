//! Tests side by side: blocks of tests with one J each, whose numbers stand in lanes, and passes over them. A class by itself is a
//! block of one lane.

mod accumulator;
mod alone;
mod any;
mod chains;
mod dense;
mod gather;
mod layout;
mod plain;
mod rows;
mod whole;

use std::sync::Arc;

use kalfit_lanes::Isa;
use rayon::prelude::*;

use crate::chained::Root;
use crate::class::Class;
use crate::lanes::layout::ClassLayout;
use crate::order::{SumsWanted, most_tasks};
use crate::point::Point;
pub(crate) use accumulator::{Accumulator, ClassSums, Contribution};
pub(crate) use alone::ClassEvaluator;
pub(crate) use chains::{ChainKernel, ChainSums, InPhases};
pub(crate) use whole::flops_of_a_test;

/// Classes of p states that are not in phases, in blocks of as many as the machine has lanes: all of a single test, or all of several.
/// Places that no class takes hold zeros, which add nothing.
#[derive(Debug, Clone)]
pub(crate) struct ClassBatches {
    isa: Isa,
    layout: ClassLayout,
    numbers: Arc<Vec<f64>>,
    /// Of each class, as they were gathered.
    constants: Arc<Vec<f64>>,
    /// Σ constant.
    constant: f64,
    /// How many times as large as these numbers d and what classes scatter are.
    unit: f64,
}

/// Fewest blocks that one thread fills.
const FILLED: usize = 16;

/// Fewest blocks that one task sums, of many states and of one: a task of few states takes no less time than one of many. How many it
/// is depends on nothing but the blocks, so that sums have the same bits for any number of threads.
const FEWEST: usize = 16;
const FEWEST_OF_ONE: usize = 512;
/// The most are so many times as many.
const MOST: usize = 32;
/// Tasks there are at least, where blocks are many.
const TASKS: usize = 64;

impl ClassBatches {
    /// So many classes of p states and so many covariates, of several tests each or of one, with no need of rotations; `class` puts
    /// the one with a number into a place.
    pub(crate) fn filled(
        (p, covariates, several): (usize, usize, bool),
        isa: Isa,
        count: usize,
        class: &(dyn Fn(usize, &mut Class) + Sync),
    ) -> ClassBatches {
        let layout = ClassLayout { p, exact: 0, covariates, several };
        let (lanes, size) = (isa.lanes(), layout.size() * isa.lanes());
        let mut numbers = vec![0.0; count.div_ceil(lanes) * size];
        let mut constants = vec![0.0; count];
        let blocks = numbers.par_chunks_mut(size.max(1)).zip(constants.par_chunks_mut(lanes)).enumerate();
        blocks.with_min_len(FILLED).for_each_init(Class::default, |room, (at, (block, constants))| {
            for (lane, constant) in constants.iter_mut().enumerate() {
                class(at * lanes + lane, room);
                layout.put(room.view(), (block, lane, lanes));
                *constant = room.constant;
            }
        });
        let constant = constants.iter().sum();
        ClassBatches { isa, layout, numbers: Arc::new(numbers), constants: Arc::new(constants), constant, unit: 1.0 }
    }

    /// Puts the class with this number into a place, its constant as it was gathered.
    pub(crate) fn read(&self, number: usize, class: &mut Class) {
        let lanes = self.isa.lanes();
        let size = self.layout.size() * lanes;
        self.layout.read((&self.numbers[number / lanes * size..][..size], number % lanes, lanes), self.unit, class);
        class.constant = self.constants[number];
    }

    /// The same with other noise: d and what classes scatter so many times as large, and this much more of Σ constant.
    pub(crate) fn shrunk(&self, unit: f64, change: f64) -> ClassBatches {
        ClassBatches { constant: self.constant + change, unit: self.unit * unit, ..self.clone() }
    }

    /// What it is worked on with.
    pub(crate) fn isa(&self) -> Isa {
        self.isa
    }

    /// Σ constant over the tests.
    pub(crate) fn constant(&self) -> f64 {
        self.constant
    }

    /// What all classes say at a point, one part after the other.
    pub(crate) fn totals(&self, point: &Point, wanted: SumsWanted<'_>) -> Vec<ClassSums> {
        if self.constants.is_empty() {
            return Vec::new();
        }
        let (root, layout, isa) = (Root::of(&point.root), self.layout, self.isa);
        let root = root.lower();
        let size = layout.size() * isa.lanes();
        let fewest = fewest(layout.p);
        let blocks = self.numbers.len() / size;
        let each = (blocks / TASKS).clamp(fewest, MOST * fewest).max(blocks.div_ceil(most_tasks(layout.p)));
        let pass = |blocks: &[f64]| isa.run(whole::BlockPass { blocks, layout, unit: self.unit, point, root, wanted });
        self.numbers.par_chunks(each * size).map(pass).collect()
    }
}

/// Fewest blocks of p states that one task sums.
fn fewest(p: usize) -> usize {
    FEWEST.max(FEWEST_OF_ONE * 8 / (p + 1).pow(3))
}

#[cfg(test)]
mod tests;
