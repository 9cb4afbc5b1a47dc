//! EM on states and noises (Sun's, extended to tests that repeat).
//!
//! Complete data of a test: ξ, all states, all noises. The E-step is the smoother at (α, μ, Σ). The M-step sets every
//! noise level in closed form, and raises the expected log-likelihood of the complete data over time constants and
//! other coefficients. Two kinds of values are moved on ℓ itself, as ECME does, because it goes further: μ and Σ, whose
//! maximum at the new α is found on the reductions; and values that the complete data determine or do not depend on (a
//! coefficient that no noise accompanies, matrices of the covariance structure). ℓ never falls, and Anderson's
//! extrapolation speeds up the iteration.

mod anderson;
mod ascent;
#[cfg(test)]
mod tests;
mod ways;

use nalgebra::DVector;

use crate::DynamicError;
use crate::joint::JointInformation;
use crate::profile_likelihood::ProfilePoint;
use crate::search_state::{LONGEST, NEAR_ENOUGH, SearchEnd, SearchState};
use anderson::Anderson;
use ascent::Ascent;
use kalfit_estimate::{Stage, Stop};
use ways::{Way, ways};

/// Maximal number of passes.
const PASSES: usize = 20_000;
/// Pass after which the certificate is first computed.
const FIRST: usize = 6;
/// Pass at which EM is reported to be slow: another method would have ended by then.
const SLOW: usize = 30;
/// Maximal number of passes between two certificates.
const LONGEST_WAIT: usize = 128;
/// Distance from a stationary point that is no maximum, in standard errors, from which EM would take very long to leave
/// it.
const SADDLE: f64 = 0.05;
/// Part of the slope along the step of EM by which a longer step must raise ℓ; the step itself raises ℓ by half of that
/// slope or more.
const ENOUGH: f64 = 0.5;
/// Part of that slope by which an extrapolation must raise ℓ.
const LITTLE: f64 = 0.1;
/// Least factor by which a step of EM is lengthened.
const SHORTEST: f64 = 2.0;
/// Largest factor by which a step of EM is lengthened.
const LONGER: f64 = 1024.0;
/// Maximal number of times that a step which does not raise ℓ is halved.
const HALVES: usize = 12;
/// Number of certificates without improvement, where steps no longer raise ℓ, after which EM ends.
const PATIENCE: usize = 4;

/// State of EM.
pub(crate) struct Em<'b, 'a> {
    search: SearchState<'b, 'a>,
    ways: Vec<Way>,
    /// Values that were zero when `ways` was determined.
    zero: Vec<usize>,
    ascent: Ascent,
    anderson: Anderson,
    /// Factor by which the next step of EM is lengthened.
    stretch: f64,
}

/// A certificate.
struct CertificateCheck {
    joint: JointInformation,
    decrement: f64,
    concave: bool,
}

impl<'b, 'a> Em<'b, 'a> {
    pub(crate) fn new(search: SearchState<'b, 'a>) -> Result<Em<'b, 'a>, DynamicError> {
        let ways = ways(search.objective, &search.home)?;
        let zero = zeros(&search.home);
        Ok(Em { search, ways, zero, ascent: Ascent::default(), anderson: Anderson::default(), stretch: SHORTEST })
    }

