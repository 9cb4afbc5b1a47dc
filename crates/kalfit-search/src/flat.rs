//! Directions in α along which ℓ, maximised over (μ, Σ), hardly changes: not at all for a factor k of a state with free
//! mean and variance, and little for the coefficient of a column of 10⁴ ± 1 together with a state with a free mean.
//!
//! The information comes from differences of gradients: rounding hides so small a curvature, and gives a flat direction
//! a curvature of either sign. So ℓ itself is evaluated one step to each side: the fall of ℓ gives the curvature, and
//! where the curvature is far below the resolution of differences, the direction is flat.

use crate::joint::{InformationDirection, KnownEigenvalue};
use crate::profile_likelihood::ProfileLikelihood;
use crate::ridge::{Ridge, RidgeStart};
use crate::{Coordinate, DynamicFit};
use kalfit_model::Population;

/// Length of a step: of a logarithm, or of another value relative to the size of that value.
const STEP: f64 = 0.1;
/// Fall of ℓ over a step, in units of the rounding of ℓ, below which the step is lengthened.
const FALL_IN_ROUNDINGS: f64 = 100.0;
/// Rounding of ℓ, relative to |ℓ|.
const ROUNDING: f64 = 1e-13;
/// Longest step, in standard errors.
const MAX_STANDARD_ERRORS: f64 = 0.1;
/// Curvature along a direction, relative to the sum over single coordinates, that differences cannot distinguish from
/// zero.
const UNRESOLVED_CURVATURE: f64 = 1e-8;
/// Part of the expected curvature up to which a direction is flat.
const FLAT_PART: f64 = 0.05;
/// Share of α in a direction above which the share does not come from rounding: shares are small where a mean grows
/// almost without bound together with a time constant.
const MIN_SHARE: f64 = 1e-6;
/// Standard error above which a logarithm counts as undetermined.
const UNKNOWN_ERROR: f64 = 2.0;
/// Change of ℓ below which the change may be rounding, where measurements are nearly exact.
const MIN_VISIBLE_CHANGE: f64 = 1e-6;
/// Largest part of a variance that may come from other directions: above this part, ℓ hardly determines the examined
/// direction.
const MAX_OTHER_VARIANCE: f64 = 0.5;
/// Distance from the top of a ridge, in standard errors, within which α is at the top.
const TOP_DISTANCE: f64 = 3e-2;
/// Ratio of the falls of ℓ to the two sides below which ℓ falls evenly.
const MAX_FALL_RATIO: f64 = 2.0;
/// Relative difference above which the curvature from the fall of ℓ replaces the curvature from differences, along a
/// direction that is not faint.
const MIN_DEVIATION: f64 = 0.5;
/// Number of directions above which none is examined: each costs up to [`MAX_STEPS`] runs of the filters to either side.
const MAX_DIRECTIONS: usize = 8;
/// Maximal number of steps to the top of a ridge.
const MAX_STEPS: usize = 16;

/// Eigenvalues of the information along faint or doubtful directions, from ℓ itself.
pub fn examined_eigenvalues(objective: &ProfileLikelihood<'_>, fit: &DynamicFit) -> Vec<KnownEigenvalue> {
    let is_looked_at = |direction: &InformationDirection| match direction.is_of_alpha() {
        true => is_doubtful(objective, direction),
        false => direction.share > MIN_SHARE && direction.may_be_rounding(),
    };
    let faint: Vec<InformationDirection> = fit.joint.directions().into_iter().filter(is_looked_at).collect();
    if faint.len() > MAX_DIRECTIONS {
        return Vec::new();
    }
    faint.iter().filter_map(|direction| eigenvalue_along(objective, fit, direction)).collect()
}

/// The eigenvalue along a direction, from values of ℓ; `None` where the eigenvalue from differences is better.
///
/// ```text
/// 1/p = r + v²/λ      p: curvature of ℓ in one component of α, maximised over all else
///                     v: that component of the direction      r: variance of the component from other directions
/// ```
fn eigenvalue_along(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    direction: &InformationDirection,
) -> Option<KnownEigenvalue> {
    if let Some(curvature) = curvature_by_gradients(objective, fit, direction) {
        return Some(direction.known_eigenvalue(curvature));
    }
    let beside = fit.joint.other_variances(direction)?;
    let Fall { length, least, mean, is_even, expected_curvature } = fall(objective, fit, direction)?;
    let is_visible = |curvature: f64| 0.5 * curvature * length * length >= MIN_VISIBLE_CHANGE;
    if least <= FLAT_PART * expected_curvature && least * beside[0] <= FLAT_PART && is_visible(beside[0].recip()) {
        return Some(direction.known_eigenvalue(0.0));
    }
    let curvature = of_direction(mean, beside).filter(|_| is_even && is_visible(mean) && direction.is_of_alpha())?;
    let is_other = (curvature - direction.curvature).abs() > MIN_DEVIATION * direction.curvature.abs();
    (direction.is_faint() || is_other).then(|| direction.known_eigenvalue(curvature))
}

