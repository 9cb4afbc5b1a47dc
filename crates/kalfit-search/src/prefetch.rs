//! Fewer rounds with remote tests: results that are needed after a step in (α, μ, Σ) are requested together with the
//! step.

use crate::differences::first_points;
use crate::joint::JointStep;
use crate::profile_likelihood::ProfilePoint;
use crate::search::SMALL_DECREMENT;
use crate::search_state::SearchState;

impl SearchState<'_, '_> {
    /// [`ProfileLikelihood::step`](crate::dynamic::profile_likelihood::ProfileLikelihood::step) from the present point.
    /// Where remote tests have not answered for the new point yet, the differences around that point are requested,
    /// too.
    pub(super) fn step_and_prefetch(&self, values: &[f64], step: &JointStep, fine: bool) -> Option<ProfilePoint> {
        self.objective.together(|| {
            let next = self.objective.step(&self.iterate, values, &step.inner);
            if self.objective.is_waiting() {
                self.prefetch(values, step, fine);
            }
            next
        })
    }

    /// Requests the differences around the end of a step, two-sided where the search may end at that point.
    fn prefetch(&self, values: &[f64], step: &JointStep, fine: bool) {
        let objective = self.objective;
        let Ok(reduced) = objective.reduce(values) else { return };
        let state = &self.iterate.estimate.state;
        let Some(upcoming_point) = state.upcoming_point(&reduced.reductions, &objective.alpha(values), &step.inner)
        else {
            return;
        };
        let may_end = fine || step.decrement < SMALL_DECREMENT;
        let mut places = if fine { Vec::new() } else { first_points(objective, values, &self.active(), false) };
        if may_end {
            places.extend(first_points(objective, values, &self.active(), true));
            upcoming_point.request_counts();
        }
        for values in places {
            if let Ok(reduced) = objective.reduce(&values) {
                upcoming_point.ask(&reduced.reductions, &objective.alpha(&values));
            }
        }
    }
}
