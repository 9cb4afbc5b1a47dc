//! Tests that were evaluated and wait to be filtered.

use crate::reduce::data::Data;
use crate::reduce::design::Design;
use crate::reduce::instances::Instances;
use crate::reduce::lanes::same_shape;
use crate::reduce::lines::{Lines, Waits};
use crate::reduce::prepare::Workspace;

/// A test that was evaluated.
#[derive(Debug)]
pub(crate) struct Own {
    pub(crate) number: usize,
    pub(crate) digest: u128,
    pub(crate) design: Design,
    pub(crate) data: Data,
    pub(crate) covariates: Vec<f64>,
    pub(crate) instances: Instances,
}

impl Waits for Own {
    fn length(&self) -> usize {
        self.design.runs.len()
    }

    fn goes_with(&self, other: &Own) -> bool {
        same_shape(&self.design, &other.design)
    }
}

/// Lines of tests whose designs have one shape each.
#[derive(Debug, Default)]
pub(crate) struct Queue {
    lines: Lines<Own>,
    /// Room that was used before.
    spare: Vec<Own>,
}

impl Queue {
    /// The line in which a test of this design waits.
    pub(crate) fn line_with(&self, digest: u128) -> Option<usize> {
        self.lines.find(|own| own.digest == digest)
    }

    /// A line that is not empty.
    pub(crate) fn any(&self) -> Option<usize> {
        self.lines.find(|_| true)
    }

    /// Moves a test from the work space to the end of its line. Returns the number of a line that is to be taken now.
    pub(crate) fn push(&mut self, number: usize, digest: u128, work: &mut Workspace) -> Option<usize> {
        let mut own = self.spare.pop().unwrap_or_else(|| Own {
            number,
            digest,
            design: Design::new(work.design.frame.clone()),
            data: Data::default(),
            covariates: Vec::new(),
            instances: Instances::default(),
        });
        (own.number, own.digest) = (number, digest);
        std::mem::swap(&mut own.design, &mut work.design);
        std::mem::swap(&mut own.data, &mut work.data);
        std::mem::swap(&mut own.covariates, &mut work.covariates);
        std::mem::swap(&mut own.instances, &mut work.instances);
        self.lines.push(own)
    }

    /// The tests of a line, which is empty then.
    pub(crate) fn take(&mut self, line: usize) -> Vec<Own> {
        self.lines.take(line)
    }

    /// Room that is not needed any more.
    pub(crate) fn give_back(&mut self, own: Vec<Own>) {
        self.spare.extend(own);
    }
}
