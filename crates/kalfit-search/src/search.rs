//! The outer search (the paper's Figure 1): μ and Σ are solved for each α, and Newton's method moves α.

use crate::em::Em;
use crate::exchangeable::ExchangeablePair;
use crate::joint;
use crate::joint::{FLAT_LOGARITHM, InformationDirection, JointInformation};
use crate::profile_likelihood::{ProfileLikelihood, ProfilePoint};
use crate::quadratic::LevelScale;
use crate::ridge;
use crate::ridge::{Ridge, RidgeStart};
use crate::search_state::{FAR_STEP, LONGEST, MIN_RISE, NEAR_ENOUGH, SearchEnd, SearchStart, SearchState};
use crate::{DynamicError, Method, Standing};
use kalfit_estimate::{Progress, Stop};
use kalfit_model::Population;

/// Largest relative growth g of a variance v in one step, to (1 + g) v.
const MAX_VARIANCE_GROWTH: f64 = 20.0;
/// Damping from which on no shorter step is tried.
const MAX_DAMPING: f64 = 1e6;
/// Maximal number of outer steps, those of α, in one search.
const MAX_OUTER_STEPS: usize = 200;
/// Maximal number of consecutive steps that may leave ℓ unchanged within rounding.
const MAX_FLAT_STEPS: usize = 8;
/// Decrement, in standard errors, below which the search looks for levels without effect on ℓ and for ridges.
pub(super) const SMALL_DECREMENT: f64 = 1e-3;
/// Decrement, in standard errors, below which coinciding processes are merged.
const MERGE_DECREMENT: f64 = 1.0;
/// Lengths, in coordinates, of trial steps along directions in which ℓ hardly curves.
const PROBE_LENGTHS: [f64; 6] = [0.3, -0.3, 1.5, -1.5, 4.0, -4.0];
/// Maximal number of points from which a search tries steps of [`PROBE_LENGTHS`].
const MAX_FLAT_PROBES: usize = 3;
/// Distance from the top of a ridge, in standard errors, that is near enough where rounding prevents coming nearer.
const RIDGE_TOLERANCE: f64 = 1e-3;
/// Number of failed attempts to find a ridge after which a search looks for no more ridges.
const MAX_RIDGE_FAILURES: usize = 2;
/// Maximal number of moves along ridges in one search.
const MAX_RIDGE_MOVES: usize = 4;
/// Lengths of trial steps off a point where several factors of a product are zero.
const PRODUCT_STEPS: [f64; 5] = [1.0, 0.1, 0.01, 10.0, 100.0];

/// Ratio of the rise of ℓ to the predicted rise above which a step was too short.
const SHORT_STEP_GAIN: f64 = 1.5;
/// Number of consecutive short steps after which differences are two-sided: one-sided differences change with the step
/// where a ridge is narrow.
const MAX_SHORT_STEPS: usize = 3;
/// Slope above which a point is no maximum although the curvature is below [`FLAT_LOGARITHM`].
const MIN_SLOPE: f64 = 1e-3;

/// The next step of a search.
enum NextStep {
    /// Continue; `two_sided`: with two-sided differences.
    On { two_sided: bool },
    /// End, for this reason.
    End(Stop),
}

impl<'b, 'a> SearchState<'b, 'a> {
    /// Runs the search to an optimum that two-sided differences certify.
    pub fn run(mut self) -> Result<SearchEnd, DynamicError> {
        let mut fine = self.last_decrement.is_some_and(|decrement| decrement <= self.tolerance()); // differences to both sides
        let mut stop = Stop::PassLimit;
        let mut last = None;
        for _ in 0..MAX_OUTER_STEPS {
            if self.last_decrement.take().is_some_and(|decrement| self.is_out_of_reach(decrement)) {
                self.given_up = true;
                break;
            }
            let joint = JointInformation::new(self.objective, &self.iterate, &self.active(), fine || self.is_central);
            let step = joint.step(&self.iterate.gradient, self.inner_gradient(), 0.0);
            let turn = self.next_step(&joint, &step, fine);
            last = Some((joint, step.decrement.max(self.ridges.below)));
            match turn {
                NextStep::On { two_sided } => fine = two_sided,
                NextStep::End(how) => {
                    stop = how;
                    break;
                }
            }
        }
        let unseen = || {
            (JointInformation::new(self.objective, &self.iterate, &vec![false; self.standing.len()], false), f64::NAN)
        };
        let last = last.unwrap_or_else(unseen);
        Ok(self.ended(last, stop))
    }

