//! Values for a free parameter from elsewhere, such as a fit: many levels at once.

use std::collections::HashMap;

use kalfit::model::Value;

use crate::error::{SpecError, SpecProblem};
use crate::parameters::check_value;
use crate::spec::Spec;
use crate::suggest::suggest;

impl Spec {
    /// Fixes a parameter at values: one for a level, or with `None` for all levels that have no value of their own. Levels that
    /// the model fixes keep their values; of two values for one level the last counts.
    ///
    /// # Errors
    /// A name that is no parameter, a level of a parameter without `per`, a value out of bounds or of the wrong sign. The errors
    /// have no span, and the model stays as it was.
    pub fn give(&mut self, name: &str, values: &[(Option<&str>, f64)]) -> Result<(), SpecError> {
        let mut model = self.model.shared().clone();
        let parameters = &mut model.parameters;
        let Some(index) = parameters.iter().position(|parameter| parameter.name == name) else {
            let hint = suggest(name, parameters.iter().map(|parameter| parameter.name.as_str()));
            let (what, place) = ("parameter", "the values to take".to_owned());
            return Err(
                SpecError::new(SpecProblem::UnknownName { what, name: name.to_owned(), place }).maybe_hint(hint)
            );
        };
        let parameter = &mut parameters[index];
        for (level, value) in values {
            check_value(parameter, self.places.roles[index], *value).map_err(SpecError::new)?;
            if let Some(level) = level.filter(|_| parameter.per.is_none()) {
                let why = format!("on parameter `{name}`, which has no `per`");
                return Err(SpecError::new(SpecProblem::NoEffect { key: format!("{name}[{level}]"), why }));
            }
        }
        let literals = &mut model.literals;
        let mut known: HashMap<String, usize> =
            literals.iter().enumerate().map(|(k, text)| (text.clone(), k)).collect();
        let own = parameter.fixed_levels.clone();
        for &(level, value) in values {
            let Some(level) = level else {
                parameter.value = Value::Fixed(value);
                continue;
            };
            let literal = *known.entry(level.to_owned()).or_insert_with(|| {
                literals.push(level.to_owned());
                literals.len() - 1
            });
            if !own.contains_key(&literal) {
                parameter.fixed_levels.insert(literal, value);
            }
        }
        self.share(&model);
        Ok(())
    }
}

impl Spec {
    /// Gives every parameter the values that it has in the same model read otherwise, where none is free.
    pub fn take_values(&mut self, from: &Spec) {
        let (own, other) = (self.model.shared(), from.model.shared());
        let mut literals = own.literals.clone();
        let mut known: HashMap<String, usize> =
            literals.iter().enumerate().map(|(k, text)| (text.clone(), k)).collect();
        let mut parameters = own.parameters.clone();
        for (parameter, taken) in parameters.iter_mut().zip(&other.parameters) {
            parameter.value = taken.value;
            let levels = taken.fixed_levels.iter().map(|(&literal, &value)| {
                let text = &other.literals[literal];
                let place = *known.entry(text.clone()).or_insert_with(|| {
                    literals.push(text.clone());
                    literals.len() - 1
                });
                (place, value)
            });
            parameter.fixed_levels = levels.collect();
        }
        let model = kalfit::Model { literals, parameters, ..own.clone() };
        self.share(&model);
    }
}