    /// Runs EM to an optimum that two-sided differences certify.
    pub(crate) fn run(mut self) -> Result<SearchEnd, DynamicError> {
        let (mut next, mut best, mut stuck) = (FIRST, f64::INFINITY, 0);
        let mut before = f64::NEG_INFINITY; // ℓ at the last certificate
        let mut ended = None;
        for pass in 0..PASSES {
            let near = self.pass()?;
            if pass == SLOW {
                self.search.say(Stage::Slow);
            }
            if self.search.stops() {
                ended = Some((self.look(false), Stop::Interrupted));
                break;
            }
            if !near && pass < next {
                continue;
            }
            next = pass + (4 + pass / 2).min(LONGEST_WAIT);
            let value = self.search.home.value();
            let rises = value > before + 1e-12 * value.abs();
            before = value;
            let coarse = self.look(false);
            if !coarse.concave && coarse.decrement <= SADDLE && self.search.off_saddle(&coarse.joint) {
                self.forget();
                continue;
            }
            if !(coarse.concave && coarse.decrement <= 10.0 * self.search.tolerance())
                && (self.leap(&coarse.joint) || !near && rises)
            {
                continue;
            }
            let look = self.look(true);
            let good = look.concave && look.decrement <= self.search.tolerance();
            if good && self.search.revived(&look.joint) {
                self.forget();
                continue;
            }
            stuck = if look.decrement < 0.5 * best { 0 } else { stuck + 1 };
            best = best.min(look.decrement);
            if good || stuck >= PATIENCE {
                let enough = look.concave && look.decrement <= NEAR_ENOUGH * self.search.tolerance();
                ended = Some((look, if good || enough { Stop::Certified } else { Stop::Stalled }));
                break;
            }
        }
        let (last, stop) = ended.unwrap_or_else(|| (self.look(true), Stop::PassLimit));
        Ok(self.search.ended((last.joint, last.decrement), stop))
    }

    fn look(&self, fine: bool) -> CertificateCheck {
        let joint = JointInformation::new(self.search.objective, &self.search.home, &self.search.active(), fine);
        let still = DVector::zeros(self.search.home.estimate.state.newton_iterate.tangent.gradient.len());
        let step = joint.step(&self.search.home.gradient, &still, 0.0);
        CertificateCheck { joint, decrement: step.decrement, concave: step.concave }
    }

    fn leap(&mut self, joint: &JointInformation) -> bool {
        let leapt = self.search.leap(joint);
        if leapt {
            self.search.place();
            self.forget();
        }
        leapt
    }

    fn forget(&mut self) {
        self.search.place();
        self.anderson.clear();
    }

    /// Makes one pass; returns whether its predicted rise is negligible or no step raised ℓ.
    fn pass(&mut self) -> Result<bool, DynamicError> {
        let active = self.search.active();
        let step = self.step(&active)?;
        let promised: f64 = step.iter().zip(&self.search.home.gradient).map(|(d, g)| d * g).sum();
        let near = promised <= (0.1 * self.search.tolerance()).powi(2);
        let further = self.anderson.extrapolate(&self.coordinates(), &step, &active);
        let moved = further.is_some_and(|further| self.go(&further, (1.0, LITTLE * promised))) || {
            self.anderson.restart();
            self.stretched(&step, promised) || self.halving(&step)
        };
        self.search.place();
        if self.search.active() != active {
            self.anderson.clear();
        }
        if self.zero.iter().any(|&s| self.search.home.values[s] != 0.0) {
            (self.ways, self.zero) = (ways(self.search.objective, &self.search.home)?, zeros(&self.search.home));
            self.forget();
        }
        self.search.tell(None);
        Ok(near || !moved)
    }

    /// Tries the step of EM lengthened by a factor that grows while this succeeds.
    fn stretched(&mut self, step: &[f64], promised: f64) -> bool {
        let well = self.go(step, (self.stretch, ENOUGH * promised));
        self.stretch = if well { (2.0 * self.stretch).min(LONGER) } else { (0.25 * self.stretch).max(SHORTEST) };
        well
    }

    /// Tries the step of EM, halved until ℓ does not fall; values moved on ℓ itself are then moved separately.
    fn halving(&mut self, step: &[f64]) -> bool {
        if self.go(step, (1.0, 0.0)) {
            return true;
        }
        let only = |own: &dyn Fn(Way) -> bool| -> Vec<f64> {
            step.iter().zip(&self.ways).map(|(d, way)| if own(*way) { *d } else { 0.0 }).collect()
        };
        let parts = [only(&|way| way != Way::Likelihood), only(&|way| way == Way::Likelihood)];
        let parts = parts.iter().filter(|part| part.iter().any(|d| *d != 0.0));
        let mut moved = false;
        for part in parts {
            moved |= (0..HALVES).any(|k| self.go(part, (0.5_f64.powi(k as i32), 0.0)));
        }
        moved
    }

