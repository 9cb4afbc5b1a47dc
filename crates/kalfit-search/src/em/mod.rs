//! EM on states and noises (Sun's, extended to tests that repeat).
//!
//! Complete data of a test: ξ, all states, all noises. The E-step is the smoother at (α, μ, Σ). The M-step sets every
//! noise level in closed form, and raises the expected log-likelihood of the complete data over time constants and
//! other coefficients. Two kinds of values are moved on ℓ itself, as in ECME, because steps on ℓ are longer: μ and Σ,
//! whose maximum at the new α is found on the reductions; and values that the complete data determine or do not depend
//! on (a coefficient that no noise accompanies, matrices of the covariance structure). ℓ never falls, and Anderson's
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
const MAX_PASSES: usize = 20_000;
/// Pass after which the certificate is first computed.
const FIRST_CHECK: usize = 6;
/// Pass at which EM is reported to be slow: another method would have ended by then.
const SLOW_PASS: usize = 30;
/// Maximal number of passes between two certificates.
const MAX_WAIT: usize = 128;
/// Distance from a stationary point that is no maximum, in standard errors, from which EM would take very long to leave
/// it.
const SADDLE_DISTANCE: f64 = 0.05;
/// Part of the slope along the step of EM by which a longer step must raise ℓ; the step itself raises ℓ by half of that
/// slope or more.
const MIN_STEP_GAIN: f64 = 0.5;
/// Part of the slope along the step of EM by which an extrapolation must raise ℓ.
const MIN_EXTRAPOLATION_GAIN: f64 = 0.1;
/// Least factor by which a step of EM is lengthened.
const MIN_STRETCH: f64 = 2.0;
/// Largest factor by which a step of EM is lengthened.
const MAX_STRETCH: f64 = 1024.0;
/// Maximal number of times that a step which does not raise ℓ is halved.
const MAX_HALVINGS: usize = 12;
/// Number of certificates without improvement, where steps no longer raise ℓ, after which EM ends.
const MAX_STUCK: usize = 4;

/// State of EM.
pub(crate) struct Em<'b, 'a> {
    search: SearchState<'b, 'a>,
    ways: Vec<Way>,
    /// Indices of the values that were zero when `ways` was determined.
    zero: Vec<usize>,
    ascent: Ascent,
    anderson: Anderson,
    /// Factor by which the next step of EM is lengthened.
    stretch: f64,
}

/// Joint information, decrement and concavity of ℓ at a point.
struct CertificateCheck {
    joint: JointInformation,
    decrement: f64,
    concave: bool,
}

impl<'b, 'a> Em<'b, 'a> {
    pub(crate) fn new(search: SearchState<'b, 'a>) -> Result<Em<'b, 'a>, DynamicError> {
        let ways = ways(search.objective, &search.iterate)?;
        let zero = zeros(&search.iterate);
        Ok(Em { search, ways, zero, ascent: Ascent::default(), anderson: Anderson::default(), stretch: MIN_STRETCH })
    }

    /// Runs EM to an optimum that two-sided differences certify.
    pub(crate) fn run(mut self) -> Result<SearchEnd, DynamicError> {
        let (mut next, mut best, mut stuck) = (FIRST_CHECK, f64::INFINITY, 0);
        let mut before = f64::NEG_INFINITY; // ℓ at the last certificate
        let mut ended = None;
        for pass in 0..MAX_PASSES {
            let near = self.pass()?;
            if pass == SLOW_PASS {
                self.search.report_stage(Stage::Slow);
            }
            if self.search.stops() {
                ended = Some((self.check_certificate(false), Stop::Interrupted));
                break;
            }
            if !near && pass < next {
                continue;
            }
            next = pass + (4 + pass / 2).min(MAX_WAIT);
            let value = self.search.iterate.value();
            let rises = value > before + 1e-12 * value.abs();
            before = value;
            let coarse = self.check_certificate(false);
            if !coarse.concave && coarse.decrement <= SADDLE_DISTANCE && self.search.leave_saddle(&coarse.joint) {
                self.forget();
                continue;
            }
            if !(coarse.concave && coarse.decrement <= 10.0 * self.search.tolerance())
                && (self.try_lower_bounds(&coarse.joint) || !near && rises)
            {
                continue;
            }
            let check_certificate = self.check_certificate(true);
            let good = check_certificate.concave && check_certificate.decrement <= self.search.tolerance();
            if good && self.search.reactivate_levels(&check_certificate.joint) {
                self.forget();
                continue;
            }
            stuck = if check_certificate.decrement < 0.5 * best { 0 } else { stuck + 1 };
            best = best.min(check_certificate.decrement);
            if good || stuck >= MAX_STUCK {
                let enough =
                    check_certificate.concave && check_certificate.decrement <= NEAR_ENOUGH * self.search.tolerance();
                ended = Some((check_certificate, if good || enough { Stop::Certified } else { Stop::Stalled }));
                break;
            }
        }
        let (last, stop) = ended.unwrap_or_else(|| (self.check_certificate(true), Stop::PassLimit));
        Ok(self.search.ended((last.joint, last.decrement), stop))
    }

