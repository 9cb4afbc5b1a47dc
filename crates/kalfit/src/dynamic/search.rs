//! The outer search (the paper's Figure 1): μ and Σ are solved for each α, and Newton's method moves α.

use nalgebra::DVector;

use crate::dynamic::bench::{Bench, Solved};
use crate::dynamic::em::Em;
use crate::dynamic::joint::{self, Joint};
use crate::dynamic::{DynamicError, Method, Standing, start};
use crate::estimate::{Progress, Step, Stop};
use crate::model::Population;

/// Longest step of a logarithm.
pub(super) const LONGEST: f64 = 2.0;
/// With more damping than this a step goes nowhere.
const STIFF: f64 = 1e6;
/// Where rounding keeps the search from going on, so many tolerances are near enough.
pub(super) const NEAR_ENOUGH: f64 = 1e2;
/// Most outer steps.
const STEPS: usize = 200;
/// A logarithm whose curvature is no more than this many times its slope has no optimum in sight: ℓ runs level towards a bound,
/// as 1/x, x² or the like.
const LEVEL: f64 = 3.5;
/// … and only a slope below this, and so little of ℓ to be had, makes a leap worth a try.
const TAIL: f64 = 0.1;
/// A step of a logarithm beyond this goes far.
const DRIFT: f64 = 0.25;
/// ℓ that may still be had beyond, where a value counts as infinite.
const BEYOND: f64 = 1e-7;
/// A value that returns from zero does so at this part of what it was.
const RETURN: f64 = 5e-2;

/// Where a search is.
pub(crate) struct Search<'b, 'a> {
    pub(super) bench: &'b Bench<'a>,
    progress: &'b mut dyn Progress,
    pub(crate) home: Solved,
    pub(crate) standing: Vec<Standing>,
    pub(crate) trace: Vec<f64>,
    /// The value of each coordinate before it was set to zero.
    pub(super) before_zero: Vec<f64>,
    damping: f64,
    floor: Option<f64>,
    held: Option<usize>,
    /// Values left on their way to zero or to infinity.
    drifted: Vec<bool>,
    /// Values that have returned from zero once stay off it.
    returned: Vec<bool>,
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
}

