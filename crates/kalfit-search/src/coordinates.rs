//! The coordinates in which α is sought: logarithms of positive values, other values as they are; and their bounds.
//!
//! ℓ is analytic in a variance v ≥ 0, not in √v or log v. So a noise level moves in the variance near zero, where zero
//! is a bound like any other (theory §13), and wherever ℓ is nearer to a quadratic in the variance than in the
//! logarithm.

use crate::scales::time_constants;
use kalfit_model::{Expression, PhasedModel, Site, Slots};

/// Least size to which the step of a value is relative, where the value itself is sought, not the logarithm.
const MIN_REFERENCE_VALUE: f64 = 1e-2;
/// Least curvature of ℓ in a variance, relative to |slope|; a smaller curvature is replaced by this one.
const MIN_RELATIVE_CURVATURE: f64 = 1e-3;

/// The way in which one free value is sought.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coordinate {
    /// Whether the logarithm of the value is sought.
    pub log: bool,
    /// Exponent k of a noise level θ with variance proportional to θ^k; `None` for any other value.
    pub(crate) level: Option<f64>,
    /// Closed lower bound of the value itself; at least zero where the logarithm is sought.
    pub lower: f64,
    /// Closed upper bound of the value itself; infinite where there is none.
    pub upper: f64,
}

impl Coordinate {
    /// The coordinates of all free values of a model.
    pub fn of(model: &PhasedModel, slots: &Slots) -> Vec<Coordinate> {
        let (constants, noises) = (time_constants(model), noises(model));
        let one = |slot: &kalfit_model::Slot| {
            let parameter = &model.shared().parameters[slot.parameter];
            let least = if parameter.positive { 0.0 } else { f64::NEG_INFINITY };
            let is_level = parameter.positive && !constants.contains(&slot.parameter);
            Coordinate {
                log: parameter.positive,
                level: is_level.then(|| exponent(&noises, slot.parameter)),
                lower: parameter.lower.unwrap_or(least).max(least),
                upper: parameter.upper.unwrap_or(f64::INFINITY),
            }
        };
        slots.slots().iter().map(one).collect()
    }

    /// The coordinate of a value.
    pub fn of_value(&self, value: f64) -> f64 {
        if self.log { value.ln() } else { value }
    }

    /// dvalue/dcoordinate.
    pub fn slope(&self, value: f64) -> f64 {
        if self.log { value } else { 1.0 }
    }

    /// Size of a value in its coordinate: 1 for a logarithm.
    pub fn size(&self, value: f64) -> f64 {
        if self.log { 1.0 } else { value.abs().max(MIN_REFERENCE_VALUE) }
    }

    /// Length of a step in the coordinate: `part` for a logarithm, `part` × the size of another value.
    pub fn step(&self, value: f64, part: f64) -> f64 {
        part * self.size(value)
    }

    /// The value after a step in the coordinate, within bounds.
    pub fn moved(&self, value: f64, step: f64) -> f64 {
        let moved = if self.log { value * step.exp() } else { value + step };
        moved.clamp(self.lower, self.upper)
    }

    /// The value of a noise level θ after a step z that makes the variance v (1 + kz); near z = 0, log θ changes by z.
    pub(crate) fn moved_as_variance(&self, value: f64, step: f64) -> f64 {
        let exponent = self.level.unwrap_or(1.0);
        let moved = value * (1.0 + exponent * step).max(0.0).powf(exponent.recip());
        moved.clamp(self.lower, self.upper)
    }

    /// Five values over the range, both ends included.
    pub(crate) fn values_over_range(&self, value: f64) -> Vec<f64> {
        let size = if value == 0.0 { 1.0 } else { value.abs() };
        let end = |bound: f64, other: f64| if bound.is_finite() { bound } else { other };
        let (low, high) = match self.log {
            true => (end(self.lower.max(0.05 * size), 0.05 * size), end(self.upper, 20.0 * size)),
            false => (end(self.lower, -3.0 * size), end(self.upper, 3.0 * size)),
        };
        [0.0, 0.25, 0.5, 0.75, 1.0].iter().map(|part| low + part * (high - low)).collect()
    }

