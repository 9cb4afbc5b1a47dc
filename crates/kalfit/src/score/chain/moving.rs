//! Room for the steps of a test.

use crate::reduce::Cells;
use crate::score::chain::Chain;
use crate::score::chain::groups::Groups;

/// What has come of the steps of a test.
#[derive(Debug, Clone)]
pub(super) struct Moving {
    pub(super) groups: Groups,
    /// Entries of φ, of Q.
    pub(super) entries: (usize, usize),
    pub(super) cells: Cells,
    /// Sums of one group; adjoints of its coefficients.
    pub(super) sums: Vec<f64>,
    pub(super) bars: Vec<f64>,
    pub(super) flows: Vec<f64>,
}

impl Moving {
    pub(super) fn new(chain: &Chain<'_>) -> Moving {
        let preparer = chain.preparer;
        let (phi, q) = preparer.plan.entries();
        let flows = preparer.plan.flow_len(&preparer.dynamics);
        Moving {
            groups: Groups::new(phi + q + flows, if chain.needs.inputs { flows } else { 0 }),
            entries: (phi, q),
            cells: Cells::default(),
            sums: Vec::new(),
            bars: Vec::new(),
            flows: Vec::new(),
        }
    }
}
