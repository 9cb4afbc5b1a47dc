//! Directions in α along which ℓ hardly changes once (μ, Σ) follow: not at all, as of a factor k of a state whose mean and variance are
//! free, or little, as of what multiplies a column of 10⁴ ± 1 beside a state with a free mean.
//!
//! The information comes from differences of gradients, whose rounding hides so small a curvature, and leaves one, of either sign, of a flat
//! direction. So ℓ is looked at itself, a step to either side: what it falls by is the curvature, and where that is next to nothing of what
//! even differences could tell, the direction is flat.

use crate::joint::{InformationDirection, KnownEigenvalue};
use crate::profile_likelihood::ProfileLikelihood;
use crate::ridge::{Ridge, RidgeStart};
use crate::{Coordinate, DynamicFit};
use kalfit_model::Population;

/// So far a step goes, in logarithms and in parts of a value,
const STEP: f64 = 0.1;
/// or so far that ℓ would fall by this many times its rounding,
const SEEN: f64 = 100.0;
/// which is this part of it, but not farther than this many standard errors.
const ROUNDING: f64 = 1e-13;
const FARTHEST: f64 = 0.1;
/// Curvature, in units of each coordinate's own, that differences cannot tell from none.
const UNSURE: f64 = 1e-8;
/// ℓ falls by less than this part of what was promised.
const PART: f64 = 0.05;
/// A share of α in a direction that is not made of rounding: of a mean that all but grows without bound as a time constant does it may be this
/// small.
const TRACE: f64 = 1e-6;
/// A logarithm with a larger standard error than this is all but unknown.
const LOST: f64 = 2.0;
/// Less of ℓ than this may be rounding beside measurements that are all but exact.
const VISIBLE: f64 = 1e-6;
/// The variance by other directions is no more than this part of what ℓ tells, or ℓ says little of this one.
const MOSTLY: f64 = 0.5;
/// Where gradients tell how a ridge bends, this is its top, in standard errors.
const TOP: f64 = 3e-2;
/// ℓ falls alike where it falls to one side by less than this many times what it falls by to the other.
const EVEN: f64 = 2.0;
/// What ℓ falls by belies differences that are not faint where it is another curvature by more than this part.
const OTHER: f64 = 0.5;
/// Of more directions, which cost up to [`STEPS`] runs of the filters to either side, none is looked at.
const MOST: usize = 8;
const STEPS: usize = 16;

/// What ℓ says of the information along directions that are faint or doubtful.
pub fn looked_at(objective: &ProfileLikelihood<'_>, fit: &DynamicFit) -> Vec<KnownEigenvalue> {
    let is_looked_at = |direction: &InformationDirection| match direction.is_of_alpha() {
        true => is_doubtful(objective, direction),
        false => direction.share > TRACE && direction.is_shaky(),
    };
    let faint: Vec<InformationDirection> = fit.joint.directions().into_iter().filter(is_looked_at).collect();
    if faint.len() > MOST {
        return Vec::new();
    }
    faint.iter().filter_map(|direction| told(objective, fit, direction)).collect()
}

/// What ℓ says of the information along a direction where that is anything that differences do not know.
///
/// ```text
/// 1/p = r + v²/λ      p the curvature of ℓ where a component of α moves and all else follows, v the direction's part of it,
///                     r the variance that it has by the other directions
/// ```
fn told(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    direction: &InformationDirection,
) -> Option<KnownEigenvalue> {
    if let Some(curvature) = told_by_gradients(objective, fit, direction) {
        return Some(direction.with(curvature));
    }
    let beside = fit.joint.variances_beside(direction)?;
    let Fall { length, least, mean, is_even, promised } = fall(objective, fit, direction)?;
    let is_visible = |curvature: f64| 0.5 * curvature * length * length >= VISIBLE;
    if least <= PART * promised && least * beside[0] <= PART && is_visible(beside[0].recip()) {
        return Some(direction.with(0.0));
    }
    let curvature = of_direction(mean, beside).filter(|_| is_even && is_visible(mean) && direction.is_of_alpha())?;
    let is_other = (curvature - direction.curvature).abs() > OTHER * direction.curvature.abs();
    (direction.is_faint() || is_other).then(|| direction.with(curvature))
}

