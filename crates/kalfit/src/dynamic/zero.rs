//! Values on their way to zero and to infinity, and back.
//!
//! A noise level moves in its variance v, where zero is a bound like any other: v = 0 is a maximum in v when D = ∂ℓ/∂v ≤ 0 there,
//! and ∂ℓ/∂σ = 2σD = 0 says nothing. What only shapes that noise (its time constant, its correlations) has no effect while it is
//! zero, and D depends on it: D ≤ 0 must hold over its whole range, the *gradient function* of theory §13.

use crate::dynamic::bench::Solved;
use crate::dynamic::joint::{self, Joint, LEVEL_GROUND};
use crate::dynamic::search::{DRIFT, RISE, Search};
use crate::dynamic::{Standing, start};

/// A logarithm whose curvature is no more than this many times its slope has no optimum in sight: ℓ runs level towards a bound,
/// as 1/x, x² or the like.
const LEVEL: f64 = 3.5;
/// … and only a slope below this, and so little of ℓ to be had, makes a leap worth a try.
const TAIL: f64 = 0.1;
/// A level with a slope below this moves in its variance where that is straighter.
const STEEP: f64 = 5.0;
/// ℓ that may still be had beyond, where a value counts as infinite.
const BEYOND: f64 = 1e-7;
/// Where ℓ is not defined at zero, this part of the size that the level had stands for it: its square is nothing to ℓ, and leaves
/// scores their digits.
const NEARLY_ZERO: f64 = 3e-4;
/// Levels at zero are given this part of what they were, where a derivative at zero is wanted.
const TRACE: f64 = 1e-7;
/// … and this part where what they drive is to be felt.
const FELT: f64 = 0.3;
/// A derivative at zero counts when the variance that was would gain this by it.
const GAIN: f64 = 1e-7;
/// Sizes at which a level may return: powers of this part of the variance it had.
const SMALLER: f64 = 0.125;
const SIZES: i32 = 8;
/// How often a level may return.
const RETURNS: usize = 4;
/// A level below this part of what it was, whose slope and curvature are below this, is not felt.
const FEW_PARTS: f64 = 1e-2;
const UNFELT: f64 = 1e-6;
/// Slopes below this are none.
const FLAT: f64 = 1e-9;
/// Times that are tried for time constants without effect: by this factor, from this part of a step to as many spans.
const FACTOR: f64 = 2.0;
const PART: f64 = 0.05;
const SPANS: f64 = 4.0;
const MOST_TIMES: usize = 40;

/// Values for some slots.
type Change = Vec<(usize, f64)>;

impl Search<'_, '_> {
    /// A level that ℓ would have at zero, where it is not defined.
    pub(super) fn is_vanishing(&self, s: usize) -> bool {
        let (coordinate, value) = (&self.bench.coordinates[s], self.home.values[s]);
        coordinate.level.is_some() && self.bottom[s] > coordinate.lower && value <= self.bottom[s]
    }

    /// Levels whose variance is nearer to ℓ's own coordinate than its logarithm, with their exponents: those that would reach zero,
    /// and those far below their optimum.
    pub(super) fn levels_near_zero(&self, joint: &Joint) -> Vec<(usize, f64)> {
        let near = |&s: &usize| -> Option<(usize, f64)> {
            let exponent = self.bench.coordinates[s].level?;
            let (slope, bend) = (self.home.gradient[s], joint.curvature(s));
            let straight = exponent * slope.abs();
            let sinks = slope < 0.0 && slope > -STEEP && bend > 0.9 * straight && bend < 2.0 * straight;
            let rises = slope > 0.0 && bend < 0.5 * straight && bend > -1.1 * straight;
            (sinks || rises).then_some((s, exponent))
        };
        joint.active.iter().filter_map(near).collect()
    }

