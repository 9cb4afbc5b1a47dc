//! 95 % intervals: Wald's, on scales where the law is nearly normal, and by profile likelihood.

use rayon::prelude::*;

use crate::estimate::{Criterion, Estimate, Point};
use crate::infer::held::{Held, HeldMaximum, Holder};
use crate::infer::holdable::Holdable;
use crate::infer::information::{Free, Uncertainty};
use crate::linalg::elements::Elements;

/// Normal quantile of 97.5 %: an interval holds the values whose ℓ_max is within half its square of the maximum.
const QUANTILE: f64 = 1.959_963_984_540_054;
/// Evaluations for one end.
const TRIES: usize = 40;

/// How intervals are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum IntervalKind {
    /// From standard errors: of means as they are, of standard deviations in logarithms, of correlations in Fisher's z.
    #[default]
    Wald,
    /// Values that the likelihood-ratio test at 5 % does not reject.
    Profile,
}

/// Lower and upper end; an end is `None` where no limit was found.
pub type Interval = Option<[Option<f64>; 2]>;

/// 95 % intervals in the user's units. `None` where a quantity is fixed or not identified.
#[derive(Debug, Clone, PartialEq)]
pub struct Intervals {
    /// How they were made.
    pub kind: IntervalKind,
    /// How many come from standard errors where profiles were asked for, those of means under the restricted likelihood apart.
    pub unprofiled: usize,
    /// Of μ (p).
    pub mean: Vec<Interval>,
    /// Of the regression coefficients.
    pub coefficients: Vec<Interval>,
    /// Of the standard deviations (p).
    pub std_dev: Vec<Interval>,
    /// Of Σ (p × p); of the variances, the squares of those of the standard deviations.
    pub covariance: Vec<Vec<Interval>>,
    /// Of the correlations (p × p).
    pub correlation: Vec<Vec<Interval>>,
}

impl Intervals {
    fn none(kind: IntervalKind, p: usize, coefficients: usize) -> Intervals {
        Intervals {
            kind,
            unprofiled: 0,
            mean: vec![None; p],
            coefficients: vec![None; coefficients],
            std_dev: vec![None; p],
            covariance: vec![vec![None; p]; p],
            correlation: vec![vec![None; p]; p],
        }
    }

    /// The interval of a quantity.
    pub(crate) fn of(&self, what: Holdable) -> Interval {
        match what {
            Holdable::Mean(i) => self.mean[i],
            Holdable::Coefficient(c) => self.coefficients[c],
            Holdable::StdDev(i) => self.std_dev[i],
            Holdable::Covariance(i, j) => self.covariance[i][j],
            Holdable::Correlation(i, j) => self.correlation[i][j],
        }
    }

    pub(crate) fn set(&mut self, what: Holdable, interval: Interval) {
        let mut both = |matrix: fn(&mut Intervals) -> &mut Vec<Vec<Interval>>, i: usize, j: usize| {
            matrix(self)[i][j] = interval;
            matrix(self)[j][i] = interval;
        };
        match what {
            Holdable::Covariance(i, j) => both(|s| &mut s.covariance, i, j),
            Holdable::Correlation(i, j) => both(|s| &mut s.correlation, i, j),
            Holdable::Mean(i) => self.mean[i] = interval,
            Holdable::Coefficient(c) => self.coefficients[c] = interval,
            Holdable::StdDev(i) => {
                self.std_dev[i] = interval;
                self.covariance[i][i] = interval.map(|ends| ends.map(|end| end.map(|s| s * s)));
            }
        }
    }
}

/// Intervals from standard errors.
pub fn wald(estimate: &Estimate, uncertainty: &Uncertainty) -> Intervals {
    let p = estimate.mean.len();
    let mut found = Intervals::none(IntervalKind::Wald, p, estimate.coefficients.len());
    let elements = &estimate.state.problem.covariance.elements;
    for what in quantities(elements, estimate.coefficients.len()) {
        let value = value(estimate, what);
        let interval = uncertainty.of(what).zip(value).and_then(|(e, x)| {
            let around = |centre: f64, e: f64| [centre - QUANTILE * e, centre + QUANTILE * e];
            let ends = match what {
                Holdable::StdDev(_) if x > 0.0 => around(x.ln(), e / x).map(f64::exp),
                Holdable::Correlation(..) if x.abs() < 1.0 => around(x.atanh(), e / (1.0 - x * x)).map(f64::tanh),
                Holdable::StdDev(_) | Holdable::Correlation(..) => return None,
                _ => around(x, e),
            };
            ends.iter().all(|end| end.is_finite()).then(|| ends.map(Some))
        });
        found.set(what, interval);
    }
    found
}

