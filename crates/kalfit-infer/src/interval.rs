//! 95 % intervals: Wald intervals, on scales where the law is nearly normal, and intervals by profile likelihood.

use rayon::prelude::*;

use crate::ends::{Holds, Profile};
use crate::held::{Held, HeldMaximum, Holder};
use crate::holdable::{Holdable, Quantities};
use crate::information::Uncertainty;
use crate::progress::SharedProgress;
use crate::ratio::calibrated;
use kalfit_algebra::elements::Elements;
use kalfit_estimate::{Criterion, Estimate, Point};
use kalfit_filter::reduce::Reductions;

/// Normal quantile q of 97.5 %: a profile interval holds the values with ℓ_max at most ½q² below the maximum.
pub(crate) const QUANTILE: f64 = 1.959_963_984_540_054;

/// Method of the intervals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum IntervalKind {
    /// By profile likelihood under the restricted likelihood with at most [`FEW_UNITS`] independent tests or units, where
    /// that takes about a second; else from standard errors.
    #[default]
    Auto,
    /// From standard errors: symmetric in the logarithm of a standard deviation, in Fisher's z of a correlation, and in
    /// the value of any other quantity.
    Wald,
    /// By profile likelihood: values that the likelihood-ratio test at 5 % does not reject.
    Profile,
    /// By profile likelihood, with the quantiles of the ratios in ensembles drawn from the estimate in place of that of χ².
    /// For known α.
    Bootstrap,
}

/// Number of independent tests or units up to which profiles are the default: with more, intervals from standard errors
/// of logarithms hold within 1 % of their level (theory §14).
pub const FEW_UNITS: usize = 50;
/// Maximal number of rows × profiles where α is free: a profile takes some thirty filter runs, and 10⁵ rows a third of a
/// millisecond for each.
const CHEAP_ROWS: usize = 100_000;
/// Maximal number of elements of Σ that have profiles by default, as for free α.
const FEW_QUANTITIES: usize = 60;

/// Whether an estimate is from few units that are here, and of a Σ of few elements: what is done with few units is then
/// quick.
pub fn has_few_units(estimate: &Estimate, tests: usize) -> bool {
    if estimate.grouping().is_some_and(|grouping| grouping.is_crossed()) {
        return false; // each point of a profile is a search in one system of all tests
    }
    let units = estimate.grouping().map_or(tests, |grouping| grouping.groups(grouping.depth() - 1).len());
    let problem = &estimate.state.problem;
    let is_here = problem.classes.remote.is_none();
    is_here && units <= FEW_UNITS && problem.covariance.elements.count() <= FEW_QUANTITIES
}

impl IntervalKind {
    /// The method without [`IntervalKind::Auto`]; `rows`: rows that a run of the filters takes, zero where profiles need
    /// no run.
    pub(crate) fn resolved(self, estimate: &Estimate, tests: usize, rows: usize) -> IntervalKind {
        if self != IntervalKind::Auto {
            return self;
        }
        let quantities = estimate.state.problem.covariance.elements.count();
        // with groups and free α a profile of 3 states took 100 s, where Σ of the groups is nearly singular
        let is_slow = estimate.grouping().is_some() && rows > 0;
        let is_cheap = !is_slow && quantities * rows <= CHEAP_ROWS;
        let is_few = estimate.criterion == Criterion::Reml && has_few_units(estimate, tests);
        if is_few && is_cheap { IntervalKind::Profile } else { IntervalKind::Wald }
    }
}

pub use kalfit_search::Interval;

/// 95 % intervals in the user's units. `None` where a quantity is fixed or not identified.
#[derive(Debug, Clone, PartialEq)]
pub struct Intervals {
    /// Method by which the intervals are computed.
    pub kind: IntervalKind,
    /// Number of intervals from standard errors where profiles were requested, not counting intervals of means under
    /// the restricted likelihood.
    pub unprofiled: usize,
    /// Ends of each interval; the ends for a variance are the squared ends for the standard deviation.
    pub ends: Quantities<Interval>,
}

impl Intervals {
    fn none(kind: IntervalKind, estimate: &Estimate) -> Intervals {
        let ends = Quantities::all(None, estimate.mean.len(), estimate.coefficients.len());
        Intervals { kind, unprofiled: 0, ends }
    }

    pub(crate) fn set(&mut self, what: Holdable, interval: Interval) {
        self.ends.set(what, interval);
        if let Holdable::StdDev(i) = what {
            self.ends.covariance[i][i] = interval.map(|ends| ends.map(|end| end.map(|s| s * s)));
        }
    }
}

/// Intervals from standard errors.
pub fn wald(estimate: &Estimate, uncertainty: &Uncertainty) -> Intervals {
    let mut found = Intervals::none(IntervalKind::Wald, estimate);
    let elements = &estimate.state.problem.covariance.elements;
    for what in quantities(elements, estimate.coefficients.len()) {
        let value = value(estimate, what);
        let interval = uncertainty.errors.of(what).zip(value).and_then(|(e, x)| {
            let symmetric_ends = |centre: f64, e: f64| [centre - QUANTILE * e, centre + QUANTILE * e];
            let ends = match what {
                Holdable::StdDev(_) if x > 0.0 => symmetric_ends(x.ln(), e / x).map(f64::exp),
                Holdable::Correlation(..) if x.abs() < 1.0 => {
                    symmetric_ends(x.atanh(), e / (1.0 - x * x)).map(f64::tanh)
                }
                Holdable::StdDev(_) | Holdable::Correlation(..) => return None,
                _ => symmetric_ends(x, e),
            };
            ends.iter().all(|end| end.is_finite()).then(|| ends.map(Some))
        });
        found.set(what, interval);
    }
    found
}