    /// The end of the search with the joint information and the certificate there; certified only if (μ, Σ) are
    /// certified, too.
    pub(super) fn ended(mut self, (joint, certificate): (JointInformation, f64), mut stop: Stop) -> SearchEnd {
        self.mark_idle(&joint);
        if stop == Stop::Certified && self.is_on_a_slope(&joint) {
            stop = Stop::Stalled;
        }
        if self.iterate.estimate.stop != Stop::Certified && stop != Stop::Interrupted {
            stop = self.iterate.estimate.stop;
        }
        let SearchState { iterate, origin, returned, standing, trace, before_zero, level_scale, given_up, .. } = self;
        SearchEnd {
            iterate,
            origin,
            returned,
            standing,
            joint,
            certificate,
            stop,
            trace,
            before_zero,
            level_scale,
            given_up,
        }
    }

    /// Whether ℓ is linear in some logarithm: without curvature Newton's method makes no step, yet there is no maximum.
    fn is_on_a_slope(&self, joint: &JointInformation) -> bool {
        let is_linear = |s: usize| {
            let moves =
                self.objective.coordinates[s].log && self.standing[s] == Standing::Inside && self.held != Some(s);
            moves && self.iterate.gradient[s].abs() > MIN_SLOPE && joint.curvature(s).abs() < FLAT_LOGARITHM
        };
        (0..self.standing.len()).any(is_linear)
    }

    /// Makes the next move, given the information and Newton's step; `fine`: both come from two-sided differences.
    fn next_step(&mut self, joint: &JointInformation, step: &joint::JointStep, fine: bool) -> NextStep {
        if self.progress.stops() {
            return NextStep::End(Stop::Interrupted);
        }
        let zero_unidentified_levels = step.decrement < SMALL_DECREMENT && self.zero_unidentified_levels(joint);
        if (step.decrement < MERGE_DECREMENT && self.merge_pair())
            || zero_unidentified_levels
            || self.try_lower_bounds(joint)
            || self.marked_unbounded(joint, step)
        {
            self.update_standing();
            return NextStep::On { two_sided: false };
        }
        if fine && step.decrement < SMALL_DECREMENT && self.move_along_ridges(joint) {
            self.update_standing();
            self.report_step(Some(step.decrement));
            return NextStep::On { two_sided: true };
        }
        let is_stationary = step.decrement.max(self.ridges.below) <= self.tolerance();
        if is_stationary && !step.concave && (self.certify_population() || self.leave_saddle(joint)) {
            return NextStep::On { two_sided: false };
        }
        if self.cannot_reach_best(step.decrement) {
            self.given_up = !self.reactivate_levels(joint);
            return if self.given_up { NextStep::End(Stop::PassLimit) } else { NextStep::On { two_sided: false } };
        }
        if is_stationary && step.concave {
            return match fine {
                false => NextStep::On { two_sided: true },
                true if self.certify_population() => NextStep::On { two_sided: true },
                true if self.lower_vanishing_levels()
                    || self.reactivate_levels(joint)
                    || self.probe_flat_directions(joint)
                    || self.leave_product_zero(joint) =>
                {
                    NextStep::On { two_sided: false }
                }
                true => NextStep::End(Stop::Certified),
            };
        }
        if self.advance(joint, step.decrement, fine) {
            self.update_standing();
            self.report_step(Some(step.decrement));
            let arrived = self.last_decrement.is_some_and(|decrement| decrement <= self.tolerance());
            return NextStep::On { two_sided: fine || arrived };
        }
        if !fine {
            self.flat_steps = 0;
            return NextStep::On { two_sided: true };
        }
        let is_on_ridge = self.ridges.below <= RIDGE_TOLERANCE;
        let enough = step.decrement <= NEAR_ENOUGH * self.tolerance() && is_on_ridge && step.concave;
        NextStep::End(if enough { Stop::Certified } else { Stop::Stalled })
    }