/// Intervals by profile likelihood; of means under the restricted likelihood, which has no profile of them, Wald's. A quantity on the boundary has one too; one for which no certified maximum is found near
/// an end has none there.
pub fn profile(estimate: &Estimate, uncertainty: &Uncertainty, free: &Free) -> Intervals {
    let p = estimate.mean.len();
    let mut found = Intervals::none(IntervalKind::Profile, p, estimate.coefficients.len());
    if estimate.criterion == Criterion::Reml {
        let wald = wald(estimate, uncertainty);
        found.mean = wald.mean;
        found.coefficients = wald.coefficients;
    }
    let wanted = profiled(estimate, free);
    let holder = Holder::new(&estimate.state);
    found.follow((estimate, uncertainty), &wanted, &holder, &estimate.state.newton_iterate.point);
    found
}

/// Free quantities that have a profile: under the restricted likelihood means have none.
pub(crate) fn profiled(estimate: &Estimate, free: &Free) -> Vec<Holdable> {
    let elements = &estimate.state.problem.covariance.elements;
    let of_mean = |what: &Holdable| matches!(what, Holdable::Mean(_) | Holdable::Coefficient(_));
    let has_profile = |what: &Holdable| estimate.criterion == Criterion::Ml || !of_mean(what);
    let all = quantities(elements, estimate.coefficients.len()).into_iter();
    all.filter(|what| is_free(free, estimate, *what) && has_profile(what)).collect()
}

impl Intervals {
    /// Puts the profile intervals of some quantities in place; `start` is the maximum.
    pub(crate) fn follow<H: Holds<What = Holdable>>(
        &mut self,
        (estimate, uncertainty): (&Estimate, &Uncertainty),
        wanted: &[Holdable],
        holder: &H,
        start: &H::Near,
    ) {
        let ends: Vec<Interval> = wanted
            .par_iter()
            .map(|&what| {
                let centre = value(estimate, what)?;
                let step = uncertainty.of(what).map_or_else(|| guess(estimate, what), |e| QUANTILE * e);
                let maximum = estimate.state.newton_iterate.local.value;
                let profile = Profile { holder, what, centre, maximum, quantile: QUANTILE, limits: limits(what) };
                Some([profile.end(start, -step), profile.end(start, step)])
            })
            .collect();
        wanted.iter().zip(ends).for_each(|(&what, interval)| self.set(what, interval));
    }
}

pub(crate) fn quantities(elements: &Elements, coefficients: usize) -> Vec<Holdable> {
    let p = elements.states();
    let below = || elements.all().filter(|(i, j)| i != j);
    let mut all = Vec::with_capacity(2 * p + coefficients + 2 * elements.count());
    all.extend((0..p).map(Holdable::Mean));
    all.extend((0..coefficients).map(Holdable::Coefficient));
    all.extend((0..p).map(Holdable::StdDev));
    all.extend(below().map(|(i, j)| Holdable::Covariance(i, j)));
    all.extend(below().map(|(i, j)| Holdable::Correlation(i, j)));
    all
}

fn is_free(free: &Free, estimate: &Estimate, what: Holdable) -> bool {
    match what {
        Holdable::Mean(i) => free.mean[i],
        Holdable::Coefficient(_) => true,
        Holdable::StdDev(i) => free.covariance[i][i],
        Holdable::Covariance(i, j) => free.covariance[i][j],
        Holdable::Correlation(i, j) => free.correlation[i][j] && value(estimate, what).is_some(),
    }
}

pub(crate) fn value(estimate: &Estimate, what: Holdable) -> Option<f64> {
    what.value(&estimate.mean, &estimate.coefficients, &estimate.covariance)
}

/// A first step for a quantity of Σ without a standard error, from Σ_j W_j alone.
fn guess(estimate: &Estimate, what: Holdable) -> f64 {
    let state = &estimate.state;
    let (scale, weight) = (&state.problem.classes.frame.scale, &state.newton_iterate.local.weight);
    let tests = state.problem.classes.tests as f64;
    let unit = |i: usize| {
        let own = weight[(i, i)];
        scale[i] * if own > 0.0 { ((8.0 * tests).sqrt() / own).sqrt() } else { 1.0 }
    };
    match what {
        Holdable::Mean(i) | Holdable::StdDev(i) => unit(i),
        Holdable::Covariance(i, j) => unit(i) * unit(j),
        Holdable::Correlation(..) => 0.5,
        Holdable::Coefficient(_) => 1.0,
    }
}

