//! Values on the way to zero and to infinity. A noise level near zero moves in the variance, in which zero is a bound
//! like any other.

use crate::Standing;
use crate::joint;
use crate::joint::JointInformation;
use crate::profile_likelihood::ProfilePoint;
use crate::search_state::{FAR_STEP, SearchState};

/// Ratio of curvature to slope of ℓ in a logarithm up to which no optimum is in sight: ℓ levels off towards a bound,
/// like 1/x or x².
const FLAT_RATIO: f64 = 3.5;
/// Slope of ℓ in such a logarithm below which the bound is tried: ℓ then rises little on the way.
const MAX_TAIL_SLOPE: f64 = 0.1;
/// Slope of ℓ in the logarithm of a level below which the level may move in the variance, where ℓ is straighter in the
/// variance.
const MAX_LEVEL_SLOPE: f64 = 5.0;
/// Negative curvature of ℓ in a variance, relative to the slope, that is treated as zero.
const MAX_NEGATIVE_CURVATURE: f64 = 0.1;
/// Remaining rise of ℓ up to which a value on the way to infinity or to zero is stopped.
const NEGLIGIBLE_GAIN: f64 = 1e-7;
/// Value in place of zero for a level, relative to the former size, where ℓ is not defined at zero: the variance does
/// not affect ℓ, and scores lose no digits.
const NEARLY_ZERO: f64 = 1e-4;
/// Remaining rise of ℓ towards zero, relative to [`NEGLIGIBLE_GAIN`], down to which a level is lowered.
const REMAINING_GAIN: f64 = 0.1;
/// Value of a level, relative to the former size, below which the level may have no effect on ℓ.
const SMALL_LEVEL: f64 = 1e-2;
/// Slope and curvature of ℓ in the logarithm of such a level below which the level has no effect.
const NO_EFFECT: f64 = 1e-6;

impl SearchState<'_, '_> {
    /// Indices of the levels at zero, or at the least value at which ℓ is defined.
    pub(super) fn zeros(&self) -> Vec<usize> {
        (0..self.iterate.values.len()).filter(|&s| self.is_at_zero(s)).collect()
    }

    /// Whether a value is a noise level at the lower limit.
    pub(super) fn is_at_zero(&self, s: usize) -> bool {
        self.objective.coordinates[s].level.is_some() && self.iterate.values[s] <= self.lower_limit[s]
    }

    /// Whether a level is held above zero because ℓ, though higher near zero, is not defined there.
    pub(super) fn is_vanishing(&self, s: usize) -> bool {
        self.is_at_zero(s) && self.lower_limit[s] > self.objective.coordinates[s].lower
    }

    /// Levels, as (slot, exponent), for which ℓ is straighter in the variance than in the logarithm: levels that would
    /// reach zero, and levels far below the optimum.
    pub(super) fn levels_near_zero(&self, joint: &JointInformation) -> Vec<(usize, f64)> {
        let near = |&s: &usize| -> Option<(usize, f64)> {
            let exponent = self.objective.coordinates[s].level?;
            let (slope, bend) = (self.iterate.gradient[s], joint.curvature(s));
            let linear_curvature = exponent * slope.abs();
            let sinks = slope < 0.0
                && slope > -MAX_LEVEL_SLOPE
                && bend > 0.9 * linear_curvature
                && bend < 2.0 * linear_curvature;
            let rises = slope > 0.0 && bend < 0.5 * linear_curvature && bend > -1.1 * linear_curvature;
            (sinks || rises).then_some((s, exponent))
        };
        joint.active.iter().filter_map(near).collect()
    }

    /// All levels that move, as (slot, exponent), except where ℓ is far from concave in the variance.
    pub(super) fn all_levels(&self, joint: &JointInformation) -> Vec<(usize, f64)> {
        let level = |&s: &usize| {
            let exponent = self.objective.coordinates[s].level?;
            let bend = exponent * self.iterate.gradient[s];
            (joint.curvature(s) + bend > -MAX_NEGATIVE_CURVATURE * bend.abs()).then_some((s, exponent))
        };
        joint.active.iter().filter_map(level).collect()
    }

    /// The point with levels a little above zero in place of zero, where ℓ is not defined; that value is the lower
    /// limit of each such level from then on.
    pub(super) fn try_above_zero(&mut self, values: &[f64]) -> Option<ProfilePoint> {
        let mut raised = values.to_vec();
        let fell = |&s: &usize| {
            self.objective.coordinates[s].level.is_some() && values[s] == 0.0 && self.iterate.values[s] > 0.0
        };
        let zeroed_levels: Vec<usize> = (0..values.len()).filter(fell).collect();
        if zeroed_levels.is_empty() {
            return None;
        }
        zeroed_levels.iter().for_each(|&s| raised[s] = self.iterate.values[s].min(NEARLY_ZERO * self.size(s)));
        let slack = 1e-11 * self.iterate.value().abs().max(1.0);
        let next = self.at(&raised).filter(|next| next.value() >= self.iterate.value() - slack)?;
        zeroed_levels.iter().for_each(|&s| self.lower_limit[s] = raised[s]);
        Some(next)
    }

