//! Dynamic parameters and their values.

use std::collections::BTreeMap;

use crate::ensemble::Label;
use crate::model::EvaluationError;

/// One dynamic parameter: a time constant, a noise level, a coefficient.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Name of the parameter.
    pub name: String,
    /// Unit label.
    pub unit: Option<String>,
    /// Known value, or a free value with the start of the estimation.
    pub value: Value,
    /// Index of the text column whose levels have separate values.
    pub per: Option<usize>,
    /// Fixed values of single levels, which override `value`; keys are indices in
    /// [`Model::literals`](crate::model::Model::literals).
    pub fixed_levels: BTreeMap<usize, f64>,
    /// Closed lower bound.
    pub lower: Option<f64>,
    /// Closed upper bound.
    pub upper: Option<f64>,
    /// Whether the parameter is used as a time constant, a standard deviation or a noise variance, and so cannot be
    /// negative.
    pub positive: bool,
}

/// Whether a parameter is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// The known value.
    Fixed(f64),
    /// A value to be estimated.
    Free {
        /// Start value of the estimation; `None` where the start is derived from the data.
        start: Option<f64>,
    },
}

/// The value of a parameter, common or by level.
#[derive(Debug, Clone, PartialEq)]
pub enum Level {
    /// One value for all rows.
    Common(f64),
    /// A value for each level of a text column.
    Each {
        /// Index of the text column.
        column: usize,
        /// Value at each level.
        values: BTreeMap<Label, f64>,
        /// Value at every level that `values` lacks.
        other: Option<f64>,
    },
}

/// α: the values of all parameters at all levels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Alpha {
    /// Values in the order of [`Model::parameters`](crate::Model::parameters).
    pub values: Vec<Level>,
}

/// Reason why a model has no α.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ParameterError {
    /// Some parameters are free, where all parameters must be known.
    #[error("free parameters: {}", names.join(", "))]
    Free {
        /// Names of the parameters.
        names: Vec<String>,
    },
}

impl Alpha {
    /// α with other, nonzero values of the free parameters: a function that is zero at both α hardly depends on the
    /// free parameters.
    pub fn at_other_values(&self, free: &[bool]) -> Alpha {
        let other_value = |value: f64| 0.6180339887 + 1.3247179572 * value.abs();
        let changed = |(level, free): (&Level, bool)| match level {
            level if !free => level.clone(),
            Level::Common(value) => Level::Common(other_value(*value)),
            Level::Each { column, values, other } => Level::Each {
                column: *column,
                values: values.iter().map(|(label, value)| (*label, other_value(*value))).collect(),
                other: other.map(other_value),
            },
        };
        let free = free.iter().copied().chain(std::iter::repeat(false));
        Alpha { values: self.values.iter().zip(free).map(changed).collect() }
    }

    /// The α of a model whose parameters all have values. A parameter with levels needs a value at one level only;
    /// evaluation on a row of a level without a value is an error.
    pub fn fixed(parameters: &[Parameter]) -> Result<Alpha, ParameterError> {
        let free: Vec<String> = parameters.iter().filter(|p| p.has_no_value()).map(|p| p.name.clone()).collect();
        if !free.is_empty() {
            return Err(ParameterError::Free { names: free });
        }
        Ok(Alpha { values: parameters.iter().map(Parameter::level).collect() })
    }

    /// One value for each parameter, in the order of the model, at all levels.
    pub fn common(values: impl IntoIterator<Item = f64>) -> Alpha {
        Alpha { values: values.into_iter().map(Level::Common).collect() }
    }

    /// Value of parameter `index` on a row with text cells `texts`.
    pub fn value(&self, index: usize, texts: &[Label]) -> Result<f64, EvaluationError> {
        match &self.values[index] {
            Level::Common(value) => Ok(*value),
            Level::Each { column, values, other } => {
                let level = texts[*column];
                if level.is_missing() {
                    return Err(EvaluationError::MissingText { column: *column });
                }
                values.get(&level).copied().or(*other).ok_or(EvaluationError::NoLevel { parameter: index, level })
            }
        }
    }
}

impl Parameter {
    /// Whether values of the parameter are to be estimated: the common value, or the value at every level that is not
    /// fixed. [`Slots`](crate::model::Slots) shows whether the data have such levels.
    pub fn is_free(&self) -> bool {
        matches!(self.value, Value::Free { .. })
    }

    /// Whether no value of the parameter is known, at any level.
    fn has_no_value(&self) -> bool {
        self.is_free() && (self.per.is_none() || self.fixed_levels.is_empty())
    }

    pub(crate) fn level(&self) -> Level {
        let common = match self.value {
            Value::Fixed(value) => Some(value),
            Value::Free { .. } => None,
        };
        match (self.per, common) {
            (None, Some(value)) => Level::Common(value),
            (None, None) => Level::Common(f64::NAN), // unreachable: `fixed` refuses parameters without a value
            (Some(column), other) => Level::Each {
                column,
                values: self.fixed_levels.iter().map(|(&literal, &v)| (Label::literal(literal), v)).collect(),
                other,
            },
        }
    }
}
