//! Filters of tests in lanes, which can run again after numbers of the tests have changed.

use kalfit_lanes::Width;

use crate::reduce::design::Design;
use crate::reduce::lanes::data_block::DataBlock;
use crate::reduce::lanes::design_batch::{BatchPasses, DesignBatch};
use crate::reduce::lanes::workspace::DataWorkspace;

/// Designs and data of tests, one test per lane, and the results of the filters. All tests have the steps and
/// measurements of one common shape; a step or measurement that a test lacks changes nothing in the lane of the test:
/// h = 0, R = 1, φ = I, Q = 0.
#[derive(Debug, Clone)]
pub(crate) struct BatchFilter {
    pub(crate) block: DataBlock,
    pub(crate) design_batch: DesignBatch,
}

/// The numbers of the tests, mutable. In each list, entry k of the test in a lane is at k × lanes + lane.
#[derive(Debug)]
pub(crate) struct BatchColumns<'a> {
    /// P0 on the noise-reachable states, r × r, lower triangle by rows.
    pub(crate) variance: &'a mut [f64],
    /// Coefficients h of the terms of each row.
    pub(crate) h: &'a mut [f64],
    /// R of each row.
    pub(crate) noise: &'a mut [f64],
    /// Stored entries of φ, and of Q, of each transition.
    pub(crate) phi: &'a mut [f64],
    pub(crate) q: &'a mut [f64],
    /// a of each test, n numbers.
    pub(crate) start: &'a mut [f64],
    /// b of the driven states, transition after transition.
    pub(crate) inputs: &'a mut [f64],
    /// z - d of each row.
    pub(crate) values: &'a mut [f64],
}

impl BatchFilter {
    /// Filter for lanes of this width, without tests yet.
    pub(crate) fn new(width: Width) -> BatchFilter {
        BatchFilter { block: DataBlock::new(width), design_batch: DesignBatch::default() }
    }

    /// Resets the filter to a shape in which each step is a run, with this number of transitions: R is one, all other
    /// numbers are zero.
    pub(crate) fn blank(&mut self, design: &Design, transitions: usize) {
        self.block.clear(design.frame.n, transitions * design.frame.driven.len(), design.rows());
        self.design_batch.blank(design, self.block.lanes());
    }

    pub(crate) fn columns(&mut self) -> BatchColumns<'_> {
        let DesignBatch { variance, h, noise, phi, q, .. } = &mut self.design_batch;
        let [start, inputs, values] = self.block.numbers_mut();
        BatchColumns { variance, h, noise, phi, q, start, inputs, values }
    }

    /// Runs the covariance filters and the data passes of the first `tests` lanes.
    pub(crate) fn run(&mut self, design: &Design, tests: usize, scratch: &mut DataWorkspace) {
        let BatchFilter { block, design_batch: designs } = self;
        block.width().run(BatchPasses { design, tests, data: block.view(), designs, scratch });
    }
}
