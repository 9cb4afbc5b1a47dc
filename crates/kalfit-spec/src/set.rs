//! `--set name=value`: fixing parameters after the model was read.

use kalfit::Model;
use kalfit::model::Value;

use crate::error::{Result, SpecError, SpecProblem};
use crate::parameters::check_value;
use crate::spec::Spec;
use crate::suggest::suggest;

/// `name[level] = value`, taken apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterAssignment<'a> {
    /// Name of the parameter.
    pub name: &'a str,
    /// One of its levels; `None`: all of them.
    pub level: Option<&'a str>,
    /// The value.
    pub value: f64,
}

impl Spec {
    /// Fixes a parameter: `tau=90` at all its levels, `sigma_v[A]=0.7` at one level of a `per` parameter.
    ///
    /// # Errors
    /// Something that is not an assignment of a finite number, a name that is no parameter, a level of a parameter
    /// without `per`, a value out of bounds or of the wrong sign. The errors have no span, and the model stays as it was.
    pub fn set(&mut self, assignment: &str) -> std::result::Result<(), SpecError> {
        let ParameterAssignment { name, level, value } = ParameterAssignment::new(assignment)?;
        let mut model = self.model.shared().clone();
        let parameters = &mut model.parameters;
        let Some(index) = parameters.iter().position(|parameter| parameter.name == name) else {
            let hint = suggest(name, parameters.iter().map(|parameter| parameter.name.as_str()));
            let problem = SpecProblem::UnknownName {
                what: "parameter",
                name: name.to_owned(),
                place: format!("the assignment `{assignment}`"),
            };
            return Err(SpecError::new(problem).maybe_hint(hint));
        };
        let parameter = &mut parameters[index];
        check_value(parameter, self.places.roles[index], value).map_err(SpecError::new)?;
        match level {
            None => {
                parameter.value = Value::Fixed(value);
                parameter.fixed_levels.clear();
            }
            Some(_) if parameter.per.is_none() => {
                let why = format!("on parameter `{name}`, which has no `per`");
                let error = SpecError::new(SpecProblem::NoEffect { key: assignment.to_owned(), why });
                return Err(error.hint(format!("write `{name}={value}`")));
            }
            Some(level) => {
                let literals = &mut model.literals;
                let literal = literals.iter().position(|text| text == level).unwrap_or_else(|| {
                    literals.push(level.to_owned());
                    literals.len() - 1
                });
                parameter.fixed_levels.insert(literal, value);
            }
        }
        self.share(&model);
        Ok(())
    }
}

impl Spec {
    /// Gives the parameters and texts of `changed` to all phases.
    pub(crate) fn share(&mut self, changed: &Model) {
        for model in self.model.models_mut() {
            model.parameters.clone_from(&changed.parameters);
            model.literals.clone_from(&changed.literals);
        }
    }
}

impl ParameterAssignment<'_> {
    /// Takes an assignment apart, whatever model it is for.
    ///
    /// # Errors
    /// Something that is not an assignment of a finite number.
    pub fn new(text: &str) -> Result<ParameterAssignment<'_>> {
        let wrong = || SpecError::new(SpecProblem::NotAnAssignment { found: text.to_owned() });
        let (target, value) = text.rsplit_once('=').ok_or_else(wrong)?;
        let (target, number) = (target.trim(), value.trim());
        let value: f64 = number.parse().map_err(|_| wrong())?;
        if !value.is_finite() {
            let what = format!("the value of `{text}`");
            return Err(SpecError::new(SpecProblem::NotFinite { what, found: number.to_owned() }));
        }
        let (name, level) = match target.split_once('[') {
            None => (target, None),
            Some((name, rest)) => (name.trim(), Some(rest.strip_suffix(']').ok_or_else(wrong)?)),
        };
        if name.is_empty() || level.is_some_and(str::is_empty) {
            return Err(wrong());
        }
        Ok(ParameterAssignment { name, level, value })
    }

    /// What it assigns to: `tau`, or `sigma[A]`.
    pub fn target(&self) -> String {
        self.level.map_or(self.name.to_owned(), |level| format!("{}[{level}]", self.name))
    }
}
