//! Parameters in code.

use crate::model::Value;

/// A parameter on its way into a model.
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

/// A parameter that is to be estimated, from a start value that is worked out from the data.
pub fn free(name: impl Into<String>) -> ParameterBuilder {
    ParameterBuilder::new(name.into(), Value::Free { start: None })
}

impl ParameterBuilder {
    fn new(name: String, value: Value) -> ParameterBuilder {
        ParameterBuilder { name, unit: None, value, per: None, levels: Vec::new(), lower: None, upper: None }
    }

    /// With a label of its unit.
    #[must_use]
    pub fn unit(mut self, unit: impl Into<String>) -> Self {
        self.unit = Some(unit.into());
        self
    }

    /// Estimated from this start value.
    #[must_use]
    pub fn start(mut self, start: f64) -> Self {
        self.value = Value::Free { start: Some(start) };
        self
    }

    /// At least this.
    #[must_use]
    pub fn lower(mut self, bound: f64) -> Self {
        self.lower = Some(bound);
        self
    }

    /// At most this.
    #[must_use]
    pub fn upper(mut self, bound: f64) -> Self {
        self.upper = Some(bound);
        self
    }

    /// With a value for each text of a column.
    #[must_use]
    pub fn per(mut self, column: impl Into<String>) -> Self {
        self.per = Some(column.into());
        self
    }

    /// Known where the column of [`per`](ParameterBuilder::per) has this text.
    #[must_use]
    pub fn fixed_at(mut self, level: impl Into<String>, value: f64) -> Self {
        self.levels.push((level.into(), value));
        self
    }
}