/// The curvature along a direction, from gradients to both sides of a ridge; `None` unless the direction is along a
/// ridge and α is at the top of the ridge.
fn curvature_by_gradients(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    direction: &InformationDirection,
) -> Option<f64> {
    if !direction.may_be_rounding() {
        return None;
    }
    let near = Population::from(&fit.estimate);
    let start = RidgeStart { values: &fit.sought, near: &near, value: fit.estimate.log_likelihood, joint: &fit.joint };
    let ridge = Ridge::new(objective, start, direction).filter(|ridge| ridge.score() < TOP_DISTANCE)?;
    of_direction(ridge.curvature, fit.joint.variances_of_most(direction)?)
}

/// The curvature along a direction, from v²/λ = 1/p - r; `None` where α varies as much along other directions, be they
/// faint or resolved by differences.
fn of_direction(curvature: f64, [by_known, by_faint]: [f64; 2]) -> Option<f64> {
    let is_its_own = curvature * by_known < MAX_OTHER_VARIANCE && curvature * by_faint < MAX_OTHER_VARIANCE;
    is_its_own.then(|| (curvature.recip() - by_known).recip())
}

/// Whether ℓ hardly curves along a direction, or too little to determine a logarithm: the curvature may then be too
/// small for differences to resolve.
fn is_doubtful(objective: &ProfileLikelihood<'_>, direction: &InformationDirection) -> bool {
    let is_lost = |(part, coordinate): (&f64, &Coordinate)| {
        coordinate.log && part.abs() > UNKNOWN_ERROR * direction.curvature.abs().sqrt()
    };
    direction.is_faint() || direction.alpha.iter().zip(&objective.coordinates).any(is_lost)
}

/// Fall of ℓ to both sides along a direction, expressed as curvatures.
struct Fall {
    length: f64,
    least: f64,
    mean: f64,
    /// Whether ℓ falls by about as much to one side as to the other, as a parabola does.
    is_even: bool,
    /// Curvature from differences, or the least curvature that differences resolve, if larger.
    expected_curvature: f64,
}

/// Fall of ℓ along a direction; `None` where ℓ is not defined on both sides.
fn fall(objective: &ProfileLikelihood<'_>, fit: &DynamicFit, direction: &InformationDirection) -> Option<Fall> {
    let value_at_fit = fit.estimate.log_likelihood;
    let expected_curvature = direction.curvature.abs().max(UNRESOLVED_CURVATURE * own_curvature(fit, direction));
    let length = length(objective, fit, direction, expected_curvature, value_at_fit);
    let [one, other] = [length, -length].map(|length| {
        let values = objective.moved(&fit.sought, &direction.alpha, length);
        let value = value_on_ridge(objective, fit, (&direction.alpha, values))?;
        Some(2.0 * (value_at_fit - value) / (length * length))
    });
    let (one, other) = (one?, other?);
    // a ridge may end on one side, where a variance reaches zero
    let least = one.abs().min(other.abs());
    let is_even = one > 0.0 && other > 0.0 && one.max(other) < MAX_FALL_RATIO * least;
    Some(Fall { length, least, mean: 0.5 * (one + other), is_even, expected_curvature })
}

/// ℓ at the top of a possible ridge along a direction, near given values: α moves on across the direction, because a
/// ridge in several values is curved.
fn value_on_ridge(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    (along, mut values): (&[f64], Vec<f64>),
) -> Option<f64> {
    let near = Population::from(&fit.estimate);
    let mut best: Option<f64> = None;
    for _ in 0..MAX_STEPS {
        let here = objective.solve(&values, Some(&near)).ok().filter(|here| here.value().is_finite())?;
        let is_still = best.is_some_and(|best| here.value() <= best + ROUNDING * best.abs());
        best = Some(best.map_or(here.value(), |best| best.max(here.value())));
        let Some(step) = fit.joint.onto_ridge(along, &here.gradient).filter(|_| !is_still) else { break };
        values = objective.moved(&values, &step, 1.0);
    }
    best
}

/// Σ |curvature of ℓ in coordinate s of α| × (component s of the direction)², everything else fixed.
fn own_curvature(fit: &DynamicFit, direction: &InformationDirection) -> f64 {
    let of = |(s, part): (usize, &f64)| fit.joint.curvature(s).abs() * part * part;
    direction.alpha.iter().enumerate().map(of).sum()
}

fn length(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    direction: &InformationDirection,
    curvature: f64,
    value_at_fit: f64,
) -> f64 {
    let reach = |((part, coordinate), value): ((&f64, &Coordinate), &f64)| {
        let size = if coordinate.log { 1.0 } else { value.abs() };
        STEP * size / part.abs()
    };
    let moving = direction.alpha.iter().zip(&objective.coordinates).zip(&fit.sought).filter(|((d, _), _)| **d != 0.0);
    let short = moving.map(reach).fold(f64::INFINITY, f64::min);
    let seen = (2.0 * FALL_IN_ROUNDINGS * ROUNDING * value_at_fit.abs().max(1.0) / curvature).sqrt();
    short.max(seen).min(MAX_STANDARD_ERRORS / curvature.sqrt())
}
