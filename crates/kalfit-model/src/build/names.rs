//! From names to indices: the columns, texts and parameters that equations have used so far.

use crate::build::BuildError;
use crate::build::parameter::ParameterBuilder;
use crate::model::{Column, Expression};

/// Role of a parameter, which limits the sign; a parameter has the strictest role of all uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Role {
    Unused,
    /// A coefficient: any number.
    Coefficient,
    /// A noise variance or a standard deviation: not negative.
    NonNegative,
    /// A time constant: positive.
    TimeConstant,
}

impl From<crate::model::Role> for Role {
    fn from(role: crate::model::Role) -> Role {
        use crate::model::Role as ModelRole;
        match role {
            ModelRole::Scale { .. } => Role::NonNegative,
            ModelRole::TimeConstant => Role::TimeConstant,
            ModelRole::Other => Role::Unused, // the weakest role, which changes no role
        }
    }
}

/// Names that all phases share, and names of the phase that is being built.
#[derive(Debug, Default)]
pub(super) struct Names {
    pub(super) columns: Vec<Column>,
    pub(super) text_columns: Vec<Column>,
    pub(super) literals: Vec<String>,
    pub(super) parameters: Vec<(ParameterBuilder, Role)>,
    /// States of the phase that is being built.
    pub(super) states: Vec<String>,
    /// Whether the phase that is being built has times.
    pub(super) time: bool,
}

impl Names {
    /// Adds a parameter, unless an earlier phase added an equal parameter.
    pub(super) fn parameter(&mut self, parameter: &ParameterBuilder, phase: Option<&str>) -> Result<(), BuildError> {
        match self.parameters.iter().find(|(known, _)| known.name == parameter.name) {
            None => self.parameters.push((parameter.clone(), Role::Unused)),
            Some((known, _)) if phase.is_some() && known == parameter => {}
            Some(_) => {
                let name = parameter.name.clone();
                return Err(match phase {
                    None => BuildError::Twice { what: "two parameters", name },
                    Some(phase) => {
                        BuildError::PhasesDiffer { phase: phase.to_owned(), what: format!("parameter `{name}`") }
                    }
                });
            }
        }
        Ok(())
    }

    pub(super) fn state(&self, name: &str) -> Option<usize> {
        self.states.iter().position(|known| known == name)
    }

    /// Index of the state `name`, which must exist; `place` is the place of the name, for the error.
    pub(super) fn required_state(&self, name: &str, place: &str) -> Result<usize, BuildError> {
        self.state(name).ok_or_else(|| unknown("state", name, place, &self.states))
    }

    pub(super) fn column(&mut self, name: &str, place: &str) -> usize {
        index(&mut self.columns, name, place)
    }

    pub(super) fn text_column(&mut self, name: &str, place: &str) -> usize {
        index(&mut self.text_columns, name, place)
    }

    pub(super) fn literal(&mut self, text: &str) -> usize {
        self.literals.iter().position(|known| known == text).unwrap_or_else(|| {
            self.literals.push(text.to_owned());
            self.literals.len() - 1
        })
    }

    /// Resolves a name that is not a state: a parameter, else a column.
    pub(super) fn scalar(&mut self, name: &str, place: &str) -> Expression {
        match self.parameters.iter_mut().enumerate().find(|(_, (known, _))| known.name == name) {
            Some((index, (_, role))) => {
                *role = (*role).max(Role::Coefficient);
                Expression::Parameter(index)
            }
            None => Expression::Column(self.column(name, place)),
        }
    }

    /// Gives the role `role` to a parameter that is the whole expression; a parameter inside a larger expression gets a
    /// role when the model is complete.
    pub(super) fn mark_role(&mut self, value: &Expression, role: Role) {
        if let Expression::Parameter(index) = value {
            self.strengthen_role(*index, role);
        }
    }

    /// Gives a parameter the role `role`, if this role is stricter than the present role.
    pub(super) fn strengthen_role(&mut self, parameter: usize, role: Role) {
        let known = &mut self.parameters[parameter].1;
        *known = (*known).max(role);
    }
}

pub(super) fn unknown(what: &'static str, name: &str, place: &str, known: &[String]) -> BuildError {
    BuildError::Unknown { what, name: name.to_owned(), place: place.to_owned(), known: known.to_vec() }
}

fn index(columns: &mut Vec<Column>, name: &str, place: &str) -> usize {
    columns.iter().position(|column| column.name == name).unwrap_or_else(|| {
        columns.push(Column { name: name.to_owned(), used_in: place.to_owned() });
        columns.len() - 1
    })
}
