//! The outer search (the paper's Figure 1): μ and Σ are solved for each α, and Newton's method moves α.

use nalgebra::DVector;

use crate::dynamic::bench::{Bench, Solved};
use crate::dynamic::em::Em;
use crate::dynamic::joint::{self, Joint};
use crate::dynamic::{DynamicError, Method, Standing};
use crate::estimate::{Progress, Step, Stop};
use crate::model::Population;

/// Longest step of a logarithm.
pub(super) const LONGEST: f64 = 2.0;
/// How often one step is tried with more damping.
const TRIES: usize = 14;
/// Most outer steps.
const STEPS: usize = 200;
/// A logarithm whose curvature is no more than this many times its slope has no optimum in sight: ℓ runs level towards a bound,
/// as 1/x, x² or the like.
const LEVEL: f64 = 3.5;
/// A leap along a logarithm that runs level.
const LEAP: f64 = 4.0;
/// ℓ that may still be had beyond, where a value counts as infinite.
const BEYOND: f64 = 1e-8;
/// A value that returns from zero does so at this part of what it was.
const RETURN: f64 = 1e-2;

/// Where a search is.
pub(crate) struct Search<'b, 'a> {
    pub(super) bench: &'b Bench<'a>,
    progress: &'b mut dyn Progress,
    pub(crate) home: Solved,
    pub(crate) standing: Vec<Standing>,
    pub(crate) trace: Vec<f64>,
    /// The value of each coordinate before it was set to zero.
    before_zero: Vec<f64>,
    damping: f64,
    /// Values that have returned from zero once stay off it.
    returned: Vec<bool>,
}

