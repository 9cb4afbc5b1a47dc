//! Values on their way to zero and to infinity. A noise level moves in its variance, where zero is a bound like any other.

use crate::Standing;
use crate::joint;
use crate::joint::JointInformation;
use crate::profile_likelihood::ProfilePoint;
use crate::search_state::{DRIFT, SearchState};

/// A logarithm whose curvature is no more than this many times its slope has no optimum in sight: ℓ runs level towards a bound,
/// as 1/x, x² or the like.
const LEVEL: f64 = 3.5;
/// … and only a slope below this, and so little of ℓ to be had, makes a leap worth a try.
const TAIL: f64 = 0.1;
/// A level with a slope below this moves in its variance where that is straighter.
const STEEP: f64 = 5.0;
/// A curvature upward of a variance by no more than this part of its slope is none.
const HOLLOW: f64 = 0.1;
/// ℓ that may still be had beyond, where a value counts as infinite.
const BEYOND: f64 = 1e-7;
/// Where ℓ is not defined at zero, this part of the size that the level had stands for it: its square is nothing to ℓ, and leaves
/// scores their digits.
const NEARLY_ZERO: f64 = 1e-4;
/// … and less where ℓ would rise by more than [`BEYOND`] at zero: by this part of that from there.
const NEARER: f64 = 0.1;
/// A level below this part of what it was, whose slope and curvature are below this, is not felt.
const FEW_PARTS: f64 = 1e-2;
const UNFELT: f64 = 1e-6;

impl SearchState<'_, '_> {
    /// Levels at zero, or as near to it as ℓ is defined.
    pub(super) fn zeros(&self) -> Vec<usize> {
        (0..self.home.values.len()).filter(|&s| self.is_at_zero(s)).collect()
    }

    /// A noise level at its least value.
    pub(super) fn is_at_zero(&self, s: usize) -> bool {
        self.objective.coordinates[s].level.is_some() && self.home.values[s] <= self.bottom[s]
    }

    /// A level that ℓ would have at zero, where it is not defined.
    pub(super) fn is_vanishing(&self, s: usize) -> bool {
        self.is_at_zero(s) && self.bottom[s] > self.objective.coordinates[s].lower
    }

    /// Levels whose variance is nearer to ℓ's own coordinate than its logarithm, with their exponents: those that would reach zero,
    /// and those far below their optimum.
    pub(super) fn levels_near_zero(&self, joint: &JointInformation) -> Vec<(usize, f64)> {
        let near = |&s: &usize| -> Option<(usize, f64)> {
            let exponent = self.objective.coordinates[s].level?;
            let (slope, bend) = (self.home.gradient[s], joint.curvature(s));
            let straight = exponent * slope.abs();
            let sinks = slope < 0.0 && slope > -STEEP && bend > 0.9 * straight && bend < 2.0 * straight;
            let rises = slope > 0.0 && bend < 0.5 * straight && bend > -1.1 * straight;
            (sinks || rises).then_some((s, exponent))
        };
        joint.active.iter().filter_map(near).collect()
    }

    /// All levels that move, with their exponents, but those far from where ℓ curves downward in their variances.
    pub(super) fn all_levels(&self, joint: &JointInformation) -> Vec<(usize, f64)> {
        let level = |&s: &usize| {
            let exponent = self.objective.coordinates[s].level?;
            let bend = exponent * self.home.gradient[s];
            (joint.curvature(s) + bend > -HOLLOW * bend.abs()).then_some((s, exponent))
        };
        joint.active.iter().filter_map(level).collect()
    }

    /// Where ℓ is not defined with levels at zero, the same with them a little above it, which is as low as they go from now on.
    pub(super) fn above_zero(&mut self, values: &[f64]) -> Option<ProfilePoint> {
        let mut raised = values.to_vec();
        let fell =
            |&s: &usize| self.objective.coordinates[s].level.is_some() && values[s] == 0.0 && self.home.values[s] > 0.0;
        let fallen: Vec<usize> = (0..values.len()).filter(fell).collect();
        if fallen.is_empty() {
            return None;
        }
        fallen.iter().for_each(|&s| raised[s] = self.home.values[s].min(NEARLY_ZERO * self.size(s)));
        let slack = 1e-11 * self.home.value().abs().max(1.0);
        let next = self.at(&raised).filter(|next| next.value() >= self.home.value() - slack)?;
        fallen.iter().for_each(|&s| self.bottom[s] = raised[s]);
        Some(next)
    }

