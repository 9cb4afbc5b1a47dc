//! Fewer rounds where tests are elsewhere: with a step in (α, μ, Σ) goes the question for what is wanted once it is taken.

use crate::dynamic::bench::ProfilePoint;
use crate::dynamic::differences::around;
use crate::dynamic::iterate::SearchState;
use crate::dynamic::joint::JointStep;
use crate::dynamic::search::HARDLY;

impl SearchState<'_, '_> {
    /// [`Bench::step`](crate::dynamic::bench::Bench::step) from home. Where nobody has answered what the tests say there, the differences
    /// about that place are asked for, too.
    pub(super) fn stepped(&self, values: &[f64], step: &JointStep, fine: bool) -> Option<ProfilePoint> {
        self.bench.together(|| {
            let next = self.bench.step(&self.home, values, &step.inner);
            if self.bench.is_waiting() {
                self.foresee(values, step, fine);
            }
            next
        })
    }

    /// Asks for the differences about the place of a step, to both sides where the search may end there.
    fn foresee(&self, values: &[f64], step: &JointStep, fine: bool) {
        let bench = self.bench;
        let Ok(reduced) = bench.reduce(values) else { return };
        let state = &self.home.estimate.state;
        let Some(ahead) = state.ahead(&reduced.reductions, &bench.alpha(values), &step.inner) else { return };
        let may_end = fine || step.decrement < HARDLY;
        let mut places = if fine { Vec::new() } else { around(bench, values, &self.active(), false) };
        if may_end {
            places.extend(around(bench, values, &self.active(), true));
            ahead.ask_counts();
        }
        for values in places {
            if let Ok(reduced) = bench.reduce(&values) {
                ahead.ask(&reduced.reductions, &bench.alpha(&values));
            }
        }
    }
}
