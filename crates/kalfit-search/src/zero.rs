//! Values on their way to zero and to infinity. A noise level moves in its variance, where zero is a bound like any other.

use crate::Standing;
use crate::joint;
use crate::joint::JointInformation;
use crate::profile_likelihood::ProfilePoint;
use crate::search_state::{DRIFT, SearchState};

/// Ratio of curvature to slope of a logarithm up to which no optimum is in sight: ℓ levels off towards a bound, as 1/x,
/// x² or the like.
const LEVEL: f64 = 3.5;
/// Slope of such a logarithm below which its bound is tried: little of ℓ can then be gained on the way.
const TAIL: f64 = 0.1;
/// Slope of a level below which it may move in its variance, where ℓ is straighter in that.
const STEEP: f64 = 5.0;
/// Negative curvature in a variance, relative to its slope, that is treated as zero.
const HOLLOW: f64 = 0.1;
/// Remaining rise of ℓ up to which a value on its way to infinity or to zero is left where it is.
const BEYOND: f64 = 1e-7;
/// Part of its former size that stands for a level at zero where ℓ is not defined there: its square does not affect ℓ,
/// and scores keep their digits.
const NEARLY_ZERO: f64 = 1e-4;
/// Where ℓ would rise by more than [`BEYOND`] towards zero, a level is lowered until this part of [`BEYOND`] is left.
const NEARER: f64 = 0.1;
/// Part of its former size below which a level may be without effect on ℓ.
const FEW_PARTS: f64 = 1e-2;
/// Slope and curvature below which such a level has no effect on ℓ.
const UNFELT: f64 = 1e-6;

impl SearchState<'_, '_> {
    /// Levels at zero, or as near to it as ℓ is defined.
    pub(super) fn zeros(&self) -> Vec<usize> {
        (0..self.home.values.len()).filter(|&s| self.is_at_zero(s)).collect()
    }

    /// Whether a noise level is at its least value.
    pub(super) fn is_at_zero(&self, s: usize) -> bool {
        self.objective.coordinates[s].level.is_some() && self.home.values[s] <= self.bottom[s]
    }

    /// Whether a level is held above zero because ℓ, though higher near zero, is not defined there.
    pub(super) fn is_vanishing(&self, s: usize) -> bool {
        self.is_at_zero(s) && self.bottom[s] > self.objective.coordinates[s].lower
    }

    /// Levels for which ℓ is straighter in the variance than in the logarithm, with their exponents: those that would
    /// reach zero, and those far below their optimum.
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

    /// All levels that move, with their exponents, except where ℓ is far from concave in the variance.
    pub(super) fn all_levels(&self, joint: &JointInformation) -> Vec<(usize, f64)> {
        let level = |&s: &usize| {
            let exponent = self.objective.coordinates[s].level?;
            let bend = exponent * self.home.gradient[s];
            (joint.curvature(s) + bend > -HOLLOW * bend.abs()).then_some((s, exponent))
        };
        joint.active.iter().filter_map(level).collect()
    }

    /// The point with levels a little above zero, where ℓ is not defined with them at zero; they go no lower from now
    /// on.
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

    /// Lowers levels that are as near to zero as ℓ was defined, where that is worth it: ℓ is linear in their variances
    /// there.
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

    /// The present size of a level, or its former size if that is larger.
    fn size(&self, s: usize) -> f64 {
        self.home.values[s].max(self.before_zero[s])
    }

    /// Tries logarithms along which ℓ levels off downwards at their lower bound, such as zero: all at once, then a few
    /// of them one by one.
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
                continue; // the set of all has just moved this value
            }
            leapt |= self.jump(set);
        }
        leapt
    }

    /// Moves some values to their least values, unless ℓ falls.
    fn jump(&mut self, set: &[usize]) -> bool {
        let slack = 1e-11 * self.home.value().abs().max(1.0);
        let mut values = self.home.values.clone();
        set.iter().for_each(|&s| values[s] = self.bottom[s]);
        let next = self.at(&values).or_else(|| self.above_zero(&values));
        let Some(next) = next.filter(|next| next.value() >= self.home.value() - slack) else { return false };
        self.arrive(next);
        true
    }

    /// Sets levels to zero that are too small to affect ℓ.
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

    /// Leaves logarithms where they are that would still move far for a negligible gain: as far as the data can tell,
    /// they are at zero or at infinity.
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
