//! Tests in lanes: blocks of classes that each have one J, one class in each lane, and passes over the blocks. A class
//! by itself is a block of one lane.

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
use crate::order::{SumsWanted, max_tasks};
use crate::point::Point;
pub(crate) use accumulator::{Accumulator, ClassSums, Contribution};
pub(crate) use alone::ClassEvaluator;
pub(crate) use chains::{ChainContribution, ChainKernel, ChainSums};
pub(crate) use whole::flops_of_a_test;

/// Classes of p states that are not in phases, in blocks with one class in each lane: either every class has a single
/// test, or every class has several. Lanes without a class hold zeros, which add nothing.
#[derive(Debug, Clone)]
pub(crate) struct ClassBatches {
    isa: Isa,
    layout: ClassLayout,
    numbers: Arc<Vec<f64>>,
    /// Constant of each class at `unit` = 1.
    constants: Arc<Vec<f64>>,
    /// Sum of the constants of all classes.
    constant: f64,
    /// Factor on d and on the scatter vectors in `numbers`.
    unit: f64,
}

/// Fewest blocks that one thread fills at a time.
const MIN_FILLED_BLOCKS: usize = 16;

/// Fewest blocks that one task sums, for many states. The size of tasks depends on nothing but the blocks, so that sums
/// have the same bits for any number of threads.
const MIN_BLOCKS: usize = 16;
/// Fewest blocks that one task sums, for one state: more than for many states, because each block takes less time.
const MIN_BLOCKS_ONE_STATE: usize = 512;
/// Most blocks that one task sums, as a multiple of the fewest blocks.
const MAX_BLOCKS_FACTOR: usize = 32;
/// Fewest tasks of a pass over many blocks.
const MIN_TASKS: usize = 64;

impl ClassBatches {
    /// Fills blocks with `count` classes of p states with `covariates` covariates, all of several tests or all of one,
    /// none of which needs rotations; `class` writes the class with a given index into a buffer.
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
        blocks.with_min_len(MIN_FILLED_BLOCKS).for_each_init(
            Class::default,
            |class_buffer, (at, (block, constants))| {
                for (lane, constant) in constants.iter_mut().enumerate() {
                    class(at * lanes + lane, class_buffer);
                    layout.put(class_buffer.view(), (block, lane, lanes));
                    *constant = class_buffer.constant;
                }
            },
        );
        let constant = constants.iter().sum();
        ClassBatches { isa, layout, numbers: Arc::new(numbers), constants: Arc::new(constants), constant, unit: 1.0 }
    }

    /// Reads the class with the index `number` into `class`, with the constant at `unit` = 1.
    pub(crate) fn read(&self, number: usize, class: &mut Class) {
        let lanes = self.isa.lanes();
        let size = self.layout.size() * lanes;
        self.layout.read((&self.numbers[number / lanes * size..][..size], number % lanes, lanes), self.unit, class);
        class.constant = self.constants[number];
    }

    /// The classes at another noise level: d and the scatter are multiplied by `unit`, and `change` is added to the sum
    /// of the constants.
    pub(crate) fn at_noise(&self, unit: f64, change: f64) -> ClassBatches {
        ClassBatches { constant: self.constant + change, unit: self.unit * unit, ..self.clone() }
    }

    /// Instruction set that the blocks are packed for.
    pub(crate) fn isa(&self) -> Isa {
        self.isa
    }

    /// Sum of the constants of all tests.
    pub(crate) fn constant(&self) -> f64 {
        self.constant
    }

    /// Sums over the classes at a point, one item for each task, in the order of the blocks.
    pub(crate) fn totals(&self, point: &Point, wanted: SumsWanted<'_>) -> Vec<ClassSums> {
        if self.constants.is_empty() {
            return Vec::new();
        }
        let (root, layout, isa) = (Root::of(&point.root), self.layout, self.isa);
        let root = root.lower();
        let size = layout.size() * isa.lanes();
        let min_blocks = min_blocks(layout.p);
        let blocks = self.numbers.len() / size;
        let blocks_per_task = (blocks / MIN_TASKS)
            .clamp(min_blocks, MAX_BLOCKS_FACTOR * min_blocks)
            .max(blocks.div_ceil(max_tasks(layout.p)));
        let pass = |blocks: &[f64]| isa.run(whole::BlockPass { blocks, layout, unit: self.unit, point, root, wanted });
        self.numbers.par_chunks(blocks_per_task * size).map(pass).collect()
    }
}

/// Fewest blocks of p states that one task sums.
fn min_blocks(p: usize) -> usize {
    MIN_BLOCKS.max(MIN_BLOCKS_ONE_STATE * 8 / (p + 1).pow(3))
}

#[cfg(test)]
mod tests;
