//! Fewer rounds where tests are elsewhere: with a step in (α, μ, Σ) goes the question for what is wanted once it is taken.

use crate::differences::around;
use crate::joint::JointStep;
use crate::profile_likelihood::ProfilePoint;
use crate::search::HARDLY;
use crate::search_state::SearchState;

impl SearchState<'_, '_> {
    /// [`ProfileLikelihood::step`](crate::profile_likelihood::ProfileLikelihood::step) from home. Where nobody has answered
    /// what the tests say there, the differences about that place are asked for, too.
    pub(super) fn stepped(&self, values: &[f64], step: &JointStep, fine: bool) -> Option<ProfilePoint> {
        self.objective.together(|| {
            let next = self.objective.step(&self.home, values, &step.inner);
            if self.objective.is_waiting() {
                self.foresee(values, step, fine);
            }
            next
        })
    }

    /// Asks for the differences about the place of a step, to both sides where the search may end there.
    fn foresee(&self, values: &[f64], step: &JointStep, fine: bool) {
        let objective = self.objective;
        let Ok(reduced) = objective.reduce(values) else { return };
        let state = &self.home.estimate.state;
        let Some(ahead) = state.ahead(&reduced.reductions, &objective.alpha(values), &step.inner) else { return };
        let may_end = fine || step.decrement < HARDLY;
        let mut places = if fine { Vec::new() } else { around(objective, values, &self.active(), false) };
        if may_end {
            places.extend(around(objective, values, &self.active(), true));
            ahead.ask_counts();
        }
        for values in places {
            if let Ok(reduced) = objective.reduce(&values) {
                ahead.ask(&reduced.reductions, &objective.alpha(&values));
            }
        }
    }
}