    /// Lowers levels at a lower limit above zero where ℓ rises by more than [`NEGLIGIBLE_GAIN`] towards zero; ℓ is
    /// linear in the variances there.
    pub(super) fn lower_vanishing_levels(&mut self) -> bool {
        let mut values = self.iterate.values.clone();
        let mut lowered_levels = Vec::new();
        for s in (0..values.len()).filter(|&s| self.is_vanishing(s) && self.held != Some(s)) {
            let exponent = self.objective.coordinates[s].level.unwrap_or(1.0);
            let gain = -self.iterate.gradient[s] / exponent;
            if gain > NEGLIGIBLE_GAIN {
                values[s] *= (REMAINING_GAIN * NEGLIGIBLE_GAIN / gain).powf(exponent.recip());
                lowered_levels.push(s);
            }
        }
        let next = if lowered_levels.is_empty() { None } else { self.at(&values) };
        let Some(next) = next.filter(|next| next.value() > self.iterate.value() + REMAINING_GAIN * NEGLIGIBLE_GAIN)
        else {
            return false;
        };
        lowered_levels.into_iter().for_each(|s| self.lower_limit[s] = values[s]);
        self.move_to(next);
        true
    }

    /// The present size of a level, or its former size if that is larger.
    fn size(&self, s: usize) -> f64 {
        self.iterate.values[s].max(self.before_zero[s])
    }

    /// Tries the lower limit, such as zero, of logarithms along which ℓ levels off downward: all logarithms at once,
    /// then up to eight one by one.
    pub(super) fn try_lower_bounds(&mut self, joint: &JointInformation) -> bool {
        let sinking = |&s: &usize| {
            let (slope, bend) = (self.iterate.gradient[s], joint.curvature(s));
            let tail = (-MAX_TAIL_SLOPE..0.0).contains(&slope) && bend > 0.0 && bend <= FLAT_RATIO * slope.abs();
            self.objective.coordinates[s].log && tail && self.iterate.values[s] > self.lower_limit[s]
        };
        let sinking: Vec<usize> = joint.active.iter().copied().filter(sinking).collect();
        let mut sets = vec![sinking.clone()];
        if sinking.len() > 1 {
            sets.extend(sinking.iter().take(8).map(|&s| vec![s]));
        }
        let mut has_moved = false;
        for set in sets.iter().filter(|set| !set.is_empty()) {
            if set.iter().any(|&s| self.iterate.values[s] <= self.lower_limit[s]) {
                continue; // the set of all has just moved this value
            }
            has_moved |= self.try_at_bound(set);
        }
        has_moved
    }

    /// Moves some values to the lower limits, unless ℓ falls.
    fn try_at_bound(&mut self, set: &[usize]) -> bool {
        let slack = 1e-11 * self.iterate.value().abs().max(1.0);
        let mut values = self.iterate.values.clone();
        set.iter().for_each(|&s| values[s] = self.lower_limit[s]);
        let next = self.at(&values).or_else(|| self.try_above_zero(&values));
        let Some(next) = next.filter(|next| next.value() >= self.iterate.value() - slack) else { return false };
        self.move_to(next);
        true
    }

    /// Sets to zero the levels that are too small to affect ℓ.
    pub(super) fn zero_unidentified_levels(&mut self, joint: &JointInformation) -> bool {
        let faint = |s: &usize| {
            let level = self.objective.coordinates[*s].level.is_some() && self.standing[*s] == Standing::Inside;
            level
                && self.iterate.values[*s] > self.lower_limit[*s]
                && self.iterate.values[*s] < SMALL_LEVEL * self.before_zero[*s]
                && self.iterate.gradient[*s].abs() < NO_EFFECT
                && joint.curvature(*s).abs() < NO_EFFECT
                && self.held != Some(*s)
        };
        let faint: Vec<usize> = (0..self.iterate.values.len()).filter(faint).collect();
        for &s in &faint {
            if !self.try_at_bound(&[s]) {
                self.lower_limit[s] = self.iterate.values[s];
            }
        }
        self.update_standing();
        !faint.is_empty()
    }

    /// Stops logarithms that would move far for a negligible rise of ℓ: the data do not distinguish such values from
    /// zero or infinity.
    pub(super) fn marked_unbounded(&mut self, joint: &JointInformation, step: &joint::JointStep) -> bool {
        if 0.5 * step.decrement.powi(2) > NEGLIGIBLE_GAIN {
            return false;
        }
        let mut any = false;
        for (s, d) in step.alpha.iter().enumerate() {
            let coordinate = &self.objective.coordinates[s];
            if !coordinate.log || d.abs() <= FAR_STEP || self.standing[s] != Standing::Inside {
                continue;
            }
            any = true;
            let (slope, bend) = (self.iterate.gradient[s], joint.curvature(s));
            if coordinate.level.is_some() && slope < 0.0 && self.try_at_bound(&[s]) {
                continue;
            }
            let level = bend > 0.0 && bend <= FLAT_RATIO * slope.abs();
            self.standing[s] = match (level, slope > 0.0) {
                (true, true) => Standing::Unbounded,
                (true, false) => Standing::Vanishing,
                (false, _) => Standing::Unidentified,
            };
            self.marked_unbounded[s] = true;
        }
        any
    }
}
