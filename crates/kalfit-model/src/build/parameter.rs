//! Parameters in code.

use crate::model::Value;

/// Builder of a parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterBuilder {
    pub(super) name: String,
    pub(super) unit: Option<String>,
    pub(super) value: Value,
    pub(super) per: Option<String>,
    pub(super) levels: Vec<(String, f64)>,
    pub(super) lower: Option<f64>,
    pub(super) upper: Option<f64>,
}

/// A parameter whose value is known.
pub fn fixed(name: impl Into<String>, value: f64) -> ParameterBuilder {
    ParameterBuilder::new(name.into(), Value::Fixed(value))
}

/// A parameter to be estimated, with a start value that is computed from the data.
pub fn free(name: impl Into<String>) -> ParameterBuilder {
    ParameterBuilder::new(name.into(), Value::Free { start: None })
}

impl ParameterBuilder {
    fn new(name: String, value: Value) -> ParameterBuilder {
        ParameterBuilder { name, unit: None, value, per: None, levels: Vec::new(), lower: None, upper: None }
    }

    /// Sets the label of the unit.
    #[must_use]
    pub fn unit(mut self, unit: impl Into<String>) -> Self {
        self.unit = Some(unit.into());
        self
    }

    /// Makes the parameter estimated, with this start value.
    #[must_use]
    pub fn start(mut self, start: f64) -> Self {
        self.value = Value::Free { start: Some(start) };
        self
    }

    /// Sets the lower bound.
    #[must_use]
    pub fn lower(mut self, bound: f64) -> Self {
        self.lower = Some(bound);
        self
    }

    /// Sets the upper bound.
    #[must_use]
    pub fn upper(mut self, bound: f64) -> Self {
        self.upper = Some(bound);
        self
    }

    /// Gives the parameter a separate value for each text of a column.
    #[must_use]
    pub fn per(mut self, column: impl Into<String>) -> Self {
        self.per = Some(column.into());
        self
    }

    /// Fixes the value where the column of [`per`](ParameterBuilder::per) has this text.
    #[must_use]
    pub fn fixed_at(mut self, level: impl Into<String>, value: f64) -> Self {
        self.levels.push((level.into(), value));
        self
    }
}
