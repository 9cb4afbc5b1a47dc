//! Steps between two looks at the second derivatives.
//!
//! Second derivatives cost a run of the filters for each value; the gradient comes with ℓ. After a step that kept its word what the
//! gradient has done on the way corrects the information (Broyden, Fletcher, Goldfarb and Shanno's update), and the next step costs
//! one run. The end is certified by differences all the same.

use crate::joint::JointInformation;
use crate::profile_likelihood::ProfilePoint;
use crate::quadratic::{LevelScale, ProfileInformation, Quadratic};
use crate::search_state::{LONGEST, SearchState};
use crate::{Coordinate, Method};

/// Most steps before the next look.
const STEPS: usize = 12;
/// A step keeps its word when ℓ rises by this part of what it promised.
const KEPT: f64 = 0.2;
/// Levels sink in their variances: a slope below and a curvature of its logarithm about it leave that to others.
const SINKING: f64 = 2.5;

impl<'b> SearchState<'b, '_> {
    /// Goes on from where a step led; `before`: where it began, `joint` the information there.
    pub(super) fn glide(&mut self, joint: &JointInformation, before: &ProfilePoint) {
        if let Some(curvature) = ProfileInformation::of(&self.objective.coordinates, self.level_scale, (joint, before))
        {
            self.quasi_newton_steps(curvature, (Some(before.clone()), true));
        }
    }

    /// The same by information that serves here, too; nothing is learnt on the way.
    pub(super) fn glide_by(&mut self, joint: &JointInformation) {
        if let Some(curvature) =
            ProfileInformation::of(&self.objective.coordinates, self.level_scale, (joint, &self.home))
        {
            self.quasi_newton_steps(curvature, (None, false));
        }
    }

    /// Goes on by the curvature at a maximum of a part of the data: by its scale of levels, or where that fails by the other one.
    pub(super) fn begin_with(&mut self, curvature: Option<ProfileInformation>) {
        let Some(curvature) = curvature else { return };
        let start = self.home.value();
        self.level_scale = curvature.level_scale;
        for curvature in [curvature.clone(), curvature.other()] {
            let scale = curvature.level_scale;
            self.quasi_newton_steps(curvature, (None, true));
            if self.home.value() != start {
                self.level_scale = scale;
                return;
            }
            if self.stops() {
                return;
            }
        }
    }

    /// Goes on by a curvature at hand; `last`: where it was known, if that is not here; `learns`: it is corrected on the way.
    pub(super) fn quasi_newton_steps(
        &mut self,
        curvature: ProfileInformation,
        (mut last, learns): (Option<ProfilePoint>, bool),
    ) {
        if self.objective.settings.method != Method::Hybrid {
            return;
        }
        let coordinates: &'b [Coordinate] = &self.objective.coordinates;
        let mut quadratic = Quadratic::about(coordinates, curvature, &last.as_ref().unwrap_or(&self.home).values);
        for _ in 0..STEPS {
            let before = last.as_ref().filter(|_| learns);
            let learnt = before.is_none_or(|last| quadratic.learn(last.into(), (&self.home).into()));
            if !learnt || quadratic.sinks((&self.home).into(), SINKING) {
                return;
            }
            let Some((step, decrement)) = quadratic.step((&self.home).into()) else { return };
            self.glided = Some(decrement);
            let promised = 0.5 * decrement * decrement;
            if self.is_lost(decrement) || promised <= 0.05 * self.tolerance().powi(2) {
                return;
            }
            let Some(values) = quadratic.moved(&self.home.values, &step, LONGEST) else { return };
            let slack = 1e-12 * self.home.value().abs().max(1.0);
            let rises = |next: &ProfilePoint| next.value() >= self.home.value() + KEPT * promised - slack;
            let Some(next) = self.at(&values).filter(rises) else { return };
            let inside = quadratic.is_above_bounds(&next.values);
            last = Some(std::mem::replace(&mut self.home, next));
            self.tell(Some(decrement));
            if !inside || self.stops() {
                return;
            }
        }
    }

    /// By which scale of levels the gradient after a step was foreseen better; as before where that cannot be said.
    pub(super) fn straighter(&self, joint: &JointInformation, next: &ProfilePoint) -> LevelScale {
        if self.objective.settings.method != Method::Hybrid {
            return self.level_scale; // the gradient is not at the best (μ, Σ)
        }
        let by = |scale| {
            let curvature = ProfileInformation::of(&self.objective.coordinates, scale, (joint, &self.home))?;
            Some(Quadratic::about(&self.objective.coordinates, curvature, &self.home.values))
        };
        let (Some(logarithm), Some(variance)) = (by(LevelScale::Logarithm), by(LevelScale::Variance)) else {
            return self.level_scale;
        };
        let missed =
            |quadratic: &Quadratic<'_>| logarithm.size(&quadratic.unforeseen((&self.home).into(), next.into()));
        match (missed(&logarithm), missed(&variance)) {
            (Some(one), Some(other)) if other < one => LevelScale::Variance,
            (Some(_), Some(_)) => LevelScale::Logarithm,
            _ => self.level_scale,
        }
    }
}
