//! The outer search (the paper's Figure 1): μ and Σ are solved for each α, and Newton's method moves α.

use nalgebra::DVector;

use crate::dynamic::bench::{Bench, Solved};
use crate::dynamic::em::Em;
use crate::dynamic::joint::{self, Joint};
use crate::dynamic::start::Start;
use crate::dynamic::{DynamicError, Method, Standing};
use crate::estimate::{Progress, Stage, Step, Stop};
use crate::model::Population;

/// Longest step of a logarithm.
pub(super) const LONGEST: f64 = 2.0;
/// A variance grows by no more than this factor at once.
const HIGHEST: f64 = 20.0;
/// With more damping than this a step goes nowhere.
const STIFF: f64 = 1e6;
/// Where rounding keeps the search from going on, so many tolerances are near enough.
pub(super) const NEAR_ENOUGH: f64 = 1e2;
/// Most outer steps.
const STEPS: usize = 200;
/// A step of a logarithm beyond this goes far.
pub(super) const DRIFT: f64 = 0.25;
/// So many steps on end need not raise ℓ, where rounding hides what they do.
const LEVEL_STEPS: usize = 8;
/// With a decrement below this, levels that are not felt are looked for.
const HARDLY: f64 = 1e-3;
/// A search that promises no more than this, as a decrement, has arrived.
const ARRIVED: f64 = 1e-5;
/// A level below this part of what the data suggest has no size of its own.
const FAR_BELOW: f64 = 1e-3;
/// A value that returns from zero does so at this part of what it was.
const RETURN: f64 = 5e-2;
/// ℓ rises when it rises by more than this.
pub(super) const RISE: f64 = 1e-8;
/// Steps along faint directions, in coordinates, and how often they are looked along.
const LOOKS: [f64; 6] = [0.3, -0.3, 1.5, -1.5, 4.0, -4.0];
const FAINT_LOOKS: usize = 3;

/// Where a search is.
pub(crate) struct Search<'b, 'a> {
    pub(super) bench: &'b Bench<'a>,
    progress: &'b mut dyn Progress,
    pub(crate) home: Solved,
    pub(crate) standing: Vec<Standing>,
    pub(crate) trace: Vec<f64>,
    /// The value of each coordinate before it was set to zero.
    pub(super) before_zero: Vec<f64>,
    /// The least value of each level: its bound, or a little more where ℓ is not defined there.
    pub(super) bottom: Vec<f64>,
    damping: f64,
    floor: Option<f64>,
    pub(super) held: Option<usize>,
    /// Values left on their way to zero or to infinity.
    pub(super) drifted: Vec<bool>,
    faint_looks: usize,
    /// What the last step without second derivatives promised, as a decrement.
    pub(super) glided: Option<f64>,
    given_up: bool,
    /// Steps one after the other that did not raise ℓ.
    level_steps: usize,
}

/// How a search goes on.
enum Turn {
    /// With differences to both sides, or to one.
    On { closer: bool },
    /// Not at all.
    End(Stop),
}

/// Where it ended.
pub(crate) struct End {
    pub(crate) home: Solved,
    pub(crate) standing: Vec<Standing>,
    pub(crate) joint: Joint,
    pub(crate) certificate: f64,
    pub(crate) stop: Stop,
    pub(crate) trace: Vec<f64>,
    pub(super) before_zero: Vec<f64>,
    /// Nothing higher than another end was in sight.
    pub(crate) given_up: bool,
}

impl End {
    /// A level at zero, or as near to it as ℓ is defined.
    pub(crate) fn is_at_zero(&self, s: usize) -> bool {
        self.home.values[s] == 0.0 || self.standing[s] == Standing::Vanishing
    }

    /// The values as a start elsewhere: those at zero a little above it, where they can move.
    pub(crate) fn restart(&self) -> Vec<f64> {
        let zero = |(value, before): (&f64, &f64)| if *value == 0.0 { RETURN * before } else { *value };
        self.home.values.iter().zip(&self.before_zero).map(zero).collect()
    }
}

