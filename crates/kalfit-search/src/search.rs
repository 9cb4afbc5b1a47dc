//! The outer search (the paper's Figure 1): μ and Σ are solved for each α, and Newton's method moves α.

use crate::em::Em;
use crate::joint;
use crate::joint::{InformationDirection, JointInformation, LEVEL_GROUND};
use crate::profile_likelihood::{ProfileLikelihood, ProfilePoint};
use crate::quadratic::LevelScale;
use crate::ridge;
use crate::ridge::{Ridge, RidgeStart};
use crate::search_state::{DRIFT, LONGEST, NEAR_ENOUGH, RISE, SearchEnd, SearchStart, SearchState};
use crate::twins::ExchangeablePair;
use crate::{DynamicError, Method, Standing};
use kalfit_estimate::{Progress, Stop};
use kalfit_model::Population;

/// Largest relative growth of a variance v in one step: to (1 + this) v.
const HIGHEST: f64 = 20.0;
/// Damping from which on no shorter step is tried.
const STIFF: f64 = 1e6;
/// Maximal number of outer steps, those of α, in one search.
const STEPS: usize = 200;
/// Maximal number of consecutive steps that may leave ℓ unchanged within rounding.
const LEVEL_STEPS: usize = 8;
/// Decrement, in standard errors, below which the search looks for levels without effect on ℓ and for ridges.
pub(super) const HARDLY: f64 = 1e-3;
/// Decrement, in standard errors, below which coinciding processes are merged.
const NEAR: f64 = 1.0;
/// Lengths, in coordinates, of trial steps along directions in which ℓ hardly curves.
const LOOKS: [f64; 6] = [0.3, -0.3, 1.5, -1.5, 4.0, -4.0];
/// Maximal number of times that a search tries such steps.
const FAINT_LOOKS: usize = 3;
/// Distance from the top of a ridge, in standard errors, that is near enough where rounding prevents coming nearer.
const RIDGE_ENOUGH: f64 = 1e-3;
/// Number of failed attempts to find a ridge after which a search looks for no more ridges.
const RIDGES_MISSED: usize = 2;
/// Maximal number of moves along ridges in one search.
const RIDGE_MOVES: usize = 4;
/// Lengths of trial steps off a point where several factors of a product are zero.
const FACTORS: [f64; 5] = [1.0, 0.1, 0.01, 10.0, 100.0];

/// Ratio of the rise of ℓ to the predicted rise above which a step was too short.
const SHORT: f64 = 1.5;
/// Number of consecutive short steps after which differences are two-sided: one-sided differences change with the step
/// where a ridge is narrow.
const SHORT_STEPS: usize = 3;
/// Slope above which a point is no maximum although the curvature is below [`LEVEL_GROUND`].
const SLOPE: f64 = 1e-3;

/// What a search does next.
enum NextStep {
    /// Continue; `closer`: with two-sided differences.
    On { closer: bool },
    /// End, for this reason.
    End(Stop),
}

impl<'b, 'a> SearchState<'b, 'a> {
    /// Runs the search to an optimum that two-sided differences certify.
    pub fn run(mut self) -> Result<SearchEnd, DynamicError> {
        let mut fine = self.glided.is_some_and(|decrement| decrement <= self.tolerance()); // differences to both sides
        let mut stop = Stop::PassLimit;
        let mut last = None;
        for _ in 0..STEPS {
            if self.glided.take().is_some_and(|decrement| self.is_lost(decrement)) {
                self.given_up = true;
                break;
            }
            let joint = JointInformation::new(self.objective, &self.home, &self.active(), fine || self.is_central);
            let step = joint.step(&self.home.gradient, self.inner_gradient(), 0.0);
            let turn = self.next_step(&joint, &step, fine);
            last = Some((joint, step.decrement.max(self.ridges.below)));
            match turn {
                NextStep::On { closer } => fine = closer,
                NextStep::End(how) => {
                    stop = how;
                    break;
                }
            }
        }
        let unseen =
            || (JointInformation::new(self.objective, &self.home, &vec![false; self.standing.len()], false), f64::NAN);
        let last = last.unwrap_or_else(unseen);
        Ok(self.ended(last, stop))
    }

    /// The end of the search with the joint information and the certificate there. It counts as certified only if (μ,
    /// Σ) are certified, too.
    pub(super) fn ended(mut self, (joint, certificate): (JointInformation, f64), mut stop: Stop) -> SearchEnd {
        self.name_idle(&joint);
        if stop == Stop::Certified && self.is_on_a_slope(&joint) {
            stop = Stop::Stalled;
        }
        if self.home.estimate.stop != Stop::Certified && stop != Stop::Interrupted {
            stop = self.home.estimate.stop;
        }
        let SearchState { home, standing, trace, before_zero, level_scale, given_up, .. } = self;
        SearchEnd { home, standing, joint, certificate, stop, trace, before_zero, level_scale, given_up }
    }

