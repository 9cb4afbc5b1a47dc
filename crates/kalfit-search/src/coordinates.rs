//! The coordinates in which α is sought: logarithms of positive values, other values as they are; and their bounds.
//!
//! ℓ is analytic in a variance v ≥ 0, not in its standard deviation or its logarithm: near zero a noise level moves in its variance,
//! where zero is a bound like any other (theory §13), and elsewhere where ℓ is nearer to a quadratic in that.

use crate::scales::time_constants;
use kalfit_model::{Expression, PhasedModel, Site, Slots};

/// Least size of a value that is no logarithm, for the length of its steps.
const LEAST: f64 = 1e-2;
/// Least curvature of ℓ in a variance, relative to its slope; a smaller one is raised to this.
const STRAIGHT: f64 = 1e-3;

/// The way in which one free value is sought.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coordinate {
    /// Whether the logarithm of the value is sought.
    pub log: bool,
    /// Exponent k of a noise level, whose k-th power is its variance; `None` for any other value.
    pub(crate) level: Option<f64>,
    /// Closed bounds of the value itself; a logarithm's lower bound is at least zero.
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

    /// A step of length `part` for a logarithm; for another value, of this part of its size.
    pub fn step(&self, value: f64, part: f64) -> f64 {
        if self.log { part } else { part * value.abs().max(LEAST) }
    }

    /// The value after a step in the coordinate, within bounds.
    pub fn moved(&self, value: f64, step: f64) -> f64 {
        let moved = if self.log { value * step.exp() } else { value + step };
        moved.clamp(self.lower, self.upper)
    }

    /// The value of a noise level after a step z of its variance v: v (1 + kz), which near z = 0 is the same step of the logarithm.
    pub(crate) fn moved_as_variance(&self, value: f64, step: f64) -> f64 {
        let exponent = self.level.unwrap_or(1.0);
        let moved = value * (1.0 + exponent * step).max(0.0).powf(exponent.recip());
        moved.clamp(self.lower, self.upper)
    }

    /// A few values over the whole range, its ends among them.
    pub(crate) fn spread(&self, value: f64) -> Vec<f64> {
        let size = if value == 0.0 { 1.0 } else { value.abs() };
        let end = |bound: f64, other: f64| if bound.is_finite() { bound } else { other };
        let (low, high) = match self.log {
            true => (end(self.lower.max(0.05 * size), 0.05 * size), end(self.upper, 20.0 * size)),
            false => (end(self.lower, -3.0 * size), end(self.upper, 3.0 * size)),
        };
        [0.0, 0.25, 0.5, 0.75, 1.0].iter().map(|part| low + part * (high - low)).collect()
    }

    /// A start value strictly between the bounds where that is possible.
    pub(crate) fn inside(&self, value: f64) -> f64 {
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

    /// Whether the value stands at its lower bound.
    pub(crate) fn at_lower(&self, value: f64) -> bool {
        value <= self.lower
    }

    /// Whether the value stands at its upper bound.
    pub(crate) fn at_upper(&self, value: f64) -> bool {
        value >= self.upper
    }

    /// Whether the value stands at a bound beyond which ℓ rises with this slope.
    pub fn is_held(&self, value: f64, slope: f64) -> bool {
        (self.at_lower(value) && slope < 0.0) || (self.at_upper(value) && slope > 0.0)
    }
}

/// The information on the variance v of a level in steps z that make it v (1 + kz), from that on its logarithm u: -∂²ℓ/∂z² is
/// -∂²ℓ/∂u² + k ∂ℓ/∂u.
pub(super) fn in_variance(information: f64, exponent: f64, slope: f64) -> f64 {
    let bend = exponent * slope;
    (information + bend).max(STRAIGHT * bend.abs())
}

/// Whether two points agree, to this part of each value.
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

/// k where the variances that a level stands in go as its k-th power; 1 where they go otherwise.
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