    /// Levels as near to zero as ℓ was defined go nearer where that is worth it: in their variances ℓ runs straight there.
    pub(super) fn nearer_zero(&mut self) -> bool {
        let mut values = self.home.values.clone();
        let mut nearer = Vec::new();
        for s in (0..values.len()).filter(|&s| self.is_vanishing(s) && self.held != Some(s)) {
            let exponent = self.objective.coordinates[s].level.unwrap_or(1.0);
            let gain = -self.home.gradient[s] / exponent;
            if gain > BEYOND {
                values[s] *= (NEARER * BEYOND / gain).powf(exponent.recip());
                nearer.push(s);
            }
        }
        let next = if nearer.is_empty() { None } else { self.at(&values) };
        let Some(next) = next.filter(|next| next.value() > self.home.value() + NEARER * BEYOND) else { return false };
        nearer.into_iter().for_each(|s| self.bottom[s] = values[s]);
        self.arrive(next);
        true
    }

    /// The size that a level has, or had.
    fn size(&self, s: usize) -> f64 {
        self.home.values[s].max(self.before_zero[s])
    }

    /// Logarithms along which ℓ runs level downwards are tried at their lower bound, at zero say: all at once, then a few of
    /// them one by one.
    pub(super) fn leap(&mut self, joint: &JointInformation) -> bool {
        let sinking = |&s: &usize| {
            let (slope, bend) = (self.home.gradient[s], joint.curvature(s));
            let tail = (-TAIL..0.0).contains(&slope) && bend > 0.0 && bend <= LEVEL * slope.abs();
            self.objective.coordinates[s].log && tail && self.home.values[s] > self.bottom[s]
        };
        let sinking: Vec<usize> = joint.active.iter().copied().filter(sinking).collect();
        let mut sets = vec![sinking.clone()];
        if sinking.len() > 1 {
            sets.extend(sinking.iter().take(8).map(|&s| vec![s]));
        }
        let mut leapt = false;
        for set in sets.iter().filter(|set| !set.is_empty()) {
            if set.iter().any(|&s| self.home.values[s] <= self.bottom[s]) {
                continue; // with all the others, a moment ago
            }
            leapt |= self.jump(set);
        }
        leapt
    }

    /// To the bottom of some values, unless ℓ falls.
    fn jump(&mut self, set: &[usize]) -> bool {
        let slack = 1e-11 * self.home.value().abs().max(1.0);
        let mut values = self.home.values.clone();
        set.iter().for_each(|&s| values[s] = self.bottom[s]);
        let next = self.at(&values).or_else(|| self.above_zero(&values));
        let Some(next) = next.filter(|next| next.value() >= self.home.value() - slack) else { return false };
        self.arrive(next);
        true
    }

    /// Levels so small that ℓ does not feel them are at zero.
    pub(super) fn sunk(&mut self, joint: &JointInformation) -> bool {
        let faint = |s: &usize| {
            let level = self.objective.coordinates[*s].level.is_some() && self.standing[*s] == Standing::Inside;
            level
                && self.home.values[*s] > self.bottom[*s]
                && self.home.values[*s] < FEW_PARTS * self.before_zero[*s]
                && self.home.gradient[*s].abs() < UNFELT
                && joint.curvature(*s).abs() < UNFELT
                && self.held != Some(*s)
        };
        let faint: Vec<usize> = (0..self.home.values.len()).filter(faint).collect();
        for &s in &faint {
            if !self.jump(&[s]) {
                self.bottom[s] = self.home.values[s];
            }
        }
        self.place();
        !faint.is_empty()
    }

    /// Logarithms that would still go far for next to nothing are left where they are: at zero, as far as the data can tell, or
    /// at infinity.
    pub(super) fn drifted(&mut self, joint: &JointInformation, step: &joint::JointStep) -> bool {
        if 0.5 * step.decrement.powi(2) > BEYOND {
            return false;
        }
        let mut any = false;
        for (s, d) in step.alpha.iter().enumerate() {
            let coordinate = &self.objective.coordinates[s];
            if !coordinate.log || d.abs() <= DRIFT || self.standing[s] != Standing::Inside {
                continue;
            }
            any = true;
            let (slope, bend) = (self.home.gradient[s], joint.curvature(s));
            if coordinate.level.is_some() && slope < 0.0 && self.jump(&[s]) {
                continue;
            }
            let level = bend > 0.0 && bend <= LEVEL * slope.abs();
            self.standing[s] = match (level, slope > 0.0) {
                (true, true) => Standing::Unbounded,
                (true, false) => Standing::Vanishing,
                (false, _) => Standing::Unidentified,
            };
            self.drifted[s] = true;
        }
        any
    }
}
