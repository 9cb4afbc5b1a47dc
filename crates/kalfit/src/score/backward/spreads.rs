//! P before each step, for passes that share it.

use crate::score::backward::parts::At;
use crate::score::backward::run::Run;
use crate::score::backward::work::BackwardWork;

/// P, r × r, as far as adjoints are wanted that need it: before each transition, and before each scalar measurement.
#[derive(Debug, Clone, Default)]
pub(crate) struct Spreads {
    pub(crate) left: Vec<f64>,
    pub(crate) before: Vec<f64>,
}

impl Run<'_> {
    /// What the forward filter passes through, its state apart.
    pub(crate) fn spreads(&self, work: &mut BackwardWork) -> Spreads {
        let mut spreads = Spreads::default();
        if !self.tracked() {
            return spreads;
        }
        let BackwardWork { e, now, .. } = work;
        e.clear();
        self.begin(now);
        self.through(self.design.each_step(), 0, (now, e), |at, _, now| match at {
            At::Moves if self.wanted.motion => spreads.left.extend_from_slice(&now.P),
            At::Measures if self.wanted.equation => spreads.before.extend_from_slice(&now.P),
            _ => {}
        });
        spreads
    }
}
