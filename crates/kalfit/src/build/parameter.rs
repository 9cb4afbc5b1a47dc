//! Parameters in code.

use std::collections::BTreeMap;

use crate::build::BuildError;
use crate::build::names::{Names, Role};
use crate::model::{Parameter, Value};

/// A parameter on its way into a model.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterBuilder {
    pub(super) name: String,
    unit: Option<String>,
    value: Value,
    per: Option<String>,
    levels: Vec<(String, f64)>,
    lower: Option<f64>,
    upper: Option<f64>,
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

    /// The column with its levels, and their texts, get their indices.
    pub(super) fn declare(&self, names: &mut Names) -> Result<(), BuildError> {
        if self.per.is_none() && !self.levels.is_empty() {
            let first = format!("a value by level of parameter `{}`", self.name);
            return Err(BuildError::Contradiction { first, second: "a parameter without a column of levels".into() });
        }
        if let Some(column) = &self.per {
            names.text_column(column, &format!("parameter `{}`", self.name));
            for (level, _) in &self.levels {
                names.literal(level);
            }
        }
        Ok(())
    }

    /// The parameter, now that its uses are known.
    pub(super) fn lower_into(&self, names: &mut Names, role: Role) -> Result<Parameter, BuildError> {
        let name = self.name.clone();
        if role == Role::Unused {
            return Err(BuildError::Unused { name });
        }
        let positive = role > Role::Coefficient;
        let what = format!("parameter `{name}`");
        self.check(role, &what)?;
        let levels = self.levels.iter().map(|(level, value)| (names.literal(level), *value));
        let fixed_levels: BTreeMap<usize, f64> = levels.collect();
        let per = self.per.as_ref().map(|column| names.text_column(column, &what));
        Ok(Parameter {
            name,
            unit: self.unit.clone(),
            value: self.value,
            per,
            fixed_levels,
            lower: self.lower,
            upper: self.upper,
            positive,
        })
    }

    fn check(&self, role: Role, what: &str) -> Result<(), BuildError> {
        let given = match self.value {
            Value::Fixed(value) => Some(value),
            Value::Free { start } => start,
        };
        let wrong = |what: String, found: f64, expected: String| Err(BuildError::OutOfRange { what, found, expected });
        for value in given.into_iter().chain(self.levels.iter().map(|(_, value)| *value)) {
            role.check(value, what)?;
            if let Some(bound) = self.lower.filter(|bound| value < *bound) {
                return wrong(what.to_owned(), value, format!("at least {bound}, its lower bound"));
            }
            if let Some(bound) = self.upper.filter(|bound| value > *bound) {
                return wrong(what.to_owned(), value, format!("at most {bound}, its upper bound"));
            }
        }
        if let Value::Free { start: Some(start) } = self.value
            && role > Role::Coefficient
            && start <= 0.0
        {
            return wrong(format!("the start of {what}"), start, "more than 0".to_owned());
        }
        for (which, bound) in [("lower", self.lower), ("upper", self.upper)] {
            if let Some(found) = bound.filter(|bound| !bound.is_finite()) {
                return wrong(format!("the {which} bound of {what}"), found, "a finite number".to_owned());
            }
        }
        match (self.lower, self.upper) {
            (Some(lower), Some(upper)) if upper <= lower => {
                wrong(format!("the upper bound of {what}"), upper, format!("more than the lower one, {lower}"))
            }
            _ => Ok(()),
        }
    }
}
