//! Ridges of ℓ: directions in α that (μ, Σ) make up for, all but a little, as for what multiplies a column of 10⁴ ± 1 beside a state with a
//! free mean.
//!
//! Differences of gradients at fixed (μ, Σ) do not tell so small a curvature: it is what is left where large numbers are all but equal.
//! Gradients at the best (μ, Σ) a part of a standard error to either side do tell it, and how far the top of the ridge is.

use crate::joint::{FLAT, InformationDirection, JointInformation};
use crate::profile_likelihood::ProfileLikelihood;
use kalfit_model::Population;

/// To both sides, in standard errors.
const PART: f64 = 0.1;
/// Gradients that differ by less than this, in coordinates of unit curvature, may differ by rounding.
const SEEN: f64 = 1e-8;
/// Where they do, the sides are so many times as far,
const FARTHER: f64 = 10.0;
/// but where a logarithm would change by more than this.
const FARTHEST: f64 = 1.0;
/// A curvature is that of the sides it was found with, up to this factor.
const OFF: f64 = 4.0;
/// ℓ and its gradients say the same up to this part.
const AGREES: f64 = 0.25;
/// Of the curvature along a direction less than this part is for leading aside from the top of the ridge: differences do not tell where to
/// more exactly than they do, and the top itself may be flat.
const ASIDE: f64 = 0.5;
/// How often sides are looked for.
const LOOKS: usize = 8;

/// ℓ along a ridge.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ridge {
    /// -∂²ℓ along its top.
    pub(super) curvature: f64,
    /// ∂ℓ along it.
    pub(super) slope: f64,
}

impl Ridge {
    /// Along a direction from a place, as ℓ and its gradients say; `None` where they do not tell it from a flat one, or not the same.
    pub(super) fn new(
        objective: &ProfileLikelihood<'_>,
        start: RidgeStart<'_>,
        direction: &InformationDirection,
    ) -> Option<Ridge> {
        let along = &direction.alpha;
        let unit = direction.of_curvature(1.0);
        let mut curvature = direction.curvature.abs().max(FLAT / unit);
        for _ in 0..LOOKS {
            let length = PART / curvature.sqrt();
            let sides = [length, -length].map(|length| RidgeSide::new(objective, start, (direction, length)));
            let [Some(up), Some(down)] = sides else { return None };
            let [rise, fall] = [&up, &down].map(|side| dot(&side.gradient, along));
            let bend = fall - rise;
            let ridge = Ridge { curvature: bend / (2.0 * length), slope: 0.5 * (rise + fall) };
            if bend.abs() * unit.sqrt() < SEEN {
                curvature /= FARTHER * FARTHER;
                continue;
            }
            if ridge.curvature <= 0.0 {
                return None;
            }
            if (OFF.recip()..=OFF).contains(&(ridge.curvature / curvature)) {
                let is_told = ridge.tells(&up, length, start.value) && ridge.tells(&down, -length, start.value);
                let bends: Vec<f64> =
                    down.gradient.iter().zip(&up.gradient).map(|(d, u)| (d - u) / (2.0 * length)).collect();
                let aside = start.joint.left_by_others(along, &bends)?;
                let on_top = Ridge { curvature: ridge.curvature - aside, ..ridge };
                return (is_told && aside < ASIDE * ridge.curvature).then_some(on_top);
            }
            curvature = ridge.curvature;
        }
        None
    }

    /// ℓ falls to a side by what the gradients say.
    fn tells(&self, side: &RidgeSide, length: f64, home: f64) -> bool {
        let bent = 0.5 * self.curvature * length * length;
        (home - side.value - (bent - self.slope * length)).abs() <= AGREES * bent
    }

    /// How far it leads to its top.
    pub(super) fn step(&self) -> f64 {
        self.slope / self.curvature
    }

    /// The same in standard errors.
    pub(super) fn score(&self) -> f64 {
        self.slope.abs() / self.curvature.sqrt()
    }
}

/// Where a ridge is looked at: values of α, a population near the best one there, ℓ, and the information as differences know it.
#[derive(Clone, Copy)]
pub(super) struct RidgeStart<'a> {
    pub(super) values: &'a [f64],
    pub(super) near: &'a Population,
    pub(super) value: f64,
    pub(super) joint: &'a JointInformation,
}

/// ℓ and its gradient in α beside a place, at the best (μ, Σ) there.
struct RidgeSide {
    value: f64,
    gradient: Vec<f64>,
}

impl RidgeSide {
    /// So far along a direction; `None` where ℓ is not defined, beyond bounds, or where a logarithm would change by much.
    fn new(
        objective: &ProfileLikelihood<'_>,
        start: RidgeStart<'_>,
        (direction, length): (&InformationDirection, f64),
    ) -> Option<RidgeSide> {
        let moved = objective.moved(start.values, &direction.alpha, length);
        let fits = |(s, part): (usize, &f64)| {
            let coordinate = &objective.coordinates[s];
            let is_free = !coordinate.at_lower(moved[s]) && !coordinate.at_upper(moved[s]);
            *part == 0.0 || (is_free && !(coordinate.log && (part * length).abs() > FARTHEST))
        };
        if !direction.alpha.iter().enumerate().all(fits) {
            return None;
        }
        let there = objective.solve(&moved, Some(start.near)).ok()?;
        let is_known = there.value().is_finite() && there.gradient.iter().all(|slope| slope.is_finite());
        is_known.then(|| RidgeSide { value: there.value(), gradient: there.gradient })
    }
}

/// A gradient in α along a direction.
pub(super) fn dot(gradient: &[f64], along: &[f64]) -> f64 {
    gradient.iter().zip(along).map(|(slope, part)| slope * part).sum()
}