    /// Whether ℓ is linear in some logarithm: without curvature Newton's method makes no step, yet there is no maximum.
    fn is_on_a_slope(&self, joint: &JointInformation) -> bool {
        let straight = |s: usize| {
            let moves =
                self.objective.coordinates[s].log && self.standing[s] == Standing::Inside && self.held != Some(s);
            moves && self.home.gradient[s].abs() > SLOPE && joint.curvature(s).abs() < LEVEL_GROUND
        };
        (0..self.standing.len()).any(straight)
    }

    /// Makes the next move, given the information and Newton's step; `fine`: both come from two-sided differences.
    fn next_step(&mut self, joint: &JointInformation, step: &joint::JointStep, fine: bool) -> NextStep {
        if self.progress.stops() {
            return NextStep::End(Stop::Interrupted);
        }
        let sunk = step.decrement < HARDLY && self.sunk(joint);
        if (step.decrement < NEAR && self.joined()) || sunk || self.leap(joint) || self.drifted(joint, step) {
            self.place();
            return NextStep::On { closer: false };
        }
        if fine && step.decrement < HARDLY && self.along_ridges(joint) {
            self.place();
            self.tell(Some(step.decrement));
            return NextStep::On { closer: true };
        }
        let still = step.decrement.max(self.ridges.below) <= self.tolerance();
        if still && !step.concave && (self.settled() || self.off_saddle(joint)) {
            return NextStep::On { closer: false };
        }
        if self.hopeless(step.decrement) {
            self.given_up = !self.revived(joint);
            return if self.given_up { NextStep::End(Stop::PassLimit) } else { NextStep::On { closer: false } };
        }
        if still && step.concave {
            return match fine {
                false => NextStep::On { closer: true },
                true if self.settled() => NextStep::On { closer: true },
                true if self.nearer_zero() || self.revived(joint) || self.beside(joint) || self.off_product(joint) => {
                    NextStep::On { closer: false }
                }
                true => NextStep::End(Stop::Certified),
            };
        }
        if self.advance(joint, step.decrement, fine) {
            self.place();
            self.tell(Some(step.decrement));
            let arrived = self.glided.is_some_and(|decrement| decrement <= self.tolerance());
            return NextStep::On { closer: fine || arrived };
        }
        if !fine {
            self.level_steps = 0;
            return NextStep::On { closer: true };
        }
        let is_on_ridge = self.ridges.below <= RIDGE_ENOUGH;
        let enough = step.decrement <= NEAR_ENOUGH * self.tolerance() && is_on_ridge && step.concave;
        NextStep::End(if enough { Stop::Certified } else { Stop::Stalled })
    }

    /// Merges two coinciding processes into one and sets the other to zero: ℓ does not depend on how they share their
    /// variance.
    pub(super) fn joined(&mut self) -> bool {
        let objective = self.objective;
        let free =
            |twins: &&ExchangeablePair| twins.pairs.iter().all(|&(s, t)| self.held != Some(s) && self.held != Some(t));
        let merged = objective
            .twins
            .iter()
            .filter(free)
            .filter_map(|twins| twins.merged(&self.home.values, &objective.coordinates));
        let least = self.home.value() - 0.5 * RISE; // a smaller loss than the rise at which a level returns
        let next = merged.filter_map(|values| self.at(&values)).find(|next| next.value() >= least);
        next.map(|next| self.arrive(next)).is_some()
    }

    /// Leaves a stationary point that is no maximum, along the direction in which ℓ curves upward most.
    pub(super) fn off_saddle(&mut self, joint: &JointInformation) -> bool {
        let Some(direction) = joint.upward() else { return false };
        for length in [0.5, -0.5, 0.1, -0.1, 0.02, -0.02] {
            let values = self.objective.moved(&self.home.values, &direction, length);
            if let Some(next) = self.at(&values).filter(|next| next.value() > self.home.value() + 1e-9) {
                self.home = next;
                return true;
            }
        }
        false
    }

