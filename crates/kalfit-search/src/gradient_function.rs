//! Whether a noise level at zero is at a maximum: the *gradient function* (theory §13).
//!
//! v = 0 is a maximum in the variance v when D = ∂ℓ/∂v ≤ 0 there, and ∂ℓ/∂σ = 2σD = 0 says nothing. Values that only
//! shape that noise (time constant, correlations) have no effect while the level is zero, but D depends on such values:
//! D ≤ 0 must hold over the whole range of each.

use crate::Standing;
use crate::joint::{FLAT_LOGARITHM, JointInformation};
use crate::profile_likelihood::{ProfileLikelihood, ProfilePoint};
use crate::scales::time_constants;
use crate::search_state::{MIN_RISE, SearchState};

/// Value of a level, relative to the former size, at which derivatives at zero are evaluated.
const DERIVATIVE_SIZE: f64 = 1e-7;
/// Value of a level at zero, relative to the former size, at which values that shape the noise have an effect.
const EFFECT_SIZE: f64 = 0.3;
/// Rise of ℓ, predicted for the former variance, above which a derivative at zero counts.
const MIN_GAIN: f64 = 1e-7;
/// Ratio of successive variances at which a level may return, beginning with the former variance.
const VARIANCE_RATIO: f64 = 0.125;
/// Number of variances that are tried in any case.
const MIN_SIZES: i32 = 8;
/// Maximal number of variances that are tried, where smaller variances still promise a rise of ℓ.
const MAX_SIZES: i32 = 24;
/// Values tried for a covariance, relative to the bound of the covariance.
const TRIAL_CORRELATIONS: [f64; 4] = [-1.0, 1.0, -0.4, 0.4];
/// Slope of ℓ that counts as zero.
const FLAT_SLOPE: f64 = 1e-9;
/// Ratio of successive times that are tried for time constants without effect.
const TIME_RATIO: f64 = 2.0;
/// Shortest time constant tried, in lengths of a step.
const SHORTEST_TIME: f64 = 0.05;
/// Longest time constant tried, in lengths of a test.
const LONGEST_TIME: f64 = 4.0;
/// Maximal number of time constants tried between the shortest and the longest.
const MAX_TIMES: usize = 40;
/// Further time constants tried, in lengths of a test, at which the process is all but constant in a test.
const LONG_TIMES: [f64; 3] = [30.0, 1e3, 1e6];

/// New values, as (slot, value).
type ChangedValues = Vec<(usize, f64)>;

/// Derivative at zero times the former variance, the slot of the level, and the shape of its noise.
type Derivative = (f64, usize, ChangedValues);

impl SearchState<'_, '_> {
    /// Raises a level from zero where ℓ rises with the variance for some shape of the noise; returns whether a level
    /// was raised.
    pub(super) fn reactivate_levels(&mut self, joint: &JointInformation) -> bool {
        let mut zeros = self.zeros();
        zeros.retain(|&s| self.objective.coordinates[s].lower == 0.0 && self.held != Some(s));
        if zeros.is_empty() {
            return false;
        }
        let shapes = self.shapes(joint);
        let at_zero = self.at_zero();
        let derivatives = self.objective.each(&shapes, |shape| at_zero.derivatives(&zeros, shape));
        let mut found: Vec<Derivative> = derivatives.into_iter().flatten().collect();
        for &s in &zeros {
            found.extend(self.derivatives_between(s, &found));
        }
        let best = |s: usize| found.iter().filter(|(_, level, _)| *level == s).max_by(|a, b| a.0.total_cmp(&b.0));
        let mut promising: Vec<Derivative> = zeros.iter().filter_map(|&s| best(s).cloned()).collect();
        promising.retain(|(gain, ..)| *gain > MIN_GAIN);
        promising.sort_by(|a, b| b.0.total_cmp(&a.0));
        promising.into_iter().any(|(gain, s, shape)| self.reactivate(s, gain, &shape))
            || self.reactivate_with_covariance(&zeros)
    }