    fn check_certificate(&self, fine: bool) -> CertificateCheck {
        let joint = JointInformation::new(self.search.objective, &self.search.iterate, &self.search.active(), fine);
        let zero_gradient = DVector::zeros(self.search.iterate.estimate.state.newton_iterate.tangent.gradient.len());
        let step = joint.step(&self.search.iterate.gradient, &zero_gradient, 0.0);
        CertificateCheck { joint, decrement: step.decrement, concave: step.concave }
    }

    fn try_lower_bounds(&mut self, joint: &JointInformation) -> bool {
        let has_moved = self.search.try_lower_bounds(joint);
        if has_moved {
            self.search.update_standing();
            self.forget();
        }
        has_moved
    }

    fn forget(&mut self) {
        self.search.update_standing();
        self.anderson.clear();
    }

    /// Makes one pass; returns whether its predicted rise is negligible or no step raised ℓ.
    fn pass(&mut self) -> Result<bool, DynamicError> {
        let active = self.search.active();
        let step = self.step(&active)?;
        let promised: f64 = step.iter().zip(&self.search.iterate.gradient).map(|(d, g)| d * g).sum();
        let near = promised <= (0.1 * self.search.tolerance()).powi(2);
        let further = self.anderson.extrapolate(&self.coordinates(), &step, &active);
        let moved = further.is_some_and(|further| self.take_step(&further, (1.0, MIN_EXTRAPOLATION_GAIN * promised)))
            || {
                self.anderson.restart();
                self.stretched(&step, promised) || self.halving(&step)
            };
        self.search.update_standing();
        if self.search.active() != active {
            self.anderson.clear();
        }
        if self.zero.iter().any(|&s| self.search.iterate.values[s] != 0.0) {
            (self.ways, self.zero) = (ways(self.search.objective, &self.search.iterate)?, zeros(&self.search.iterate));
            self.forget();
        }
        self.search.report_step(None);
        Ok(near || !moved)
    }

    /// Tries the step of EM lengthened by a factor that grows while this succeeds.
    fn stretched(&mut self, step: &[f64], promised: f64) -> bool {
        let well = self.take_step(step, (self.stretch, MIN_STEP_GAIN * promised));
        self.stretch =
            if well { (2.0 * self.stretch).min(MAX_STRETCH) } else { (0.25 * self.stretch).max(MIN_STRETCH) };
        well
    }

    /// Tries the step of EM, halved until ℓ does not fall; values moved on ℓ itself are then moved separately.
    fn halving(&mut self, step: &[f64]) -> bool {
        if self.take_step(step, (1.0, 0.0)) {
            return true;
        }
        let only = |own: &dyn Fn(Way) -> bool| -> Vec<f64> {
            step.iter().zip(&self.ways).map(|(d, way)| if own(*way) { *d } else { 0.0 }).collect()
        };
        let parts = [only(&|way| way != Way::Likelihood), only(&|way| way == Way::Likelihood)];
        let parts = parts.iter().filter(|part| part.iter().any(|d| *d != 0.0));
        let mut moved = false;
        for part in parts {
            moved |= (0..MAX_HALVINGS).any(|k| self.take_step(part, (0.5_f64.powi(k as i32), 0.0)));
        }
        moved
    }