impl<'b, 'a> Search<'b, 'a> {
    pub(crate) fn new(bench: &'b Bench<'a>, progress: &'b mut dyn Progress, home: Solved) -> Search<'b, 'a> {
        let n = home.values.len();
        let trace = vec![home.value()];
        let unit = |(value, unit): (&f64, &f64)| if *value > FAR_BELOW * unit { *value } else { *unit };
        let before_zero = home.values.iter().zip(bench.units()).map(unit).collect();
        let bottom = bench.coordinates.iter().map(|coordinate| coordinate.lower).collect();
        let mut search = Search {
            bench,
            progress,
            home,
            standing: vec![Standing::Inside; n],
            trace,
            before_zero,
            bottom,
            damping: 0.0,
            floor: None,
            held: None,
            drifted: vec![false; n],
            faint_looks: 0,
            glided: None,
            given_up: false,
            level_steps: 0,
        };
        search.place();
        search
    }

    /// Values at bounds that want to go beyond are held there, others are let go.
    pub(super) fn place(&mut self) {
        for s in 0..self.standing.len() {
            let (coordinate, value, slope) = (self.bench.coordinates[s], self.home.values[s], self.home.gradient[s]);
            self.standing[s] = match self.standing[s] {
                kept if self.drifted[s] => kept,
                _ if coordinate.log && value == 0.0 => Standing::Lower,
                _ if self.is_vanishing(s) => Standing::Vanishing,
                _ if coordinate.at_lower(value) && slope <= 0.0 => Standing::Lower,
                _ if coordinate.at_upper(value) && slope >= 0.0 => Standing::Upper,
                _ => Standing::Inside,
            };
        }
    }

    /// Holds a value where it is.
    pub(crate) fn hold(&mut self, slot: usize) {
        self.held = Some(slot);
    }

    /// Gives up where no more than this ℓ is in sight.
    pub(crate) fn beyond(mut self, floor: Option<f64>) -> Self {
        self.floor = floor;
        self
    }

    /// ℓ of another end is out of reach.
    fn hopeless(&self, decrement: f64) -> bool {
        let room = if decrement > ARRIVED { (3.0 * decrement).min(1.0) } else { 0.0 };
        let promised = self.home.value() + 2.0 * decrement * decrement + room;
        self.trace.len() > 3 && self.floor.is_some_and(|floor| promised < floor)
    }

    /// The same without levels at zero, which could return.
    pub(super) fn is_lost(&self, decrement: f64) -> bool {
        self.hopeless(decrement) && self.zeros().is_empty()
    }

    pub(super) fn active(&self) -> Vec<bool> {
        let moves = |(s, standing): (usize, &Standing)| *standing == Standing::Inside && self.held != Some(s);
        self.standing.iter().enumerate().map(moves).collect()
    }

    pub(super) fn tolerance(&self) -> f64 {
        self.bench.settings.inner.tolerance.max(1e-7)
    }

    /// To the optimum, certified by differences to both sides.
    pub(crate) fn run(mut self) -> Result<End, DynamicError> {
        let mut fine = self.glided.is_some_and(|decrement| decrement <= self.tolerance()); // differences to both sides
        let mut stop = Stop::PassLimit;
        let mut last = None;
        for _ in 0..STEPS {
            if self.glided.take().is_some_and(|decrement| self.is_lost(decrement)) {
                self.given_up = true;
                break;
            }
            let joint = Joint::new(self.bench, &self.home, &self.active(), fine);
            let step = joint.step(&self.home.gradient, self.inner_gradient(), 0.0);
            let turn = self.turn(&joint, &step, fine);
            last = Some((joint, step.decrement));
            match turn {
                Turn::On { closer } => fine = closer,
                Turn::End(how) => {
                    stop = how;
                    break;
                }
            }
        }
        let unseen = || (Joint::new(self.bench, &self.home, &vec![false; self.standing.len()], false), f64::NAN);
        let (joint, certificate) = last.unwrap_or_else(unseen);
        self.name_idle(&joint);
        if self.home.estimate.stop != Stop::Certified && stop != Stop::Interrupted {
            stop = self.home.estimate.stop;
        }
        let Search { home, standing, trace, before_zero, given_up, .. } = self;
        Ok(End { home, standing, joint, certificate, stop, trace, before_zero, given_up })
    }