impl End {
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
        let (before_zero, returned) = (home.values.clone(), vec![false; n]);
        let mut search = Search {
            bench,
            progress,
            home,
            standing: vec![Standing::Inside; n],
            trace,
            before_zero,
            damping: 0.0,
            floor: None,
            held: None,
            drifted: vec![false; n],
            returned,
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
        let promised = self.home.value() + 2.0 * decrement * decrement + 1.0;
        self.trace.len() > 3 && self.floor.is_some_and(|floor| promised < floor)
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
        let mut fine = false; // differences to both sides
        let mut stop = Stop::PassLimit;
        let mut last = None;
        for _ in 0..STEPS {
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
        let (joint, certificate) = last.expect("there is at least one step");
        if self.home.estimate.stop != Stop::Certified && stop != Stop::Interrupted {
            stop = self.home.estimate.stop;
        }
        let (home, standing, before_zero) = (self.home, self.standing, self.before_zero);
        Ok(End { home, standing, joint, certificate, stop, trace: self.trace, before_zero })
    }

    /// What to do where this is known; `fine` when it is by differences to both sides.
    fn turn(&mut self, joint: &Joint, step: &joint::Step, fine: bool) -> Turn {
        if self.progress.stops() {
            return Turn::End(Stop::Interrupted);
        }
        if self.leap(joint) || self.drifted(joint, step) {
            self.place();
            return Turn::On { closer: false };
        }
        let still = step.decrement <= self.tolerance();
        if still && !step.concave && (self.settled() || self.off_saddle(joint)) {
            return Turn::On { closer: false };
        }
        if self.hopeless(step.decrement) {
            return Turn::End(Stop::PassLimit);
        }
        if still && step.concave {
            return match fine {
                false => Turn::On { closer: true },
                true if self.settled() => Turn::On { closer: true },
                true if self.released() => Turn::On { closer: false },
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

    fn tell(&mut self, decrement: f64) {
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

    /// One step, damped until ℓ rises.
    fn advance(&mut self, joint: &Joint, decrement: f64) -> bool {
        let slack = 1e-12 * self.home.value().abs().max(1.0);
        while self.damping < STIFF {
            let step = self.within_reach(joint);
            let promised = 0.5 * step.decrement.powi(2);
            let moved = |(s, d): (usize, &f64)| self.bench.coordinates[s].moved(self.home.values[s], *d);
            let values: Vec<f64> = step.alpha.iter().enumerate().map(moved).collect();
            let next = match self.bench.settings.method {
                Method::Innovations => self.bench.step(&self.home, &values, &step.inner),
                Method::Hybrid | Method::Em => self.at(&values),
            };
            let Some(next) = next else {
                self.damping = (8.0 * self.damping).max(0.1);
                continue;
            };
            let gain = next.value() - self.home.value();
            if gain >= 0.05 * promised || (promised <= slack && gain >= -slack && decrement < 1e-3) {
                self.damping *= if gain > 0.5 * promised { 0.1 } else { 1.0 };
                self.damping = if self.damping < 1e-4 { 0.0 } else { self.damping };
                self.home = next;
                self.stride(&step);
                return true;
            }
            self.damping = (5.0 * self.damping).max(0.05);
        }
        self.damping = 0.0;
        false
    }

    /// The step with so much damping that no logarithm goes too far; values of single tests are cut off by themselves.
    fn within_reach(&mut self, joint: &Joint) -> joint::Step {
        loop {
            let mut step = joint.step(&self.home.gradient, self.inner_gradient(), self.damping);
            let far = |&&s: &&usize| self.bench.coordinates[s].log && step.alpha[s].abs() > LONGEST;
            if joint.shared().iter().find(far).is_none() || self.damping > STIFF {
                for (_, d) in step.alpha.iter_mut().enumerate().filter(|(s, _)| self.bench.coordinates[*s].log) {
                    *d = d.clamp(-LONGEST, LONGEST);
                }
                return step;
            }
            self.damping = (3.0 * self.damping).max(0.01);
        }
    }

    /// Logarithms along which ℓ runs level downwards are tried at their lower bound, at zero say: all at once, then a few of
    /// them one by one.
    pub(super) fn leap(&mut self, joint: &Joint) -> bool {
        let sinking = |&s: &usize| {
            let (slope, bend) = (self.home.gradient[s], joint.curvature(s));
            let tail = (-TAIL..0.0).contains(&slope) && bend > 0.0 && bend <= LEVEL * slope.abs();
            self.bench.coordinates[s].log && tail && !self.returned[s]
        };
        let sinking: Vec<usize> = joint.active.iter().copied().filter(sinking).collect();
        let mut sets = vec![sinking.clone()];
        if sinking.len() > 1 {
            sets.extend(sinking.iter().take(8).map(|&s| vec![s]));
        }
        let mut leapt = false;
        for set in sets.iter().filter(|set| !set.is_empty()) {
            if set.iter().any(|&s| self.home.values[s] == 0.0) {
                continue; // with all the others, a moment ago
            }
            let mut values = self.home.values.clone();
            set.iter().for_each(|&s| values[s] = self.bench.coordinates[s].lower);
            leapt |= self.jump(values, set);
        }
        leapt
    }

    /// Logarithms that would still go far for next to nothing are left where they are: at zero, as far as the data can tell, or
    /// at infinity.
    fn drifted(&mut self, joint: &Joint, step: &joint::Step) -> bool {
        if 0.5 * step.decrement.powi(2) > BEYOND {
            return false;
        }
        let mut any = false;
        for (s, d) in step.alpha.iter().enumerate() {
            if self.bench.coordinates[s].log && d.abs() > DRIFT && self.standing[s] == Standing::Inside {
                let (slope, bend) = (self.home.gradient[s], joint.curvature(s));
                let level = bend > 0.0 && bend <= LEVEL * slope.abs();
                self.standing[s] = match (level, slope > 0.0) {
                    (true, true) => Standing::Unbounded,
                    (true, false) => Standing::Lower,
                    (false, _) => Standing::Unidentified,
                };
                self.drifted[s] = true;
                any = true;
            }
        }
        any
    }

    /// The same step again and again, twice as long each time, while that raises ℓ: along a ridge that runs level.
    fn stride(&mut self, step: &joint::Step) {
        let far = step.alpha.iter().zip(&self.bench.coordinates).any(|(d, c)| c.log && d.abs() > DRIFT);
        if !far || step.decrement > 0.3 {
            return;
        }
        let mut length = 1.0;
        for _ in 0..4 {
            length *= 2.0;
            let moved = |(s, d): (usize, &f64)| self.bench.coordinates[s].moved(self.home.values[s], length * d);
            let values: Vec<f64> = step.alpha.iter().enumerate().map(moved).collect();
            let Some(next) = self.at(&values).filter(|next| next.value() > self.home.value()) else { return };
            self.home = next;
        }
    }

    fn jump(&mut self, values: Vec<f64>, set: &[usize]) -> bool {
        let slack = 1e-11 * self.home.value().abs().max(1.0);
        let Some(next) = self.at(&values).filter(|next| next.value() >= self.home.value() - slack) else {
            return false;
        };
        set.iter().for_each(|&s| self.before_zero[s] = self.home.values[s]);
        self.home = next;
        true
    }

    /// Values at zero where ℓ rises with their square, or bounded ones whose slope points inward, are let go.
    pub(super) fn released(&mut self) -> bool {
        let zero: Vec<usize> = (0..self.standing.len())
            .filter(|&s| self.bench.coordinates[s].log && self.home.values[s] == 0.0 && !self.returned[s])
            .filter(|&s| self.held != Some(s))
            .collect();
        let mut released = false;
        for &s in zero.iter().take(64) {
            let rises = |next: &Solved| next.gradient[s] > 0.0 && next.value() > self.home.value();
            let best = self.near_zero(s).into_iter().filter_map(|values| self.at(&values)).filter(rises);
            if let Some(next) = best.max_by(|a, b| a.value().total_cmp(&b.value())) {
                self.home = next;
                self.standing.iter_mut().filter(|standing| **standing == Standing::Unidentified).for_each(|standing| {
                    *standing = Standing::Inside; // a time constant whose noise has come back
                });
                self.drifted.fill(false);
                self.returned[s] = true;
                self.standing[s] = Standing::Inside;
                released = true;
            }
        }
        released
    }
}

impl Search<'_, '_> {
    /// Places a little way off zero: with the other values as they are, and with time constants that mean nothing at zero
    /// between the length of a step and that of a record.
    fn near_zero(&self, s: usize) -> Vec<Vec<f64>> {
        let mut values = self.home.values.clone();
        values[s] = RETURN * self.before_zero[s];
        let flat = |t: usize| self.home.gradient[t].abs() < 1e-9 && self.home.values[t] > 0.0 && self.held != Some(t);
        let constants = start::time_constants(self.bench.model);
        let slots = self.bench.slots.slots();
        let idle: Vec<usize> =
            (0..slots.len()).filter(|&t| constants.contains(&slots[t].parameter) && flat(t)).collect();
        let mut all = vec![values.clone()];
        if !idle.is_empty() {
            for time in start::Scales::of(self.bench).times() {
                let mut values = values.clone();
                idle.iter().for_each(|&t| {
                    values[t] = time.clamp(self.bench.coordinates[t].lower, self.bench.coordinates[t].upper)
                });
                all.push(values);
            }
        }
        all
    }
}

/// A search from given values, by the method that was asked for; it gives up where `floor` is out of reach.
pub(crate) fn search(
    bench: &Bench<'_>,
    values: &[f64],
    floor: Option<f64>,
    progress: &mut dyn Progress,
) -> Result<End, DynamicError> {
    let home = bench.solve(values, None)?;
    let search = Search::new(bench, progress, home).beyond(floor);
    match bench.settings.method {
        Method::Hybrid | Method::Innovations => search.run(),
        Method::Em => Em::new(search)?.run(),
    }
}
