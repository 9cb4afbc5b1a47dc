//! The coordinates α is sought in: logarithms of what is positive, other values as they are; and their bounds.

use crate::model::Model;
use crate::score::Slots;

/// How one free value is sought.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Coordinate {
    /// Its logarithm is sought.
    pub(crate) log: bool,
    /// Closed bounds of the value itself; a logarithm's lower bound is at least zero.
    pub(crate) lower: f64,
    pub(crate) upper: f64,
}

impl Coordinate {
    /// Of all free values of a model.
    pub(crate) fn of(model: &Model, slots: &Slots) -> Vec<Coordinate> {
        let one = |slot: &crate::score::Slot| {
            let parameter = &model.parameters[slot.parameter];
            let least = if parameter.positive { 0.0 } else { f64::NEG_INFINITY };
            Coordinate {
                log: parameter.positive,
                lower: parameter.lower.unwrap_or(least).max(least),
                upper: parameter.upper.unwrap_or(f64::INFINITY),
            }
        };
        slots.slots().iter().map(one).collect()
    }

    /// The coordinate of a value.
    pub(crate) fn of_value(&self, value: f64) -> f64 {
        if self.log { value.ln() } else { value }
    }

    /// dvalue/dcoordinate.
    pub(crate) fn slope(&self, value: f64) -> f64 {
        if self.log { value } else { 1.0 }
    }

    /// The value after a step in the coordinate, within bounds.
    pub(crate) fn moved(&self, value: f64, step: f64) -> f64 {
        let moved = if self.log { value * step.exp() } else { value + step };
        moved.clamp(self.lower, self.upper)
    }

    /// Whether the value stands at its lower bound.
    pub(crate) fn at_lower(&self, value: f64) -> bool {
        value <= self.lower
    }

    /// Whether the value stands at its upper bound.
    pub(crate) fn at_upper(&self, value: f64) -> bool {
        value >= self.upper
    }
}