    /// What to do where this is known; `fine` when it is by differences to both sides.
    fn turn(&mut self, joint: &Joint, step: &joint::Step, fine: bool) -> Turn {
        if self.progress.stops() {
            return Turn::End(Stop::Interrupted);
        }
        let sunk = step.decrement < HARDLY && self.sunk(joint);
        if sunk || self.leap(joint) || self.drifted(joint, step) {
            self.place();
            return Turn::On { closer: false };
        }
        let still = step.decrement <= self.tolerance();
        if still && !step.concave && (self.settled() || self.off_saddle(joint)) {
            return Turn::On { closer: false };
        }
        if self.hopeless(step.decrement) {
            self.given_up = !self.revived(joint);
            return if self.given_up { Turn::End(Stop::PassLimit) } else { Turn::On { closer: false } };
        }
        if still && step.concave {
            return match fine {
                false => Turn::On { closer: true },
                true if self.settled() => Turn::On { closer: true },
                true if self.revived(joint) || self.beside(joint) => Turn::On { closer: false },
                true => Turn::End(Stop::Certified),
            };
        }
        if self.advance(joint, step.decrement) {
            self.place();
            self.tell(step.decrement);
            return Turn::On { closer: fine };
        }
        if !fine {
            return Turn::On { closer: true };
        }
        let enough = step.decrement <= NEAR_ENOUGH * self.tolerance() && step.concave;
        Turn::End(if enough { Stop::Certified } else { Stop::Stalled })
    }

    /// Somebody asks the search to end where it is.
    pub(super) fn stops(&self) -> bool {
        self.progress.stops()
    }

    /// Says how it goes.
    pub(super) fn say(&mut self, stage: Stage) {
        self.progress.stage(stage);
    }

    pub(super) fn tell(&mut self, decrement: f64) {
        self.trace.push(self.home.value());
        let passes = self.bench.filter_passes();
        self.progress.step(Step { passes, log_likelihood: self.home.value(), decrement: Some(decrement) });
    }

    /// Gradient along the coordinates of (μ, Σ): nothing where they have been solved for.
    fn inner_gradient(&self) -> &DVector<f64> {
        &self.home.estimate.state.place.tangent.gradient
    }

    /// Off a stationary point that is no maximum, along the direction in which ℓ curves upward most.
    pub(super) fn off_saddle(&mut self, joint: &Joint) -> bool {
        let Some(direction) = joint.upward() else { return false };
        for length in [0.5, -0.5, 0.1, -0.1, 0.02, -0.02] {
            let moved = |(s, d): (usize, &f64)| self.bench.coordinates[s].moved(self.home.values[s], length * d);
            let values: Vec<f64> = direction.iter().enumerate().map(moved).collect();
            if let Some(next) = self.at(&values).filter(|next| next.value() > self.home.value() + 1e-9) {
                self.home = next;
                return true;
            }
        }
        false
    }

    /// Where (μ, Σ) moved along with α, they are solved for by themselves, which certifies them and takes them off the boundary
    /// of the cone where that is no maximum; `false` when that had been done.
    fn settled(&mut self) -> bool {
        if self.bench.settings.method != Method::Innovations || self.home.estimate.stop == Stop::Certified {
            return false;
        }
        let Some(next) = self.at(&self.home.values) else { return false };
        let certified = next.estimate.stop == Stop::Certified;
        self.home = next;
        certified
    }

    /// A step where the distance to the optimum is not known.
    pub(super) fn passed(&mut self) {
        self.trace.push(self.home.value());
        let passes = self.bench.filter_passes();
        self.progress.step(Step { passes, log_likelihood: self.home.value(), decrement: None });
    }

    /// ℓ at other values, from the (μ, Σ) at hand; `None` where it is not defined.
    pub(super) fn at(&self, values: &[f64]) -> Option<Solved> {
        let near = Population::from(&self.home.estimate);
        let solved = self.bench.solve(values, Some(&near)).ok()?;
        solved.value().is_finite().then_some(solved)
    }

    /// Off a certified point along directions in which ℓ hardly curves, where it rises further out.
    fn beside(&mut self, joint: &Joint) -> bool {
        if self.faint_looks >= FAINT_LOOKS {
            return false;
        }
        self.faint_looks += 1;
        for direction in joint.faint() {
            for length in LOOKS {
                let moved = |(s, d): (usize, &f64)| self.bench.coordinates[s].moved(self.home.values[s], length * d);
                let values: Vec<f64> = direction.iter().enumerate().map(moved).collect();
                if let Some(next) = self.at(&values).filter(|next| next.value() > self.home.value() + RISE) {
                    self.arrive(next);
                    return true;
                }
            }
        }
        false
    }