    /// Merges two coinciding processes into one and sets the other to zero: ℓ depends on the sum of the two variances
    /// alone.
    pub(super) fn merge_pair(&mut self) -> bool {
        let objective = self.objective;
        let free =
            |twins: &&ExchangeablePair| twins.pairs.iter().all(|&(s, t)| self.held != Some(s) && self.held != Some(t));
        let merged = objective
            .twins
            .iter()
            .filter(free)
            .filter_map(|twins| twins.merged(&self.iterate.values, &objective.coordinates));
        let least = self.iterate.value() - 0.5 * MIN_RISE; // a smaller loss than the rise at which a level returns
        let next = merged.filter_map(|values| self.at(&values)).find(|next| next.value() >= least);
        next.map(|next| self.move_to(next)).is_some()
    }

    /// Leaves a stationary point that is no maximum, along the direction in which ℓ curves upward most.
    pub(super) fn leave_saddle(&mut self, joint: &JointInformation) -> bool {
        let Some(direction) = joint.upward() else { return false };
        for length in [0.5, -0.5, 0.1, -0.1, 0.02, -0.02] {
            let values = self.objective.moved(&self.iterate.values, &direction, length);
            if let Some(next) = self.at(&values).filter(|next| next.value() > self.iterate.value() + 1e-9) {
                self.iterate = next;
                return true;
            }
        }
        false
    }

    /// Leaves a point where several factors of a product are zero and ℓ depends on the product alone: along a single
    /// factor, ℓ has neither slope nor curvature there.
    fn leave_product_zero(&mut self, joint: &JointInformation) -> bool {
        let is_factor = |&s: &usize| {
            let is_bare = self.iterate.values[s] == 0.0 && self.iterate.gradient[s] == 0.0 && joint.curvature(s) == 0.0;
            is_bare && !self.objective.coordinates[s].log && self.standing[s] == Standing::Inside
        };
        let factors: Vec<usize> = joint.active.iter().copied().filter(is_factor).collect();
        let &[first, _, ..] = &factors[..] else { return false };
        for length in PRODUCT_STEPS {
            for sign in [1.0, -1.0] {
                let mut direction = vec![0.0; self.iterate.values.len()];
                factors.iter().for_each(|&s| direction[s] = 1.0);
                direction[first] = sign;
                let values = self.objective.moved(&self.iterate.values, &direction, length);
                if let Some(next) = self.at(&values).filter(|next| next.value() > self.iterate.value() + MIN_RISE) {
                    self.move_to(next);
                    return true;
                }
            }
        }
        false
    }

    /// Solves for (μ, Σ) at fixed α where steps moved (μ, Σ) together with α; this also leaves a boundary of the cone
    /// that is no maximum. Returns whether (μ, Σ) became certified.
    fn certify_population(&mut self) -> bool {
        if self.objective.settings.method != Method::Innovations || self.iterate.estimate.stop == Stop::Certified {
            return false;
        }
        let Ok(next) = self.objective.settle(&self.iterate) else { return false };
        let certified = next.estimate.stop == Stop::Certified;
        self.iterate = next;
        certified
    }

    /// Moves towards the top of a ridge, where differences do not resolve the curvature along the ridge.
    fn move_along_ridges(&mut self, joint: &JointInformation) -> bool {
        self.ridges.below = 0.0;
        let is_ridge = |direction: &InformationDirection| direction.is_of_alpha() && direction.may_be_rounding();
        for direction in joint.directions().into_iter().filter(is_ridge) {
            if self.ridges.failures >= MAX_RIDGE_FAILURES {
                break;
            }
            let near = Population::from(&self.iterate.estimate);
            let start = RidgeStart { values: &self.iterate.values, near: &near, value: self.iterate.value(), joint };
            let Some(ridge) = Ridge::new(self.objective, start, &direction) else {
                self.ridges.failures += 1;
                continue;
            };
            if ridge.score() <= self.tolerance() {
                continue;
            }
            let values = self.objective.moved(&self.iterate.values, &direction.alpha, ridge.step());
            let is_nearer =
                |next: &ProfilePoint| ridge::dot(&next.gradient, &direction.alpha).abs() < 0.5 * ridge.slope.abs();
            let least = self.iterate.value() - self.slack();
            let can_move = self.ridges.moves < MAX_RIDGE_MOVES;
            let next = can_move.then(|| self.at(&values)).flatten();
            if let Some(next) = next.filter(|next| is_nearer(next) && next.value() >= least) {
                self.ridges.moves += 1;
                self.move_to(next);
                return true;
            }
            self.ridges.below = self.ridges.below.max(ridge.score());
        }
        false
    }