    /// Raises a noise level from zero together with a free covariance to another noise: the covariance is proportional
    /// to the level, so that ℓ has a slope in the level that no derivative in the variance shows.
    fn reactivate_with_covariance(&mut self, zeros: &[usize]) -> bool {
        let crossed = |&s: &usize| {
            let parameter = self.objective.slots.slots()[s].parameter;
            self.objective
                .edges
                .beside(parameter)
                .into_iter()
                .flat_map(move |t| TRIAL_CORRELATIONS.map(|part| (s, vec![(t, part)])))
        };
        let ways: Vec<(usize, ChangedValues)> = zeros.iter().flat_map(crossed).collect();
        ways.into_iter().any(|(s, shape)| self.reactivate(s, 0.0, &shape))
    }

    /// Raises a level from zero to the largest size tried at which ℓ is higher. `gain`: predicted rise of ℓ for the
    /// former variance; the prediction is proportional to the variance.
    fn reactivate(&mut self, s: usize, gain: f64, shape: &ChangedValues) -> bool {
        let exponent = self.objective.coordinates[s].level.unwrap_or(1.0);
        let is_worth = |size: &i32| *size < MIN_SIZES || gain * VARIANCE_RATIO.powi(*size) > MIN_RISE;
        for size in (0..MAX_SIZES).take_while(is_worth) {
            let mut values = self.iterate.values.clone();
            shape.iter().for_each(|&(t, value)| values[t] = value);
            let value = self.before_zero[s] * VARIANCE_RATIO.powi(size).powf(exponent.recip());
            values[s] = value.clamp(self.lower_limit[s], self.objective.coordinates[s].upper);
            if let Some(next) = self.at(&values).filter(|next| next.value() > self.iterate.value() + MIN_RISE) {
                self.iterate = next;
                // the time constants of the reactivated noise can move again
                let idle = |standing: &&mut Standing| **standing == Standing::Unidentified;
                self.standing.iter_mut().filter(idle).for_each(|standing| *standing = Standing::Inside);
                self.marked_unbounded.fill(false);
                self.standing[s] = Standing::Inside;
                self.update_standing();
                if !self.returned.contains(&s) {
                    self.returned.push(s);
                }
                return true;
            }
        }
        false
    }