    /// Leaves a point where values are zero that ℓ depends on only through their product: along any single one of them,
    /// ℓ has neither slope nor curvature there.
    fn off_product(&mut self, joint: &JointInformation) -> bool {
        let is_factor = |&s: &usize| {
            let is_bare = self.home.values[s] == 0.0 && self.home.gradient[s] == 0.0 && joint.curvature(s) == 0.0;
            is_bare && !self.objective.coordinates[s].log && self.standing[s] == Standing::Inside
        };
        let factors: Vec<usize> = joint.active.iter().copied().filter(is_factor).collect();
        let &[first, _, ..] = &factors[..] else { return false };
        for length in FACTORS {
            for sign in [1.0, -1.0] {
                let mut direction = vec![0.0; self.home.values.len()];
                factors.iter().for_each(|&s| direction[s] = 1.0);
                direction[first] = sign;
                let values = self.objective.moved(&self.home.values, &direction, length);
                if let Some(next) = self.at(&values).filter(|next| next.value() > self.home.value() + RISE) {
                    self.arrive(next);
                    return true;
                }
            }
        }
        false
    }

    /// Solves for (μ, Σ) alone where they moved along with α. This certifies them, and leaves the boundary of the cone
    /// where that is no maximum; returns whether they are certified by this.
    fn settled(&mut self) -> bool {
        if self.objective.settings.method != Method::Innovations || self.home.estimate.stop == Stop::Certified {
            return false;
        }
        let Ok(next) = self.objective.settle(&self.home) else { return false };
        let certified = next.estimate.stop == Stop::Certified;
        self.home = next;
        certified
    }

    /// Moves towards the top of a ridge, where differences do not resolve the curvature along it.
    fn along_ridges(&mut self, joint: &JointInformation) -> bool {
        self.ridges.below = 0.0;
        let is_ridge = |direction: &InformationDirection| direction.is_of_alpha() && direction.is_shaky();
        for direction in joint.directions().into_iter().filter(is_ridge) {
            if self.ridges.missed >= RIDGES_MISSED {
                break;
            }
            let near = Population::from(&self.home.estimate);
            let start = RidgeStart { values: &self.home.values, near: &near, value: self.home.value(), joint };
            let Some(ridge) = Ridge::new(self.objective, start, &direction) else {
                self.ridges.missed += 1;
                continue;
            };
            if ridge.score() <= self.tolerance() {
                continue;
            }
            let values = self.objective.moved(&self.home.values, &direction.alpha, ridge.step());
            let is_nearer =
                |next: &ProfilePoint| ridge::dot(&next.gradient, &direction.alpha).abs() < 0.5 * ridge.slope.abs();
            let least = self.home.value() - self.slack();
            let can_move = self.ridges.moves < RIDGE_MOVES;
            let next = can_move.then(|| self.at(&values)).flatten();
            if let Some(next) = next.filter(|next| is_nearer(next) && next.value() >= least) {
                self.ridges.moves += 1;
                self.arrive(next);
                return true;
            }
            self.ridges.below = self.ridges.below.max(ridge.score());
        }
        false
    }