/// Finds maxima with one quantity held.
pub(crate) trait Holds: Sync {
    /// The root of the deviance is found to this.
    const PRECISION: f64;
    /// What can be held.
    type What: Copy + Sync;
    /// Where a search for a maximum begins: a maximum nearby.
    type Near: Clone + Sync;
    /// The maximum with `what` held at `value`. `None` where no certified one is found.
    fn held(&self, what: Self::What, value: f64, near: &Self::Near) -> Option<Held<Self::Near>>;
}

impl Holds for Holder<'_> {
    const PRECISION: f64 = 1e-6;
    type What = Holdable;
    type Near = Point;

    fn held(&self, what: Holdable, value: f64, near: &Point) -> Option<Held<Point>> {
        self.maximum(what, value, near).map(HeldMaximum::point)
    }
}

/// Values beyond which a quantity cannot go, below and above.
fn limits(what: Holdable) -> [Option<f64>; 2] {
    match what {
        Holdable::StdDev(_) => [Some(0.0), None],
        Holdable::Correlation(..) => [Some(-1.0), Some(1.0)],
        _ => [None; 2],
    }
}

/// The profile of one quantity.
pub(crate) struct Profile<'a, H: Holds> {
    pub(crate) holder: &'a H,
    pub(crate) what: H::What,
    /// Its estimate.
    pub(crate) centre: f64,
    /// ℓ there.
    pub(crate) maximum: f64,
    /// An interval holds the values whose ℓ_max is within half the square of this of the maximum.
    pub(crate) quantile: f64,
    /// Values beyond which the quantity cannot go.
    pub(crate) limits: [Option<f64>; 2],
}

impl<H: Holds> Profile<'_, H> {
    /// Both ends, a first step to each side of this length; `None` where one is not found.
    pub(crate) fn ends(&self, start: &H::Near, step: f64) -> Option<[f64; 2]> {
        Some([self.end(start, -step)?, self.end(start, step)?])
    }

    /// ζ = √(2(ℓ_max - ℓ_max(x))) and its derivative away from the centre.
    fn root(&self, x: f64, near: &H::Near, sign: f64) -> Option<(f64, f64, Held<H::Near>)> {
        let held = self.holder.held(self.what, x, near)?;
        let zeta = (2.0 * (self.maximum - held.value)).max(0.0).sqrt();
        let slope = if zeta > 0.0 { -sign * held.slope / zeta } else { 0.0 };
        Some((zeta, slope, held))
    }

    /// Where ζ reaches the quantile: Newton's method with the exact slope, which the multiplier gives, inside a bracket.
    pub(crate) fn end(&self, start: &H::Near, step: f64) -> Option<f64> {
        let sign = step.signum();
        let limit = self.limits[usize::from(sign > 0.0)];
        if limit.is_some_and(|limit| sign * (limit - self.centre) <= 1e-12) {
            return limit;
        }
        let mut near = start.clone();
        let (mut below, mut above) = (self.centre, f64::INFINITY * sign);
        let mut x = self.inside(self.centre + step, self.centre, limit, sign);
        for _ in 0..TRIES {
            let Some((zeta, slope, held)) = self.root(x, &near, sign) else {
                above = x; // no certified maximum there: nearer
                x = 0.5 * (below + x);
                continue;
            };
            if (zeta - self.quantile).abs() < H::PRECISION {
                return Some(x);
            }
            if zeta < self.quantile {
                below = x;
                near = held.near;
                if limit.is_some_and(|l| (l - x).abs() <= 1e-4 * (l - self.centre).abs()) {
                    return limit;
                }
                if (x - self.centre).abs() > 1e7 * step.abs() {
                    return None;
                }
            } else {
                above = x;
            }
            x = self.next(x, zeta, slope, (below, above), step);
            x = self.inside(x, below, limit, sign);
        }
        None
    }

    fn next(&self, x: f64, zeta: f64, slope: f64, (below, above): (f64, f64), step: f64) -> f64 {
        let sign = step.signum();
        let newton = x + sign * (self.quantile - zeta) / slope;
        let farthest = below + 3.0 * sign * (below - self.centre).abs().max(step.abs());
        let newton = if slope > 0.0 && newton.is_finite() { newton } else { farthest };
        let newton = if above.is_finite() || sign * (newton - farthest) <= 0.0 { newton } else { farthest };
        let inside = sign * (newton - below) > 0.0 && sign * (above - newton) > 0.0;
        match (inside, above.is_finite()) {
            (true, _) => newton,
            (false, true) => 0.5 * (below + above),
            (false, false) => farthest,
        }
    }

    /// Short of the limit: nine tenths of the way there.
    fn inside(&self, x: f64, below: f64, limit: Option<f64>, sign: f64) -> f64 {
        match limit {
            Some(limit) if sign * (x - limit) >= 0.0 => below + 0.9 * (limit - below),
            _ => x,
        }
    }
}