    /// Leaves a certified point along directions in which ℓ hardly curves, if ℓ rises further out.
    fn probe_flat_directions(&mut self, joint: &JointInformation) -> bool {
        if self.flat_probes >= MAX_FLAT_PROBES {
            return false;
        }
        self.flat_probes += 1;
        for direction in joint.faint() {
            for length in PROBE_LENGTHS {
                let values = self.objective.moved(&self.iterate.values, &direction.alpha, length);
                if let Some(next) = self.at(&values).filter(|next| next.value() > self.iterate.value() + MIN_RISE) {
                    self.move_to(next);
                    return true;
                }
            }
        }
        false
    }

    /// Makes one step, damped until ℓ rises; `fine`: derivatives at the new point will come from two-sided differences.
    fn advance(&mut self, joint: &JointInformation, decrement: f64, fine: bool) -> bool {
        let levels = match self.level_scale {
            LevelScale::Logarithm => self.levels_near_zero(joint),
            LevelScale::Variance => self.all_levels(joint),
        };
        let bent = joint.in_variances(&levels, &self.iterate.gradient);
        while self.damping < MAX_DAMPING {
            let step = self.damped_step(&bent, &levels);
            let values = self.moved(&step.alpha, &levels);
            let next = match self.objective.settings.method {
                Method::Innovations => self.step_and_prefetch(&values, &step, fine),
                Method::Hybrid | Method::Em => self.at(&values),
            };
            let lower_limit = self.lower_limit.clone();
            let Some(next) = next.or_else(|| self.try_above_zero(&values)) else {
                self.damping = (1.6 * self.damping).max(0.02); // increased less than after a rejected step
                continue;
            };
            if self.accept(next, (joint, &levels), (&step, decrement)) {
                return true;
            }
            self.lower_limit = lower_limit; // a rejected step does not show how low levels may go
            self.damping = (5.0 * self.damping).max(0.05);
        }
        self.damping = 0.0;
        false
    }

    /// Accepts a step if ℓ rose by enough of the predicted gain, and continues from there by steps without second
    /// derivatives.
    fn accept(
        &mut self,
        next: ProfilePoint,
        (joint, levels): (&JointInformation, &[(usize, f64)]),
        (step, decrement): (&joint::JointStep, f64),
    ) -> bool {
        let slack = self.slack();
        let (promised, gain) = (0.5 * step.decrement.powi(2), next.value() - self.iterate.value());
        self.flat_steps = if gain > slack { 0 } else { self.flat_steps + 1 };
        let is_level = promised <= slack && gain >= -slack && decrement < 1e-3 && self.flat_steps < MAX_FLAT_STEPS;
        if gain < 0.05 * promised && !is_level {
            return false;
        }
        self.damping *= if gain > 0.5 * promised { 0.1 } else { 1.0 };
        self.damping = if self.damping < 1e-4 { 0.0 } else { self.damping };
        self.level_scale = self.better_level_scale(joint, &next);
        let before = self.iterate.clone();
        self.move_to(next);
        let is_short = promised > slack && gain > SHORT_STEP_GAIN * promised;
        self.short_steps = if is_short { self.short_steps + 1 } else { 0 };
        self.is_central |= self.short_steps >= MAX_SHORT_STEPS;
        let goes_on = if levels.is_empty() {
            !self.extrapolate(step, is_short)
        } else {
            self.level_scale == LevelScale::Variance
        };
        if goes_on {
            match gain > 0.2 * promised {
                true => self.updated_hessian_steps(joint, &before),
                // the change of the gradient over so short a step is rounding
                false if is_level => self.fixed_hessian_steps(joint),
                false => {}
            }
        }
        true
    }

