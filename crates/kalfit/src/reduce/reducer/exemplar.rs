//! Tests that others are recognised by.

use crate::ensemble::Test;
use crate::reduce::class::{DesignClass, class_bytes};
use crate::reduce::lanes::fits;
use crate::reduce::prepare::{Preparer, Workspace};

/// What tests that are recognised by another share with it.
#[derive(Debug)]
pub(crate) struct DesignExemplar {
    pub(crate) class: DesignClass,
    pub(crate) digest: u128,
    pub(crate) steps: usize,
    /// Cell and d of each scalar measurement.
    pub(crate) cells: Vec<(usize, f64)>,
    pub(crate) start: Vec<f64>,
    pub(crate) inputs: Vec<f64>,
}

impl DesignExemplar {
    /// What tests of a design are recognised by, from one of them as it was evaluated. `None` where there is nothing to gain.
    pub(crate) fn new(
        preparer: &Preparer,
        test: &Test,
        class: &DesignClass,
        work: &Workspace,
    ) -> Option<DesignExemplar> {
        let gains = class.gains().as_ref().ok()?;
        if !fits(class.design(), gains) {
            return None;
        }
        Some(DesignExemplar {
            class: class.clone(),
            digest: work.design.digest(),
            steps: work.design.steps(),
            cells: preparer.measured_cells(test, work).ok()?,
            start: work.data.start.clone(),
            inputs: work.data.inputs.clone(),
        })
    }

    /// Bytes it occupies with its class.
    pub(crate) fn bytes(&self) -> usize {
        let class = class_bytes(self.class.design(), self.class.gains());
        class + 8 * (2 * self.cells.len() + self.start.len() + self.inputs.len()) + 200
    }
}
