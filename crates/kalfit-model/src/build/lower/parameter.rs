//! From the builder of a parameter to a parameter of the model.

use std::collections::BTreeMap;

use crate::build::BuildError;
use crate::build::names::{Names, Role};
use crate::build::parameter::ParameterBuilder;
use crate::model::{Parameter, Value};

impl ParameterBuilder {
    /// Assigns indices to the column of levels and to the texts of the levels.
    pub(in crate::build) fn declare(&self, names: &mut Names) -> Result<(), BuildError> {
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

    /// Builds the parameter, whose role follows from all uses.
    pub(in crate::build) fn lower_into(&self, names: &mut Names, role: Role) -> Result<Parameter, BuildError> {
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
        let value_or_start = match self.value {
            Value::Fixed(value) => Some(value),
            Value::Free { start } => start,
        };
        let out_of_range =
            |what: String, found: f64, expected: String| Err(BuildError::OutOfRange { what, found, expected });
        for value in value_or_start.into_iter().chain(self.levels.iter().map(|(_, value)| *value)) {
            role.check(value, what)?;
            if let Some(bound) = self.lower.filter(|bound| value < *bound) {
                return out_of_range(what.to_owned(), value, format!("at least {bound}, its lower bound"));
            }
            if let Some(bound) = self.upper.filter(|bound| value > *bound) {
                return out_of_range(what.to_owned(), value, format!("at most {bound}, its upper bound"));
            }
        }
        if let Value::Free { start: Some(start) } = self.value
            && role > Role::Coefficient
            && start <= 0.0
        {
            return out_of_range(format!("the start of {what}"), start, "more than 0".to_owned());
        }
        for (which, bound) in [("lower", self.lower), ("upper", self.upper)] {
            if let Some(found) = bound.filter(|bound| !bound.is_finite()) {
                return out_of_range(format!("the {which} bound of {what}"), found, "a finite number".to_owned());
            }
        }
        match (self.lower, self.upper) {
            (Some(lower), Some(upper)) if upper <= lower => {
                out_of_range(format!("the upper bound of {what}"), upper, format!("more than the lower one, {lower}"))
            }
            _ => Ok(()),
        }
    }
}