    /// Leaves a certified point along directions in which ℓ hardly curves, if ℓ rises further out.
    fn beside(&mut self, joint: &JointInformation) -> bool {
        if self.faint_looks >= FAINT_LOOKS {
            return false;
        }
        self.faint_looks += 1;
        for direction in joint.faint() {
            for length in LOOKS {
                let values = self.objective.moved(&self.home.values, &direction.alpha, length);
                if let Some(next) = self.at(&values).filter(|next| next.value() > self.home.value() + RISE) {
                    self.arrive(next);
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
        let bent = joint.in_variances(&levels, &self.home.gradient);
        while self.damping < STIFF {
            let step = self.within_reach(&bent, &levels);
            let values = self.moved(&step.alpha, &levels);
            let next = match self.objective.settings.method {
                Method::Innovations => self.stepped(&values, &step, fine),
                Method::Hybrid | Method::Em => self.at(&values),
            };
            let bottom = self.bottom.clone();
            let Some(next) = next.or_else(|| self.above_zero(&values)) else {
                self.damping = (1.6 * self.damping).max(0.02); // increased less than after a rejected step
                continue;
            };
            if self.accept(next, (joint, &levels), (&step, decrement)) {
                return true;
            }
            self.bottom = bottom; // a rejected step does not show how low levels may go
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
        let (promised, gain) = (0.5 * step.decrement.powi(2), next.value() - self.home.value());
        self.level_steps = if gain > slack { 0 } else { self.level_steps + 1 };
        let is_level = promised <= slack && gain >= -slack && decrement < 1e-3 && self.level_steps < LEVEL_STEPS;
        if gain < 0.05 * promised && !is_level {
            return false;
        }
        self.damping *= if gain > 0.5 * promised { 0.1 } else { 1.0 };
        self.damping = if self.damping < 1e-4 { 0.0 } else { self.damping };
        self.level_scale = self.straighter(joint, &next);
        let before = self.home.clone();
        self.arrive(next);
        let is_short = promised > slack && gain > SHORT * promised;
        self.short_steps = if is_short { self.short_steps + 1 } else { 0 };
        self.is_central |= self.short_steps >= SHORT_STEPS;
        let goes_on =
            if levels.is_empty() { !self.stride(step, is_short) } else { self.level_scale == LevelScale::Variance };
        if goes_on {
            match gain > 0.2 * promised {
                true => self.glide(joint, &before),
                // the change of the gradient over so short a step is rounding
                false if is_level => self.glide_by(joint),
                false => {}
            }
        }
        true
    }

    /// The step, damped so much that no shared value goes too far; values of single tests are clamped one by one.
    /// `levels` move in their variances, to zero at most.
    fn within_reach(&mut self, joint: &JointInformation, levels: &[(usize, f64)]) -> joint::JointStep {
        let reach = |s: usize| match levels.iter().find(|(level, _)| *level == s) {
            Some((_, exponent)) => Some((-exponent.recip(), HIGHEST / exponent)),
            None => self.objective.coordinates[s].log.then_some((-LONGEST, LONGEST)),
        };
        loop {
            let mut step = self.to_zero_at_most(joint, levels);
            let far = |&&s: &&usize| reach(s).is_some_and(|(low, high)| !(low..=high).contains(&step.alpha[s]));
            if joint.shared().iter().find(far).is_none() || self.damping > STIFF {
                for (s, d) in step.alpha.iter_mut().enumerate() {
                    if let Some((low, high)) = reach(s) {
                        *d = d.clamp(low, high);
                    }
                }
                return step;
            }
            self.damping = (3.0 * self.damping).max(0.01);
        }
    }

    /// The step with levels stopped at zero that would go below, and the other values solved for given that.
    fn to_zero_at_most(&self, joint: &JointInformation, levels: &[(usize, f64)]) -> joint::JointStep {
        let mut pinned: Vec<(usize, f64)> = Vec::new();
        loop {
            let step = joint.step_beside(&self.home.gradient, self.inner_gradient(), self.damping, &pinned);
            let beyond = |&(s, exponent): &(usize, f64)| {
                let known = pinned.iter().any(|(slot, _)| *slot == s);
                (!known && step.alpha[s] < -exponent.recip()).then_some((s, -exponent.recip()))
            };
            let further: Vec<(usize, f64)> =
                levels.iter().filter(|(s, _)| joint.shared().contains(s)).filter_map(beyond).collect();
            if further.is_empty() {
                return step;
            }
            pinned.extend(further);
        }
    }

    /// The values after a step; `levels` move in their variances.
    fn moved(&self, step: &[f64], levels: &[(usize, f64)]) -> Vec<f64> {
        let one = |(s, d): (usize, &f64)| {
            let (coordinate, value) = (&self.objective.coordinates[s], self.home.values[s]);
            match levels.iter().any(|(level, _)| *level == s) {
                true => coordinate.moved_as_variance(value, *d).max(self.bottom[s]),
                false => coordinate.moved(value, *d),
            }
        };
        step.iter().enumerate().map(one).collect()
    }

    /// Repeats a step, twice as long each time, while ℓ rises: along a level ridge, or one that curves less than
    /// differences indicate. Returns whether a repetition raised ℓ.
    fn stride(&mut self, step: &joint::JointStep, is_short: bool) -> bool {
        let far = step.alpha.iter().zip(&self.objective.coordinates).any(|(d, c)| c.log && d.abs() > DRIFT);
        if !(is_short || far) || step.decrement > 0.3 {
            return false;
        }
        let mut length = 1.0;
        for tried in 0..4 {
            length *= 2.0;
            let values = self.objective.moved(&self.home.values, &step.alpha, length);
            let Some(next) = self.at(&values).filter(|next| next.value() > self.home.value()) else { return tried > 0 };
            self.arrive(next);
        }
        true
    }
}

/// Searches from a start by the method of the settings; gives up where ℓ cannot reach `floor`.
pub(crate) fn search(
    objective: &ProfileLikelihood<'_>,
    start: SearchStart,
    floor: Option<f64>,
    progress: &mut dyn Progress,
) -> Result<SearchEnd, DynamicError> {
    let home = objective.solve(&start.values, None)?;
    let mut search = SearchState::new(objective, progress, home).beyond(floor);
    search.begin_with(start.curvature);
    match objective.settings.method {
        Method::Hybrid | Method::Innovations => search.run(),
        Method::Em => Em::new(search)?.run(),
    }
}