/// Intervals by profile likelihood with quantiles from drawn ensembles; otherwise as [`profile`].
pub(super) fn bootstrap(
    estimate: &Estimate,
    reductions: &Reductions,
    (uncertainty, free): (&Uncertainty, &Quantities<bool>),
    progress: &SharedProgress<'_>,
) -> Option<Intervals> {
    let quantiles = calibrated::quantiles(estimate, reductions, &profiled(estimate, free), progress)?;
    let found = profile_with(estimate, uncertainty, free, &quantiles, progress)?;
    Some(Intervals { kind: IntervalKind::Bootstrap, ..found })
}

/// Intervals by profile likelihood, also of quantities on the boundary; Wald intervals of means under the restricted
/// likelihood, which has no profile of means. An end is `None` where the search finds no certified maximum near the
/// end; the result is `None` once `progress` stops.
pub(super) fn profile(
    estimate: &Estimate,
    uncertainty: &Uncertainty,
    free: &Quantities<bool>,
    progress: &SharedProgress<'_>,
) -> Option<Intervals> {
    profile_with(estimate, uncertainty, free, &vec![QUANTILE; profiled(estimate, free).len()], progress)
}

/// [`profile`] with a quantile for each profile.
fn profile_with(
    estimate: &Estimate,
    uncertainty: &Uncertainty,
    free: &Quantities<bool>,
    quantiles: &[f64],
    progress: &SharedProgress<'_>,
) -> Option<Intervals> {
    let mut found = Intervals::none(IntervalKind::Profile, estimate);
    if estimate.criterion == Criterion::Reml {
        let wald = wald(estimate, uncertainty).ends;
        (found.ends.mean, found.ends.coefficients) = (wald.mean, wald.coefficients);
    }
    let wanted = profiled(estimate, free);
    let holder = Holder::new(&estimate.state);
    found.compute_profiles(
        (estimate, uncertainty),
        (&wanted, quantiles),
        (&holder, &estimate.state.newton_iterate.point),
        progress,
    );
    (!progress.stops()).then_some(found)
}

/// Free quantities that have a profile; means have no profile under the restricted likelihood.
pub(crate) fn profiled(estimate: &Estimate, free: &Quantities<bool>) -> Vec<Holdable> {
    let elements = &estimate.state.problem.covariance.elements;
    let of_mean = |what: &Holdable| matches!(what, Holdable::Mean(_) | Holdable::Coefficient(_));
    let has_profile = |what: &Holdable| estimate.criterion == Criterion::Ml || !of_mean(what);
    let all = quantities(elements, estimate.coefficients.len()).into_iter();
    all.filter(|what| free.of(*what) && value(estimate, *what).is_some() && has_profile(what)).collect()
}

impl Intervals {
    /// Computes and stores the profile intervals of the quantities in `wanted`, with a quantile for each; `start` is the maximum.
    pub(crate) fn compute_profiles<H: Holds<What = Holdable>>(
        &mut self,
        (estimate, uncertainty): (&Estimate, &Uncertainty),
        (wanted, quantiles): (&[Holdable], &[f64]),
        (holder, start): (&H, &H::Near),
        progress: &SharedProgress<'_>,
    ) {
        let ends: Vec<Interval> = wanted
            .par_iter()
            .zip(quantiles)
            .map(|(&what, &quantile)| {
                let centre = value(estimate, what)?;
                let step = uncertainty.errors.of(what).map_or_else(|| first_step(estimate, what), |e| quantile * e);
                let maximum = estimate.state.newton_iterate.local.value;
                let (name, limits) = (progress.name(what), limits(what));
                let profile = Profile { holder, what, name, centre, maximum, quantile, limits, progress };
                Some([profile.end(start, -step), profile.end(start, step)])
            })
            .collect();
        wanted.iter().zip(ends).for_each(|(&what, interval)| self.set(what, interval));
    }
}

pub(crate) fn quantities(elements: &Elements, coefficients: usize) -> Vec<Holdable> {
    let p = elements.states();
    let off_diagonal = || elements.all().filter(|(i, j)| i != j);
    let mut all = Vec::with_capacity(2 * p + coefficients + 2 * elements.count());
    all.extend((0..p).map(Holdable::Mean));
    all.extend((0..coefficients).map(Holdable::Coefficient));
    all.extend((0..p).map(Holdable::StdDev));
    all.extend(off_diagonal().map(|(i, j)| Holdable::Covariance(i, j)));
    all.extend(off_diagonal().map(|(i, j)| Holdable::Correlation(i, j)));
    all
}

pub(crate) fn value(estimate: &Estimate, what: Holdable) -> Option<f64> {
    what.value(&estimate.mean, &estimate.coefficients, &estimate.covariance)
}

/// First step for a quantity without a standard error, from Σ_j W_j alone.
fn first_step(estimate: &Estimate, what: Holdable) -> f64 {
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

impl Holds for Holder<'_> {
    const PRECISION: f64 = 1e-6;
    type What = Holdable;
    type Near = Point;

    fn held(&self, what: Holdable, value: f64, near: &Point) -> Option<Held<Point>> {
        self.maximum(what, value, near).map(HeldMaximum::point)
    }
}

/// Lower and upper limit of a quantity.
fn limits(what: Holdable) -> [Option<f64>; 2] {
    match what {
        Holdable::StdDev(_) => [Some(0.0), None],
        Holdable::Correlation(..) => [Some(-1.0), Some(1.0)],
        _ => [None; 2],
    }
}
