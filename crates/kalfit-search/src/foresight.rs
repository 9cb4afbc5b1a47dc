//! Fewer rounds with remote tests: together with a step in (α, μ, Σ), the results are requested that are needed after
//! it.

use crate::differences::around;
use crate::joint::JointStep;
use crate::profile_likelihood::ProfilePoint;
use crate::search::HARDLY;
use crate::search_state::SearchState;

impl SearchState<'_, '_> {
    /// [`ProfileLikelihood::step`](crate::dynamic::profile_likelihood::ProfileLikelihood::step) from the present point.
    /// Where remote tests have not answered for the new point yet, the differences about it are requested, too.
    pub(super) fn stepped(&self, values: &[f64], step: &JointStep, fine: bool) -> Option<ProfilePoint> {
        self.objective.together(|| {
            let next = self.objective.step(&self.home, values, &step.inner);
            if self.objective.is_waiting() {
                self.foresee(values, step, fine);
            }
            next
        })
    }

    /// Requests the differences about the end of a step, two-sided where the search may end there.
    fn foresee(&self, values: &[f64], step: &JointStep, fine: bool) {
        let objective = self.objective;
        let Ok(reduced) = objective.reduce(values) else { return };
        let state = &self.home.estimate.state;
        let Some(upcoming_point) = state.upcoming_point(&reduced.reductions, &objective.alpha(values), &step.inner) else { return };
        let may_end = fine || step.decrement < HARDLY;
        let mut places = if fine { Vec::new() } else { around(objective, values, &self.active(), false) };
        if may_end {
            places.extend(around(objective, values, &self.active(), true));
            upcoming_point.request_counts();
        }
        for values in places {
            if let Ok(reduced) = objective.reduce(&values) {
                upcoming_point.ask(&reduced.reductions, &objective.alpha(&values));
            }
        }
    }
}