    /// One step, damped until ℓ rises.
    fn advance(&mut self, joint: &Joint, decrement: f64) -> bool {
        let slack = 1e-12 * self.home.value().abs().max(1.0);
        let levels = self.levels_near_zero(joint);
        let joint = &joint.in_variances(&levels, &self.home.gradient);
        while self.damping < STIFF {
            let step = self.within_reach(joint, &levels);
            let promised = 0.5 * step.decrement.powi(2);
            let values = self.moved(&step.alpha, &levels);
            let next = match self.bench.settings.method {
                Method::Innovations => self.bench.step(&self.home, &values, &step.inner),
                Method::Hybrid | Method::Em => self.at(&values),
            };
            let next = next.or_else(|| self.above_zero(&values));
            let Some(next) = next else {
                self.damping = (8.0 * self.damping).max(0.1);
                continue;
            };
            let gain = next.value() - self.home.value();
            self.level_steps = if gain > 0.0 { 0 } else { self.level_steps + 1 };
            let is_level = promised <= slack && gain >= -slack && decrement < 1e-3 && self.level_steps < LEVEL_STEPS;
            if gain >= 0.05 * promised || is_level {
                self.damping *= if gain > 0.5 * promised { 0.1 } else { 1.0 };
                self.damping = if self.damping < 1e-4 { 0.0 } else { self.damping };
                let before = self.home.clone();
                self.arrive(next);
                if levels.is_empty() && !self.stride(&step) && gain > 0.2 * promised {
                    self.glide(joint, &before);
                }
                return true;
            }
            self.damping = (5.0 * self.damping).max(0.05);
        }
        self.damping = 0.0;
        false
    }

    /// The step with so much damping that no value goes too far; values of single tests are cut off by themselves. `levels` move
    /// in their variances, to zero at most.
    fn within_reach(&mut self, joint: &Joint, levels: &[(usize, f64)]) -> joint::Step {
        let reach = |s: usize| match levels.iter().find(|(level, _)| *level == s) {
            Some((_, exponent)) => Some((-exponent.recip(), HIGHEST / exponent)),
            None => self.bench.coordinates[s].log.then_some((-LONGEST, LONGEST)),
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

    /// The step, what reaches zero going no further, and the rest beside it.
    fn to_zero_at_most(&self, joint: &Joint, levels: &[(usize, f64)]) -> joint::Step {
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
            let (coordinate, value) = (&self.bench.coordinates[s], self.home.values[s]);
            match levels.iter().any(|(level, _)| *level == s) {
                true => coordinate.moved_as_variance(value, *d).max(self.bottom[s]),
                false => coordinate.moved(value, *d),
            }
        };
        step.iter().enumerate().map(one).collect()
    }

    /// Takes up a place.
    pub(super) fn arrive(&mut self, next: Solved) {
        for s in 0..next.values.len() {
            let (before, value) = (self.home.values[s], next.values[s]);
            if value <= self.bottom[s] && before > self.bottom[s] && before > FAR_BELOW * self.before_zero[s] {
                self.before_zero[s] = before;
            }
        }
        self.home = next;
    }

    /// The same step again and again, twice as long each time, while that raises ℓ: along a ridge that runs level. Whether it did.
    fn stride(&mut self, step: &joint::Step) -> bool {
        let far = step.alpha.iter().zip(&self.bench.coordinates).any(|(d, c)| c.log && d.abs() > DRIFT);
        if !far || step.decrement > 0.3 {
            return false;
        }
        let mut length = 1.0;
        for tried in 0..4 {
            length *= 2.0;
            let moved = |(s, d): (usize, &f64)| self.bench.coordinates[s].moved(self.home.values[s], length * d);
            let values: Vec<f64> = step.alpha.iter().enumerate().map(moved).collect();
            let Some(next) = self.at(&values).filter(|next| next.value() > self.home.value()) else { return tried > 0 };
            self.arrive(next);
        }
        true
    }
}

/// A search from a start, by the method that was asked for; it gives up where `floor` is out of reach.
pub(crate) fn search(
    bench: &Bench<'_>,
    start: Start,
    floor: Option<f64>,
    progress: &mut dyn Progress,
) -> Result<End, DynamicError> {
    let home = bench.solve(&start.values, None)?;
    let mut search = Search::new(bench, progress, home).beyond(floor);
    if let Some(curvature) = start.curvature {
        search.glide_on(curvature, None);
    }
    match bench.settings.method {
        Method::Hybrid | Method::Innovations => search.run(),
        Method::Em => Em::new(search)?.run(),
    }
}