/// Where it ended.
pub(crate) struct End {
    pub(crate) home: Solved,
    pub(crate) standing: Vec<Standing>,
    pub(crate) joint: Joint,
    pub(crate) certificate: f64,
    pub(crate) stop: Stop,
    pub(crate) trace: Vec<f64>,
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
                Standing::Unbounded => Standing::Unbounded,
                _ if coordinate.log && value == 0.0 => Standing::Lower,
                _ if coordinate.at_lower(value) && slope <= 0.0 => Standing::Lower,
                _ if coordinate.at_upper(value) && slope >= 0.0 => Standing::Upper,
                _ => Standing::Inside,
            };
        }
    }

    pub(super) fn active(&self) -> Vec<bool> {
        self.standing.iter().map(|standing| *standing == Standing::Inside).collect()
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
            let inner = self.home.estimate.state.place.tangent.gradient.clone() * 0.0;
            let step = joint.step(&self.home.gradient, &inner, 0.0);
            let near = step.decrement <= self.tolerance() && step.concave;
            last = Some((joint, step.decrement));
            if near {
                if !fine {
                    fine = true;
                    continue;
                }
                if self.released() {
                    fine = false;
                    continue;
                }
                stop = Stop::Certified;
                break;
            }
            let joint = last.as_ref().expect("just set").0.clone();
            let moved = self.advance(&joint, step.decrement);
            let leapt = self.leap(&joint.active, &|s| joint.curvature(s));
            if !moved && !leapt {
                if fine {
                    stop = if step.decrement <= 1e2 * self.tolerance() && step.concave {
                        Stop::Certified
                    } else {
                        Stop::Stalled
                    };
                    break;
                }
                fine = true;
                continue;
            }
            self.place();
            self.tell(step.decrement);
        }
        let (joint, certificate) = match last {
            Some(last) => last,
            None => (Joint::new(self.bench, &self.home, &self.active(), true), f64::INFINITY),
        };
        if self.home.estimate.stop != Stop::Certified {
            stop = self.home.estimate.stop;
        }
        Ok(End { home: self.home, standing: self.standing, joint, certificate, stop, trace: self.trace })
    }

    fn tell(&mut self, decrement: f64) {
        self.trace.push(self.home.value());
        let passes = self.bench.filter_passes();
        self.progress.step(Step { passes, log_likelihood: self.home.value(), decrement: Some(decrement) });
    }

    /// The same where the distance to the optimum is not known.
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
        let still = DVector::zeros(self.home.estimate.state.place.tangent.gradient.len());
        let slack = 1e-12 * self.home.value().abs().max(1.0);
        for _ in 0..TRIES {
            let step = self.within_reach(joint, &still);
            let promised = 0.5 * step.decrement.powi(2);
            let moved = |(s, d): (usize, &f64)| self.bench.coordinates[s].moved(self.home.values[s], *d);
            let values: Vec<f64> = step.alpha.iter().enumerate().map(moved).collect();
            let Some(next) = self.at(&values) else {
                self.damping = (8.0 * self.damping).max(0.1);
                continue;
            };
            let gain = next.value() - self.home.value();
            if gain >= 0.05 * promised || (promised <= slack && gain >= -slack && decrement < 1e-3) {
                self.damping *= if gain > 0.5 * promised { 0.1 } else { 1.0 };
                self.damping = if self.damping < 1e-4 { 0.0 } else { self.damping };
                self.home = next;
                return true;
            }
            self.damping = (5.0 * self.damping).max(0.05);
        }
        false
    }

    /// The step with so much damping that no logarithm goes too far; values of single tests are cut off by themselves.
    fn within_reach(&mut self, joint: &Joint, still: &DVector<f64>) -> joint::Step {
        loop {
            let mut step = joint.step(&self.home.gradient, still, self.damping);
            let far = |&&s: &&usize| self.bench.coordinates[s].log && step.alpha[s].abs() > LONGEST;
            if joint.shared().iter().find(far).is_none() || self.damping > 1e6 {
                for (_, d) in step.alpha.iter_mut().enumerate().filter(|(s, _)| self.bench.coordinates[*s].log) {
                    *d = d.clamp(-LONGEST, LONGEST);
                }
                return step;
            }
            self.damping = (3.0 * self.damping).max(0.01);
        }
    }

    /// Logarithms along which ℓ runs level are tried far out: at zero below, far beyond above.
    pub(super) fn leap(&mut self, active: &[usize], curvature: &dyn Fn(usize) -> f64) -> bool {
        let level = |&s: &usize| {
            let (slope, bend) = (self.home.gradient[s], curvature(s));
            self.bench.coordinates[s].log && slope != 0.0 && bend > 0.0 && bend <= LEVEL * slope.abs()
        };
        let candidates: Vec<usize> = active.iter().copied().filter(level).collect();
        let mut leapt = false;
        let sinking: Vec<usize> =
            candidates.iter().copied().filter(|&s| self.home.gradient[s] < 0.0 && !self.returned[s]).collect();
        let sets: Vec<Vec<usize>> = if sinking.len() > 1 {
            std::iter::once(sinking.clone()).chain(sinking.iter().take(8).map(|&s| vec![s])).collect()
        } else {
            vec![sinking]
        };
        for set in sets.iter().filter(|set| !set.is_empty()) {
            if set.iter().any(|&s| self.home.values[s] == 0.0) {
                continue;
            }
            let mut values = self.home.values.clone();
            set.iter().for_each(|&s| values[s] = self.bench.coordinates[s].lower);
            leapt |= self.jump(values, set);
        }
        let rising: Vec<usize> = candidates.iter().copied().filter(|&s| self.home.gradient[s] > 0.0).collect();
        for s in rising {
            let mut values = self.home.values.clone();
            values[s] = self.bench.coordinates[s].moved(values[s], LEAP);
            if self.jump(values, &[s]) {
                leapt = true;
            } else if self.home.gradient[s] < BEYOND && self.home.gradient[s] > 0.0 {
                self.standing[s] = Standing::Unbounded;
                leapt = true;
            }
        }
        leapt
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
            .collect();
        let mut released = false;
        for &s in zero.iter().take(64) {
            let mut values = self.home.values.clone();
            values[s] = RETURN * self.before_zero[s];
            if let Some(next) = self.at(&values)
                && next.gradient[s] > 0.0
                && next.value() > self.home.value()
            {
                self.home = next;
                self.returned[s] = true;
                self.standing[s] = Standing::Inside;
                released = true;
            }
        }
        released
    }
}

/// A search from given values, by the method that was asked for.
pub(crate) fn search(
    bench: &Bench<'_>,
    values: &[f64],
    near: Option<&Population>,
    progress: &mut dyn Progress,
) -> Result<End, DynamicError> {
    let home = bench.solve(values, near)?;
    match bench.settings.method {
        Method::Hybrid | Method::Innovations => Search::new(bench, progress, home).run(),
        Method::Em => Em::new(Search::new(bench, progress, home))?.run(),
    }
}