    fn at_zero(&self) -> AtZero<'_> {
        AtZero { objective: self.objective, iterate: &self.iterate, before_zero: &self.before_zero }
    }

    /// Trial shapes of noises whose levels are at zero: the present shape, and shapes with values without effect over
    /// the ranges of these values.
    fn shapes(&self, joint: &JointInformation) -> Vec<ChangedValues> {
        let mut all = vec![ChangedValues::new()];
        let idle = self.idle(joint);
        let constants = time_constants(self.objective.model);
        let is_time = |t: &usize| constants.contains(&self.objective.slots.slots()[*t].parameter);
        let (times, others): (Vec<usize>, Vec<usize>) = idle.into_iter().partition(is_time);
        if !times.is_empty() {
            let at = |time: f64| -> ChangedValues {
                let within =
                    |t: usize| time.clamp(self.objective.coordinates[t].lower, self.objective.coordinates[t].upper);
                times.iter().map(|&t| (t, within(t))).collect()
            };
            let scales = self.objective.scales();
            all.extend(
                scales
                    .times_between(SHORTEST_TIME, LONGEST_TIME, TIME_RATIO)
                    .take(MAX_TIMES)
                    .chain(scales.long_times(LONG_TIMES))
                    .map(at),
            );
        }
        let few: Vec<ChangedValues> = all.iter().step_by((all.len() / 4).max(1)).cloned().collect();
        for t in others {
            for value in self.objective.coordinates[t].values_over_range(self.iterate.values[t]) {
                all.extend(few.iter().map(|shape| {
                    let mut shape = shape.clone();
                    shape.push((t, value));
                    shape
                }));
            }
        }
        all
    }

    /// Derivatives of a level between the times that were tried, at the tops of parabolas through three of them, where
    /// the highest of the three is not positive, but a derivative between two times may be.
    fn derivatives_between(&self, s: usize, found: &[Derivative]) -> Vec<Derivative> {
        let level_derivatives: Vec<&Derivative> = found.iter().filter(|(_, level, _)| *level == s).collect();
        let mut tops = Vec::new();
        for around in level_derivatives.windows(3) {
            let [(before, _, shorter), (gain, _, shape), (after, _, longer)] = around else { continue };
            let is_top = gain >= before && gain >= after && *gain <= MIN_GAIN && (before < gain || after < gain);
            let [Some(short), Some(time), Some(long)] = [shorter, shape, longer].map(common_time) else {
                continue;
            };
            if !is_top || short >= time || time >= long {
                continue;
            }
            let (left, right) = ((time / short).ln(), (long / time).ln());
            let (fall, drop) = ((gain - before) / left, (gain - after) / right);
            let shift = 0.5 * (fall * right - drop * left) / (fall + drop);
            let change: ChangedValues = shape.iter().map(|&(t, _)| (t, time * shift.exp())).collect();
            tops.extend(self.at_zero().derivatives(&[s], &change));
        }
        tops
    }

    /// Slots of the values in which ℓ has neither slope nor curvature.
    fn idle(&self, joint: &JointInformation) -> Vec<usize> {
        let flat = |t: &usize| {
            let level_ground =
                self.iterate.gradient[*t].abs() < FLAT_SLOPE && joint.curvature(*t).abs() < FLAT_LOGARITHM;
            level_ground && !self.is_at_zero(*t) && self.held != Some(*t)
        };
        (0..self.iterate.values.len()).filter(flat).collect()
    }

    /// Marks values that have no effect while levels are zero, as opposed to values on which ℓ never depends.
    pub(super) fn mark_idle(&mut self, joint: &JointInformation) {
        let zeros = self.zeros();
        let is_open = |t: &usize| matches!(self.standing[*t], Standing::Inside | Standing::Unidentified);
        let idle: Vec<usize> = self.idle(joint).into_iter().filter(is_open).collect();
        if zeros.is_empty() || idle.is_empty() {
            return;
        }
        let mut values = self.iterate.values.clone();
        zeros.iter().for_each(|&s| values[s] = values[s].max(EFFECT_SIZE * self.before_zero[s]));
        let Some(at) = self.objective.shift(&self.iterate, &values) else { return };
        let gradient = self.objective.gradient(&values, &at.tests.scores, &at.matrix);
        idle.into_iter().filter(|&t| gradient[t].abs() > FLAT_SLOPE).for_each(|t| self.standing[t] = Standing::Idle);
    }
}

/// A point where levels are at zero.
#[derive(Clone, Copy)]
struct AtZero<'s> {
    objective: &'s ProfileLikelihood<'s>,
    iterate: &'s ProfilePoint,
    before_zero: &'s [f64],
}

impl AtZero<'_> {
    /// ∂ℓ/∂v at v = 0 × the former variance, for each level of `zeros`, with the noises in another shape.
    fn derivatives(self, zeros: &[usize], shape: &ChangedValues) -> Vec<Derivative> {
        let AtZero { objective, iterate, before_zero } = self;
        let mut values = iterate.values.clone();
        shape.iter().for_each(|&(t, value)| values[t] = value);
        zeros.iter().for_each(|&s| values[s] = values[s].max(DERIVATIVE_SIZE * before_zero[s]));
        let Some(at) = objective.shift(iterate, &values) else { return Vec::new() };
        let gradient = objective.gradient(&values, &at.tests.scores, &at.matrix);
        let derivative = |&s: &usize| {
            let exponent = objective.coordinates[s].level.unwrap_or(1.0);
            let gain = gradient[s] / exponent * (before_zero[s] / values[s]).powf(exponent);
            gain.is_finite().then(|| (gain, s, shape.clone()))
        };
        zeros.iter().filter_map(derivative).collect()
    }
}

/// The time that all entries of a shape have in common; `None` if there is none.
fn common_time(shape: &ChangedValues) -> Option<f64> {
    let (_, time) = *shape.first()?;
    shape.iter().all(|(_, other)| *other == time).then_some(time)
}
