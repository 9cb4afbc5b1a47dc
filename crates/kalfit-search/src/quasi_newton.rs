//! Steps between two computations of the second derivatives.
//!
//! Second derivatives cost a run of the filters for each value; the gradient comes with ℓ. After a step that raised ℓ
//! as predicted, the change of the gradient updates the information (Broyden, Fletcher, Goldfarb and Shanno's update),
//! and the next step costs one run. The end is certified by differences all the same.

use crate::joint::JointInformation;
use crate::profile_likelihood::ProfilePoint;
use crate::quadratic::{LevelScale, ProfileInformation, Quadratic};
use crate::search_state::{LONGEST, SearchState};
use crate::{Coordinate, Method};

/// Maximal number of steps before the second derivatives are computed again.
const MAX_STEPS: usize = 12;
/// Part of the predicted rise by which ℓ must rise for quasi-Newton steps to continue.
const MIN_GAIN: f64 = 0.2;
/// Ratio of curvature to downward slope of ℓ in the logarithm of a level below which quasi-Newton steps end: the level
/// is on the way to zero and moves better in the variance.
const VANISHING_RATIO: f64 = 2.5;

impl<'b> SearchState<'b, '_> {
    /// Continues from the end of a step and updates the information; `before`: the point where the step began, `joint`:
    /// the information at `before`.
    pub(super) fn updated_hessian_steps(&mut self, joint: &JointInformation, before: &ProfilePoint) {
        if let Some(curvature) = ProfileInformation::of(&self.objective.coordinates, self.level_scale, (joint, before))
        {
            self.quasi_newton_steps(curvature, (Some(before.clone()), true));
        }
    }

    /// Continues with the information `joint` from an earlier point, without updates.
    pub(super) fn fixed_hessian_steps(&mut self, joint: &JointInformation) {
        if let Some(curvature) =
            ProfileInformation::of(&self.objective.coordinates, self.level_scale, (joint, &self.iterate))
        {
            self.quasi_newton_steps(curvature, (None, false));
        }
    }

    /// Makes steps by the curvature at a maximum of a part of the data, in the scale of levels of that curvature or,
    /// where no step succeeds, in the other scale.
    pub(super) fn start_from_curvature(&mut self, curvature: Option<ProfileInformation>) {
        let Some(curvature) = curvature else { return };
        let start = self.iterate.value();
        self.level_scale = curvature.level_scale;
        for curvature in [curvature.clone(), curvature.other()] {
            let scale = curvature.level_scale;
            self.quasi_newton_steps(curvature, (None, true));
            if self.iterate.value() != start {
                self.level_scale = scale;
                return;
            }
            if self.stops() {
                return;
            }
        }
    }

    /// Makes steps by a given curvature; `last`: the point of that curvature, if not the present point; `learns`: steps
    /// update the curvature.
    pub(super) fn quasi_newton_steps(
        &mut self,
        curvature: ProfileInformation,
        (mut last, learns): (Option<ProfilePoint>, bool),
    ) {
        if self.objective.settings.method != Method::Hybrid {
            return;
        }
        let coordinates: &'b [Coordinate] = &self.objective.coordinates;
        let mut quadratic = Quadratic::about(coordinates, curvature, &last.as_ref().unwrap_or(&self.iterate).values);
        for _ in 0..MAX_STEPS {
            let before = last.as_ref().filter(|_| learns);
            let learnt = before.is_none_or(|last| quadratic.update(last.into(), (&self.iterate).into()));
            if !learnt || quadratic.has_vanishing_level((&self.iterate).into(), VANISHING_RATIO) {
                return;
            }
            let Some((step, decrement)) = quadratic.step((&self.iterate).into()) else { return };
            self.last_decrement = Some(decrement);
            let promised = 0.5 * decrement * decrement;
            if self.is_out_of_reach(decrement) || promised <= 0.05 * self.tolerance().powi(2) {
                return;
            }
            let Some(values) = quadratic.moved(&self.iterate.values, &step, LONGEST) else { return };
            let slack = 1e-12 * self.iterate.value().abs().max(1.0);
            let rises = |next: &ProfilePoint| next.value() >= self.iterate.value() + MIN_GAIN * promised - slack;
            let Some(next) = self.at(&values).filter(rises) else { return };
            let inside = quadratic.is_above_bounds(&next.values);
            last = Some(std::mem::replace(&mut self.iterate, next));
            self.report_step(Some(decrement));
            if !inside || self.stops() {
                return;
            }
        }
    }

    /// The scale of levels that predicted the gradient after a step better; the present scale where the predictions do
    /// not decide.
    pub(super) fn better_level_scale(&self, joint: &JointInformation, next: &ProfilePoint) -> LevelScale {
        if self.objective.settings.method != Method::Hybrid {
            return self.level_scale; // the gradient is not at the best (μ, Σ)
        }
        let quadratic_in = |scale| {
            let curvature = ProfileInformation::of(&self.objective.coordinates, scale, (joint, &self.iterate))?;
            Some(Quadratic::about(&self.objective.coordinates, curvature, &self.iterate.values))
        };
        let (Some(logarithm), Some(variance)) =
            (quadratic_in(LevelScale::Logarithm), quadratic_in(LevelScale::Variance))
        else {
            return self.level_scale;
        };
        let missed = |quadratic: &Quadratic<'_>| {
            logarithm.decrement_of(&quadratic.prediction_error((&self.iterate).into(), next.into()))
        };
        match (missed(&logarithm), missed(&variance)) {
            (Some(one), Some(other)) if other < one => LevelScale::Variance,
            (Some(_), Some(_)) => LevelScale::Logarithm,
            _ => self.level_scale,
        }
    }
}