    /// Takes a part of a step in the coordinates unless ℓ rises by less than `gain`, except for rounding.
    fn go(&mut self, step: &[f64], (part, gain): (f64, f64)) -> bool {
        let home = &self.search.home;
        let far = |(s, d): (usize, &f64)| if self.search.objective.coordinates[s].log { d.abs() } else { 0.0 };
        let longest = step.iter().enumerate().map(far).fold(0.0, f64::max) * part;
        let part = part * if longest > LONGEST { LONGEST / longest } else { 1.0 };
        let values = self.search.objective.moved(&home.values, step, part);
        let slack = 1e-12 * home.value().abs().max(1.0);
        match self.search.at(&values).filter(|next: &ProfilePoint| next.value() >= home.value() + gain - slack) {
            Some(next) => {
                self.search.home = next;
                true
            }
            None => false,
        }
    }

    /// The coordinates of the values; 0 for logarithms of zero, which stay.
    fn coordinates(&self) -> Vec<f64> {
        let one =
            |(s, v): (usize, &f64)| Some(self.search.objective.coordinates[s].of_value(*v)).filter(|c| c.is_finite());
        self.search.home.values.iter().enumerate().map(|pair| one(pair).unwrap_or(0.0)).collect()
    }

    /// Change of the coordinates by E-step and M-step.
    fn step(&mut self, active: &[bool]) -> Result<Vec<f64>, DynamicError> {
        let (objective, home) = (self.search.objective, &self.search.home);
        let mut step = vec![0.0; active.len()];
        for s in (0..active.len()).filter(|&s| active[s]) {
            if let Way::Level { degree, count } = self.ways[s] {
                step[s] = level_step(&objective.coordinates[s], home, s, (degree, count));
            }
        }
        let smooth: Vec<bool> = (0..active.len()).map(|s| active[s] && self.ways[s] == Way::Expected).collect();
        if smooth.contains(&true) {
            let complete = objective.complete(home)?;
            let begun = objective.moved(&home.values, &step, 1.0);
            let reached =
                self.ascent.maximise(&|values| objective.expected(&complete, values), begun, &smooth, objective);
            for s in (0..active.len()).filter(|&s| smooth[s]) {
                step[s] =
                    objective.coordinates[s].of_value(reached[s]) - objective.coordinates[s].of_value(home.values[s]);
            }
        }
        let direct: Vec<bool> = (0..active.len()).map(|s| active[s] && self.ways[s] == Way::Likelihood).collect();
        if direct.contains(&true) {
            let joint = JointInformation::new(objective, home, &direct, false);
            let still = DVector::zeros(home.estimate.state.newton_iterate.tangent.gradient.len());
            let newton = joint.step(&home.gradient, &still, 0.0);
            (0..active.len()).filter(|&s| direct[s]).for_each(|s| step[s] = newton.alpha[s]);
        }
        Ok(step)
    }
}

fn zeros(home: &ProfilePoint) -> Vec<usize> {
    (0..home.values.len()).filter(|&s| home.values[s] == 0.0).collect()
}

/// σ^d_new = σ^d (1 + (2/dn) ∂ℓ/∂ln σ), as a step of the coordinate.
fn level_step(coordinate: &crate::Coordinate, home: &ProfilePoint, s: usize, (degree, count): (f64, f64)) -> f64 {
    let value = home.values[s];
    let score = if coordinate.log { home.gradient[s] } else { home.gradient[s] * value };
    if count == 0.0 || value == 0.0 {
        return 0.0;
    }
    // E[v²] is positive, except for rounding
    let factor = (1.0 + 2.0 * score / (degree * count)).max(1e-6).ln() / degree;
    let new = coordinate.moved(value, if coordinate.log { factor } else { value * factor.exp_m1() });
    coordinate.of_value(new) - coordinate.of_value(value)
}