    /// A start value strictly between the bounds where that is possible.
    pub(crate) fn within_bounds(&self, value: f64) -> f64 {
        if value > self.lower && value < self.upper {
            return value;
        }
        match (self.lower.is_finite(), self.upper.is_finite()) {
            (true, true) => 0.5 * (self.lower + self.upper),
            (true, false) if self.log => 2.0 * self.lower.max(0.5),
            (true, false) => self.lower + 1.0,
            (false, true) => self.upper - 1.0,
            (false, false) => value,
        }
    }

    /// Whether the value is at the lower bound.
    pub(crate) fn at_lower(&self, value: f64) -> bool {
        value <= self.lower
    }

    /// Whether the value is at the upper bound.
    pub(crate) fn at_upper(&self, value: f64) -> bool {
        value >= self.upper
    }

    /// Whether the value is at a bound beyond which ℓ rises with the given slope.
    pub fn is_held(&self, value: f64, slope: f64) -> bool {
        (self.at_lower(value) && slope < 0.0) || (self.at_upper(value) && slope > 0.0)
    }
}

/// -∂²ℓ/∂z² = -∂²ℓ/∂u² + k ∂ℓ/∂u for steps z that make the variance of a level v (1 + kz), where u is the logarithm of
/// the level and `information` is -∂²ℓ/∂u².
pub(super) fn in_variance(information: f64, exponent: f64, slope: f64) -> f64 {
    let bend = exponent * slope;
    (information + bend).max(MIN_RELATIVE_CURVATURE * bend.abs())
}

/// Whether two points agree in each value, up to the relative difference `part`.
pub fn alike(a: &[f64], b: &[f64], part: f64) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= part * a.abs().max(b.abs()))
}

/// The variances and covariances of all noises.
fn noises(model: &PhasedModel) -> Vec<&Expression> {
    let is_noise = |site: Site| {
        matches!(site, Site::Noise(_) | Site::ProcessNoise(_) | Site::NoiseCovariance | Site::ProcessCovariance)
    };
    let all = model.phases.iter().flat_map(|phase| phase.model.expressions());
    all.filter(|(site, _)| is_noise(*site)).map(|(_, expression)| expression).collect()
}

/// Exponent k of variances proportional to θ^k that contain a level θ, within 1 to 2; 1 where no power holds.
fn exponent(noises: &[&Expression], parameter: usize) -> f64 {
    let powers = noises.iter().map(|expression| expression.exponent(parameter).unwrap_or(1.0));
    powers.filter(|power| *power > 0.0).fold(f64::INFINITY, f64::min).clamp(1.0, 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::build::{Noise, constant, free, measurement, name, variance, when};

    #[test]
    fn a_standard_deviation_of_some_rows_moves_in_its_square() {
        let on_first = || when(name("first").equals(1.0), name("s"), 0.0);
        for (noise, exponent) in [(Noise::from(on_first()), 2.0), (variance(on_first()), 1.0)] {
            let model = kalfit_model::Model::builder("")
                .state(constant("x"))
                .measurement(measurement("y", "x", noise))
                .parameter(free("s"));
            let model: PhasedModel = model.build().unwrap();
            let slots = Slots::new(model.shared(), &kalfit_model::Labels::default(), &[]);
            assert_eq!(Coordinate::of(&model, &slots)[0].level, Some(exponent));
        }
    }

    #[test]
    fn a_value_at_a_bound_is_held_by_a_slope_that_leads_beyond_it() {
        let between = Coordinate { log: true, level: None, lower: 0.5, upper: 2.0 };
        let cases = [
            (0.5, -1.0, true),
            (0.5, 1.0, false),
            (0.5, 0.0, false),
            (1.0, -1.0, false),
            (1.0, 1.0, false),
            (2.0, -1.0, false),
            (2.0, 0.0, false),
            (2.0, 1.0, true),
        ];
        for (value, slope, held) in cases {
            assert_eq!(between.is_held(value, slope), held, "{value} with slope {slope}");
        }
    }
}