/// The same where gradients tell how a ridge along it bends, and α is at its top.
fn told_by_gradients(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    direction: &InformationDirection,
) -> Option<f64> {
    if !direction.is_shaky() {
        return None;
    }
    let near = Population::from(&fit.estimate);
    let start = RidgeStart { values: &fit.sought, near: &near, value: fit.estimate.log_likelihood, joint: &fit.joint };
    let ridge = Ridge::new(objective, start, direction).filter(|ridge| ridge.score() < TOP)?;
    of_direction(ridge.curvature, fit.joint.variances_of_most(direction)?)
}

/// v²/λ is 1/p - r as curvature; `None` where α varies as much by other directions, those that differences know or faint ones.
fn of_direction(curvature: f64, [by_known, by_faint]: [f64; 2]) -> Option<f64> {
    let is_its_own = curvature * by_known < MOSTLY && curvature * by_faint < MOSTLY;
    is_its_own.then(|| (curvature.recip() - by_known).recip())
}

/// ℓ hardly curves along it, or not enough to tell a logarithm: its own curvature may then be so small that differences say nothing of it.
fn is_doubtful(objective: &ProfileLikelihood<'_>, direction: &InformationDirection) -> bool {
    let is_lost = |(part, coordinate): (&f64, &Coordinate)| {
        coordinate.log && part.abs() > LOST * direction.curvature.abs().sqrt()
    };
    direction.is_faint() || direction.alpha.iter().zip(&objective.coordinates).any(is_lost)
}

/// How ℓ falls to both sides along a direction, as curvatures.
struct Fall {
    length: f64,
    least: f64,
    mean: f64,
    /// To both sides alike, as along a parabola.
    is_even: bool,
    /// What differences say, or the least that they could tell.
    promised: f64,
}

/// `None` where ℓ is not defined to both sides.
fn fall(objective: &ProfileLikelihood<'_>, fit: &DynamicFit, direction: &InformationDirection) -> Option<Fall> {
    let home = fit.estimate.log_likelihood;
    let promised = direction.curvature.abs().max(UNSURE * own_curvature(fit, direction));
    let length = length(objective, fit, direction, promised, home);
    let [one, other] = [length, -length].map(|length| {
        let values = objective.moved(&fit.sought, &direction.alpha, length);
        let value = on_ridge(objective, fit, (&direction.alpha, values))?;
        Some(2.0 * (home - value) / (length * length))
    });
    let (one, other) = (one?, other?);
    // a ridge may end on one side, where a variance comes to zero
    let least = one.abs().min(other.abs());
    let is_even = one > 0.0 && other > 0.0 && one.max(other) < EVEN * least;
    Some(Fall { length, least, mean: 0.5 * (one + other), is_even, promised })
}

/// ℓ beside some values, on the top of what may be a ridge along a direction: α goes on across it, because a ridge of several values is curved.
fn on_ridge(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    (along, mut values): (&[f64], Vec<f64>),
) -> Option<f64> {
    let near = Population::from(&fit.estimate);
    let mut best: Option<f64> = None;
    for _ in 0..STEPS {
        let here = objective.solve(&values, Some(&near)).ok().filter(|here| here.value().is_finite())?;
        let is_still = best.is_some_and(|best| here.value() <= best + ROUNDING * best.abs());
        best = Some(best.map_or(here.value(), |best| best.max(here.value())));
        let Some(step) = fit.joint.onto_ridge(along, &here.gradient).filter(|_| !is_still) else { break };
        values = objective.moved(&values, &step, 1.0);
    }
    best
}

/// The curvature along a direction in α alone, where nothing follows.
fn own_curvature(fit: &DynamicFit, direction: &InformationDirection) -> f64 {
    let of = |(s, part): (usize, &f64)| fit.joint.curvature(s).abs() * part * part;
    direction.alpha.iter().enumerate().map(of).sum()
}

fn length(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    direction: &InformationDirection,
    curvature: f64,
    home: f64,
) -> f64 {
    let reach = |((part, coordinate), value): ((&f64, &Coordinate), &f64)| {
        let size = if coordinate.log { 1.0 } else { value.abs() };
        STEP * size / part.abs()
    };
    let moving = direction.alpha.iter().zip(&objective.coordinates).zip(&fit.sought).filter(|((d, _), _)| **d != 0.0);
    let short = moving.map(reach).fold(f64::INFINITY, f64::min);
    let seen = (2.0 * SEEN * ROUNDING * home.abs().max(1.0) / curvature).sqrt();
    short.max(seen).min(FARTHEST / curvature.sqrt())
}