    /// Where ℓ is not defined with levels at zero, the same with them a little above it, which is as low as they go from now on.
    pub(super) fn above_zero(&mut self, values: &[f64]) -> Option<Solved> {
        let mut raised = values.to_vec();
        let fell =
            |&s: &usize| self.bench.coordinates[s].level.is_some() && values[s] == 0.0 && self.home.values[s] > 0.0;
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

    /// The size that a level has, or had.
    fn size(&self, s: usize) -> f64 {
        self.home.values[s].max(self.before_zero[s])
    }

    /// Logarithms along which ℓ runs level downwards are tried at their lower bound, at zero say: all at once, then a few of
    /// them one by one.
    pub(super) fn leap(&mut self, joint: &Joint) -> bool {
        let sinking = |&s: &usize| {
            let (slope, bend) = (self.home.gradient[s], joint.curvature(s));
            let tail = (-TAIL..0.0).contains(&slope) && bend > 0.0 && bend <= LEVEL * slope.abs();
            self.bench.coordinates[s].log && tail && self.home.values[s] > self.bottom[s]
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
    pub(super) fn sunk(&mut self, joint: &Joint) -> bool {
        let faint = |s: &usize| {
            let level = self.bench.coordinates[*s].level.is_some() && self.standing[*s] == Standing::Inside;
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
    pub(super) fn drifted(&mut self, joint: &Joint, step: &joint::Step) -> bool {
        if 0.5 * step.decrement.powi(2) > BEYOND {
            return false;
        }
        let mut any = false;
        for (s, d) in step.alpha.iter().enumerate() {
            let coordinate = &self.bench.coordinates[s];
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

    /// A level at zero returns where ℓ rises with its variance, for some shape of what it drives.
    pub(super) fn revived(&mut self, joint: &Joint) -> bool {
        let is_zero = |&s: &usize| {
            let level = self.bench.coordinates[s].level.is_some() && self.home.values[s] <= self.bottom[s];
            level && self.bench.coordinates[s].lower == 0.0 && self.held != Some(s) && self.returned[s] < RETURNS
        };
        let zeros: Vec<usize> = (0..self.home.values.len()).filter(is_zero).collect();
        if zeros.is_empty() {
            return false;
        }
        let mut found: Vec<(f64, usize, Change)> = Vec::new();
        for shape in self.shapes(joint) {
            for (s, gain) in self.derivatives_at_zero(&zeros, &shape) {
                found.push((gain, s, shape.clone()));
            }
        }
        let best = |s: usize| found.iter().filter(|(_, level, _)| *level == s).max_by(|a, b| a.0.total_cmp(&b.0));
        let mut promising: Vec<(f64, usize, Change)> = zeros.iter().filter_map(|&s| best(s).cloned()).collect();
        promising.retain(|(gain, ..)| *gain > GAIN);
        promising.sort_by(|a, b| b.0.total_cmp(&a.0));
        promising.into_iter().any(|(_, s, shape)| self.returns(s, &shape))
    }

    /// Back from zero at the largest size at which ℓ is higher than at zero.
    fn returns(&mut self, s: usize, shape: &Change) -> bool {
        let exponent = self.bench.coordinates[s].level.unwrap_or(1.0);
        for size in 0..SIZES {
            let mut values = self.home.values.clone();
            shape.iter().for_each(|&(t, value)| values[t] = value);
            let value = self.before_zero[s] * SMALLER.powi(size).powf(exponent.recip());
            values[s] = value.clamp(self.bottom[s], self.bench.coordinates[s].upper);
            if let Some(next) = self.at(&values).filter(|next| next.value() > self.home.value() + RISE) {
                self.home = next;
                // time constants of a noise that has come back
                let idle = |standing: &&mut Standing| **standing == Standing::Unidentified;
                self.standing.iter_mut().filter(idle).for_each(|standing| *standing = Standing::Inside);
                self.drifted.fill(false);
                self.returned[s] += 1;
                self.standing[s] = Standing::Inside;
                self.place();
                return true;
            }
        }
        false
    }

    /// ∂ℓ/∂v at v = 0 for each of some levels, times the variance it had, with other shapes for what they drive.
    fn derivatives_at_zero(&self, zeros: &[usize], shape: &Change) -> Vec<(usize, f64)> {
        let mut values = self.home.values.clone();
        shape.iter().for_each(|&(t, value)| values[t] = value);
        zeros.iter().for_each(|&s| values[s] = values[s].max(TRACE * self.before_zero[s]));
        let Some(at) = self.bench.shift(&self.home, &values) else { return Vec::new() };
        let gradient = self.bench.gradient(&values, &at.tests.scores, &at.matrix);
        let gain = |&s: &usize| {
            let exponent = self.bench.coordinates[s].level.unwrap_or(1.0);
            let gain = gradient[s] / exponent * (self.before_zero[s] / values[s]).powf(exponent);
            gain.is_finite().then_some((s, gain))
        };
        zeros.iter().filter_map(gain).collect()
    }

    /// Shapes of what levels at zero drive: the present one, and values without effect over their ranges.
    fn shapes(&self, joint: &Joint) -> Vec<Change> {
        let mut all = vec![Change::new()];
        let idle = self.idle(joint);
        let constants = start::time_constants(self.bench.model);
        let is_time = |t: &usize| constants.contains(&self.bench.slots.slots()[*t].parameter);
        let (times, others): (Vec<usize>, Vec<usize>) = idle.into_iter().partition(is_time);
        if !times.is_empty() {
            let at = |time: f64| -> Change {
                let within = |t: usize| time.clamp(self.bench.coordinates[t].lower, self.bench.coordinates[t].upper);
                times.iter().map(|&t| (t, within(t))).collect()
            };
            all.extend(start::Scales::of(self.bench).range(PART, SPANS, FACTOR).take(MOST_TIMES).map(at));
        }
        let few: Vec<Change> = all.iter().step_by((all.len() / 4).max(1)).cloned().collect();
        for t in others {
            for value in self.bench.coordinates[t].spread(self.home.values[t]) {
                all.extend(few.iter().map(|shape| {
                    let mut shape = shape.clone();
                    shape.push((t, value));
                    shape
                }));
            }
        }
        all
    }

    /// Values along which ℓ does not move at all.
    fn idle(&self, joint: &Joint) -> Vec<usize> {
        let flat = |t: &usize| {
            let at_zero = self.bench.coordinates[*t].level.is_some() && self.home.values[*t] <= self.bottom[*t];
            let level_ground = self.home.gradient[*t].abs() < FLAT && joint.curvature(*t).abs() < LEVEL_GROUND;
            level_ground && !at_zero && self.held != Some(*t)
        };
        (0..self.home.values.len()).filter(flat).collect()
    }

    /// Values without effect while levels are zero are told from those that ℓ never depends on.
    pub(super) fn name_idle(&mut self, joint: &Joint) {
        let zero = |s: &usize| self.bench.coordinates[*s].level.is_some() && self.home.values[*s] <= self.bottom[*s];
        let zeros: Vec<usize> = (0..self.home.values.len()).filter(zero).collect();
        let is_open = |t: &usize| matches!(self.standing[*t], Standing::Inside | Standing::Unidentified);
        let idle: Vec<usize> = self.idle(joint).into_iter().filter(is_open).collect();
        if zeros.is_empty() || idle.is_empty() {
            return;
        }
        let mut values = self.home.values.clone();
        zeros.iter().for_each(|&s| values[s] = values[s].max(FELT * self.before_zero[s]));
        let Some(at) = self.bench.shift(&self.home, &values) else { return };
        let gradient = self.bench.gradient(&values, &at.tests.scores, &at.matrix);
        idle.into_iter().filter(|&t| gradient[t].abs() > FLAT).for_each(|t| self.standing[t] = Standing::Idle);
    }
}
