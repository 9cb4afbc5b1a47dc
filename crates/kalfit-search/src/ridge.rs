//! Ridges of ℓ: directions in α that (μ, Σ) compensate almost entirely, as for the coefficient of a column of 10⁴ ± 1
//! together with a state with a free mean.
//!
//! Differences of gradients at fixed (μ, Σ) do not resolve so small a curvature: it is a small difference of large
//! numbers. Gradients at the best (μ, Σ), a part of a standard error to either side, do resolve the curvature and the
//! distance to the top of the ridge.

use crate::joint::{FLAT_EIGENVALUE, InformationDirection, JointInformation};
use crate::profile_likelihood::ProfileLikelihood;
use kalfit_model::Population;

/// Distance of the points on the two sides from the examined point, in standard errors.
const SIDE_DISTANCE: f64 = 0.1;
/// Gradients that differ by less than this, in coordinates of unit curvature, may differ by rounding.
const MIN_DIFFERENCE: f64 = 1e-8;
/// Factor by which the sides move away where gradients may differ by rounding only.
const FARTHER_FACTOR: f64 = 10.0;
/// Largest change of a logarithm from the point to a side.
const MAX_LOGARITHM: f64 = 1.0;
/// Largest factor between a curvature and the one for which the distance of the sides was chosen.
const MAX_CURVATURE_RATIO: f64 = 4.0;
/// Relative difference up to which ℓ and its gradients agree.
const MAX_DISAGREEMENT: f64 = 0.25;
/// Largest part of the curvature along a direction that may come from leaving the top of the ridge: differences do not
/// resolve the course of the top any better, and the top itself may be flat.
const MAX_ASIDE_PART: f64 = 0.5;
/// Maximal number of distances tried for the sides.
const MAX_DISTANCES: usize = 8;

/// Slope and curvature of ℓ along a ridge.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ridge {
    /// -∂²ℓ along the top of the ridge.
    pub(super) curvature: f64,
    /// ∂ℓ along the ridge.
    pub(super) slope: f64,
}

impl Ridge {
    /// The ridge along a direction from a point, by values and gradients of ℓ; `None` where gradients do not
    /// distinguish the ridge from a flat direction, or where values and gradients disagree.
    pub(super) fn new(
        objective: &ProfileLikelihood<'_>,
        start: RidgeStart<'_>,
        direction: &InformationDirection,
    ) -> Option<Ridge> {
        let along = &direction.alpha;
        let unit = direction.eigenvalue_of(1.0);
        let mut curvature = direction.curvature.abs().max(FLAT_EIGENVALUE / unit);
        for _ in 0..MAX_DISTANCES {
            let length = SIDE_DISTANCE / curvature.sqrt();
            let sides = [length, -length].map(|length| RidgeSide::new(objective, start, (direction, length)));
            let [Some(up), Some(down)] = sides else { return None };
            let [rise, fall] = [&up, &down].map(|side| dot(&side.gradient, along));
            let bend = fall - rise;
            let ridge = Ridge { curvature: bend / (2.0 * length), slope: 0.5 * (rise + fall) };
            if bend.abs() * unit.sqrt() < MIN_DIFFERENCE {
                curvature /= FARTHER_FACTOR * FARTHER_FACTOR;
                continue;
            }
            if ridge.curvature <= 0.0 {
                return None;
            }
            if (MAX_CURVATURE_RATIO.recip()..=MAX_CURVATURE_RATIO).contains(&(ridge.curvature / curvature)) {
                let agrees = ridge.tells(&up, length, start.value) && ridge.tells(&down, -length, start.value);
                let bends: Vec<f64> =
                    down.gradient.iter().zip(&up.gradient).map(|(d, u)| (d - u) / (2.0 * length)).collect();
                let loss_at_top = start.joint.curvature_lost(along, &bends)?;
                let on_top = Ridge { curvature: ridge.curvature - loss_at_top, ..ridge };
                return (agrees && loss_at_top < MAX_ASIDE_PART * ridge.curvature).then_some(on_top);
            }
            curvature = ridge.curvature;
        }
        None
    }

    /// Whether ℓ falls to a side by as much as the gradients predict.
    fn tells(&self, side: &RidgeSide, length: f64, start_value: f64) -> bool {
        let curvature_loss = 0.5 * self.curvature * length * length;
        (start_value - side.value - (curvature_loss - self.slope * length)).abs() <= MAX_DISAGREEMENT * curvature_loss
    }

    /// Length of the step to the top of the ridge.
    pub(super) fn step(&self) -> f64 {
        self.slope / self.curvature
    }

    /// Distance to the top of the ridge, in standard errors.
    pub(super) fn score(&self) -> f64 {
        self.slope.abs() / self.curvature.sqrt()
    }
}

/// The point at which a ridge is examined: values of α, a population near the best one there, ℓ, and the information
/// from differences.
#[derive(Clone, Copy)]
pub(super) struct RidgeStart<'a> {
    pub(super) values: &'a [f64],
    pub(super) near: &'a Population,
    pub(super) value: f64,
    pub(super) joint: &'a JointInformation,
}

/// ℓ and its gradient in α at a point to one side, at the best (μ, Σ) there.
struct RidgeSide {
    value: f64,
    gradient: Vec<f64>,
}

impl RidgeSide {
    /// The side at distance `length` along a direction; `None` where ℓ is not defined, beyond bounds, or where a
    /// logarithm would change by much.
    fn new(
        objective: &ProfileLikelihood<'_>,
        start: RidgeStart<'_>,
        (direction, length): (&InformationDirection, f64),
    ) -> Option<RidgeSide> {
        let moved = objective.moved(start.values, &direction.alpha, length);
        let fits = |(s, part): (usize, &f64)| {
            let coordinate = &objective.coordinates[s];
            let is_free = !coordinate.at_lower(moved[s]) && !coordinate.at_upper(moved[s]);
            *part == 0.0 || (is_free && !(coordinate.log && (part * length).abs() > MAX_LOGARITHM))
        };
        if !direction.alpha.iter().enumerate().all(fits) {
            return None;
        }
        let there = objective.solve(&moved, Some(start.near)).ok()?;
        let is_known = there.value().is_finite() && there.gradient.iter().all(|slope| slope.is_finite());
        is_known.then(|| RidgeSide { value: there.value(), gradient: there.gradient })
    }
}

/// Component along a direction of a gradient in α.
pub(super) fn dot(gradient: &[f64], along: &[f64]) -> f64 {
    gradient.iter().zip(along).map(|(slope, part)| slope * part).sum()
}