    /// Takes a part of a step in the coordinates unless ℓ rises by less than `gain`, except for rounding.
    fn take_step(&mut self, step: &[f64], (part, gain): (f64, f64)) -> bool {
        let iterate = &self.search.iterate;
        let far = |(s, d): (usize, &f64)| if self.search.objective.coordinates[s].log { d.abs() } else { 0.0 };
        let longest = step.iter().enumerate().map(far).fold(0.0, f64::max) * part;
        let part = part * if longest > LONGEST { LONGEST / longest } else { 1.0 };
        let values = self.search.objective.moved(&iterate.values, step, part);
        let slack = 1e-12 * iterate.value().abs().max(1.0);
        match self.search.at(&values).filter(|next: &ProfilePoint| next.value() >= iterate.value() + gain - slack) {
            Some(next) => {
                self.search.iterate = next;
                true
            }
            None => false,
        }
    }

    /// The coordinates of the values; 0 for logarithms of zero, which stay.
    fn coordinates(&self) -> Vec<f64> {
        let one =
            |(s, v): (usize, &f64)| Some(self.search.objective.coordinates[s].of_value(*v)).filter(|c| c.is_finite());
        self.search.iterate.values.iter().enumerate().map(|pair| one(pair).unwrap_or(0.0)).collect()
    }

    /// Change of the coordinates by E-step and M-step.
    fn step(&mut self, active: &[bool]) -> Result<Vec<f64>, DynamicError> {
        let (objective, iterate) = (self.search.objective, &self.search.iterate);
        let mut step = vec![0.0; active.len()];
        for s in (0..active.len()).filter(|&s| active[s]) {
            if let Way::Level { degree, count } = self.ways[s] {
                step[s] = level_step(&objective.coordinates[s], iterate, s, (degree, count));
            }
        }
        let smooth: Vec<bool> = (0..active.len()).map(|s| active[s] && self.ways[s] == Way::Expected).collect();
        if smooth.contains(&true) {
            let complete = objective.complete(iterate)?;
            let begun = objective.moved(&iterate.values, &step, 1.0);
            let reached =
                self.ascent.maximise(&|values| objective.expected(&complete, values), begun, &smooth, objective);
            for s in (0..active.len()).filter(|&s| smooth[s]) {
                step[s] = objective.coordinates[s].of_value(reached[s])
                    - objective.coordinates[s].of_value(iterate.values[s]);
            }
        }
        let direct: Vec<bool> = (0..active.len()).map(|s| active[s] && self.ways[s] == Way::Likelihood).collect();
        if direct.contains(&true) {
            let joint = JointInformation::new(objective, iterate, &direct, false);
            let zero_gradient = DVector::zeros(iterate.estimate.state.newton_iterate.tangent.gradient.len());
            let newton = joint.step(&iterate.gradient, &zero_gradient, 0.0);
            (0..active.len()).filter(|&s| direct[s]).for_each(|s| step[s] = newton.alpha[s]);
        }
        Ok(step)
    }
}

fn zeros(iterate: &ProfilePoint) -> Vec<usize> {
    (0..iterate.values.len()).filter(|&s| iterate.values[s] == 0.0).collect()
}

/// σ^d_new = σ^d (1 + (2/dn) ∂ℓ/∂ln σ), as a step of the coordinate.
fn level_step(coordinate: &crate::Coordinate, iterate: &ProfilePoint, s: usize, (degree, count): (f64, f64)) -> f64 {
    let value = iterate.values[s];
    let score = if coordinate.log { iterate.gradient[s] } else { iterate.gradient[s] * value };
    if count == 0.0 || value == 0.0 {
        return 0.0;
    }
    // E[v²] is positive, except for rounding
    let factor = (1.0 + 2.0 * score / (degree * count)).max(1e-6).ln() / degree;
    let new = coordinate.moved(value, if coordinate.log { factor } else { value * factor.exp_m1() });
    coordinate.of_value(new) - coordinate.of_value(value)
}
