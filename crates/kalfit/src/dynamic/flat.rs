//! Directions in α along which ℓ does not change once (μ, Σ) follow, as of a factor k of a state whose mean and variance are free.
//!
//! The information comes from differences of gradients, whose rounding leaves of a flat direction a small curvature, of either sign. So ℓ
//! is looked at itself, a step to either side: where it falls by next to nothing of what even that curvature promises, it is flat.

use crate::dynamic::joint::{FaintDirection, TAKES_PART};
use crate::dynamic::profile_likelihood::ProfileLikelihood;
use crate::dynamic::{Coordinate, DynamicFit};
use crate::model::Population;

/// So far a step goes, in logarithms and in parts of a value,
const STEP: f64 = 0.1;
/// or so far that ℓ would fall by this many times its rounding,
const SEEN: f64 = 100.0;
/// which is this part of it, but not farther than this many standard errors.
const ROUNDING: f64 = 1e-13;
const FARTHEST: f64 = 0.5;
/// Curvature, in units of each coordinate's own, that differences cannot tell from none.
const UNSURE: f64 = 1e-8;
/// ℓ falls by less than this part of what was promised.
const PART: f64 = 0.05;
/// Of more directions, which cost up to this many runs of the filters to either side, none is looked at.
const MOST: usize = 4;
const STEPS: usize = 16;

/// Numbers of the faint directions that are flat.
pub(super) fn flat(objective: &ProfileLikelihood<'_>, fit: &DynamicFit) -> Vec<usize> {
    let faint: Vec<FaintDirection> =
        fit.joint.faint().into_iter().filter(|direction| direction.share > TAKES_PART).collect();
    if faint.is_empty() || faint.len() > MOST {
        return Vec::new();
    }
    let home = fit.estimate.log_likelihood;
    let is_flat = |direction: &&FaintDirection| {
        let curvature = direction.curvature.abs().max(UNSURE * own_curvature(fit, direction));
        let length = length(objective, fit, direction, curvature, home);
        let promised = 0.5 * curvature * length * length;
        [length, -length].into_iter().all(|length| {
            let values = objective.moved(&fit.sought, &direction.alpha, length);
            on_ridge(objective, fit, values).is_some_and(|value| (value - home).abs() <= PART * promised)
        })
    };
    faint.iter().filter(is_flat).map(|direction| direction.number).collect()
}

/// ℓ beside some values, on the top of what may be a ridge: α goes on across it, because a ridge of several values is curved.
fn on_ridge(objective: &ProfileLikelihood<'_>, fit: &DynamicFit, mut values: Vec<f64>) -> Option<f64> {
    let near = Population::from(&fit.estimate);
    let mut best: Option<f64> = None;
    for _ in 0..STEPS {
        let here = objective.solve(&values, Some(&near)).ok().filter(|here| here.value().is_finite())?;
        let is_still = best.is_some_and(|best| here.value() <= best + ROUNDING * best.abs());
        best = Some(best.map_or(here.value(), |best| best.max(here.value())));
        let Some(step) = fit.joint.onto_ridge(&here.gradient).filter(|_| !is_still) else { break };
        values = objective.moved(&values, &step, 1.0);
    }
    best
}

/// The curvature along a direction in α alone, where nothing follows.
fn own_curvature(fit: &DynamicFit, direction: &FaintDirection) -> f64 {
    let of = |(s, part): (usize, &f64)| fit.joint.curvature(s).abs() * part * part;
    direction.alpha.iter().enumerate().map(of).sum()
}

fn length(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    direction: &FaintDirection,
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