    /// The step, damped until no shared value goes too far; values of single tests are clamped one by one, and so are
    /// shared values that no damping keeps near, since ℓ hardly curves along them. `levels`
    /// move in variances, down to zero at most.
    fn damped_step(&mut self, joint: &JointInformation, levels: &[(usize, f64)]) -> joint::JointStep {
        let reach = |s: usize| match levels.iter().find(|(level, _)| *level == s) {
            Some((_, exponent)) => Some((-exponent.recip(), MAX_VARIANCE_GROWTH / exponent)),
            None => self.objective.coordinates[s].log.then_some((-LONGEST, LONGEST)),
        };
        loop {
            let mut step = self.bounded_step(joint, levels);
            let far = |&&s: &&usize| reach(s).is_some_and(|(low, high)| !(low..=high).contains(&step.alpha[s]));
            if joint.shared().iter().find(far).is_none() || self.damping > MAX_DAMPING {
                for (s, d) in step.alpha.iter_mut().enumerate() {
                    if let Some((low, high)) = reach(s) {
                        *d = d.clamp(low, high);
                    }
                }
                return step.with_decrement(&self.iterate.gradient, self.inner_gradient());
            }
            self.damping = (3.0 * self.damping).max(0.01);
        }
    }

    /// The step with levels that would become negative stopped at zero, and the other values solved for given these
    /// stops.
    fn bounded_step(&self, joint: &JointInformation, levels: &[(usize, f64)]) -> joint::JointStep {
        let mut pinned: Vec<(usize, f64)> = Vec::new();
        loop {
            let step = joint.step_with_pinned(&self.iterate.gradient, self.inner_gradient(), self.damping, &pinned);
            let with_best_known = |&(s, exponent): &(usize, f64)| {
                let known = pinned.iter().any(|(slot, _)| *slot == s);
                (!known && step.alpha[s] < -exponent.recip()).then_some((s, -exponent.recip()))
            };
            let further: Vec<(usize, f64)> =
                levels.iter().filter(|(s, _)| joint.shared().contains(s)).filter_map(with_best_known).collect();
            if further.is_empty() {
                return step;
            }
            pinned.extend(further);
        }
    }

    /// The values after a step; `levels` move in variances.
    fn moved(&self, step: &[f64], levels: &[(usize, f64)]) -> Vec<f64> {
        let one = |(s, d): (usize, &f64)| {
            let (coordinate, value) = (&self.objective.coordinates[s], self.iterate.values[s]);
            match levels.iter().any(|(level, _)| *level == s) {
                true => coordinate.moved_as_variance(value, *d).max(self.lower_limit[s]),
                false => coordinate.moved(value, *d),
            }
        };
        step.iter().enumerate().map(one).collect()
    }

    /// Repeats a step, twice as long each time, while ℓ rises: along a level ridge, or one that curves less than
    /// differences indicate. Returns whether a repetition raised ℓ.
    fn extrapolate(&mut self, step: &joint::JointStep, is_short: bool) -> bool {
        let far = step.alpha.iter().zip(&self.objective.coordinates).any(|(d, c)| c.log && d.abs() > FAR_STEP);
        if !(is_short || far) || step.decrement > 0.3 {
            return false;
        }
        let mut length = 1.0;
        for tried in 0..4 {
            length *= 2.0;
            let values = self.objective.moved(&self.iterate.values, &step.alpha, length);
            let Some(next) = self.at(&values).filter(|next| next.value() > self.iterate.value()) else {
                return tried > 0;
            };
            self.move_to(next);
        }
        true
    }
}

/// Searches from a start by the method of the settings; gives up where ℓ cannot reach `best_known`.
pub(crate) fn search(
    objective: &ProfileLikelihood<'_>,
    start: SearchStart,
    best_known: Option<f64>,
    progress: &mut dyn Progress,
) -> Result<SearchEnd, DynamicError> {
    let iterate = objective.solve(&start.values, None)?;
    let mut search =
        SearchState::new(objective, progress, iterate).with_best_known(best_known).with_origin(start.origin);
    search.start_from_curvature(start.curvature);
    match objective.settings.method {
        Method::Hybrid | Method::Innovations => search.run(),
        Method::Em => Em::new(search)?.run(),
    }
}
