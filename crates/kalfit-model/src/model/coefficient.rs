//! Coefficients: parameters that act linearly on inputs and measurements, as states.
//!
//! In `y = a + q x` with a free q, ℓ is quadratic in q at any other parameters, as it is in the mean of a state with the
//! loading x that neither moves nor varies from test to test. The two spellings are one model, and generalised least
//! squares solves for a mean without a search.

use crate::model::{
    CovarianceKind, CovarianceStructure, Expression, FixedElement, GroupLevel, Initial, Linear, MeanElement, Model,
    Motion, Operator, PhasedModel, Site, State, Value,
};

/// A model with coefficients as states.
#[derive(Debug, Clone, PartialEq)]
pub struct CoefficientsAsStates {
    /// The model: its last estimated states are the coefficients, whose parameters are fixed and occur nowhere.
    pub model: PhasedModel,
    /// The parameter of each of these states.
    pub parameters: Vec<usize>,
}

impl PhasedModel {
    /// This model with every coefficient as a state; `None` where no parameter is a coefficient. A coefficient is a free
    /// parameter, one for all tests, that occurs only in constants of measurements and inputs of states, linearly, and
    /// multiplied by nothing that is free.
    ///
    /// Models of several phases, and those whose Σ is given by a matrix, are left as they are.
    pub fn with_coefficients_as_states(&self) -> Option<CoefficientsAsStates> {
        let [phase] = &self.phases[..] else { return None };
        let structures = self.levels.iter().map(|level| &level.covariance).chain([&phase.model.covariance]);
        if phase.filter.is_some() || !phase.carry.is_empty() || !structures.into_iter().all(can_grow) {
            return None;
        }
        let mut found = CoefficientsAsStates { model: self.clone(), parameters: Vec::new() };
        for parameter in 0..phase.model.parameters.len() {
            let used_by_levels = self.levels.iter().any(|level| mentions(level, parameter));
            let model = &mut found.model.phases[0].model;
            let p = model.estimated.len();
            if !used_by_levels && let Some(other) = with_state(model, parameter) {
                *model = other;
                found.model.levels.iter_mut().for_each(|level| grow(&mut level.covariance, p));
                found.parameters.push(parameter);
            }
        }
        (!found.parameters.is_empty()).then_some(found)
    }
}

fn mentions(level: &GroupLevel, parameter: usize) -> bool {
    level.covariance.kind.expressions().iter().any(|(_, expression)| expression.mentions(parameter))
}

/// Whether a state without variance can be added to a structure.
fn can_grow(structure: &CovarianceStructure) -> bool {
    let kind = matches!(structure.kind, CovarianceKind::Full | CovarianceKind::Diagonal | CovarianceKind::Blocks(_));
    kind && structure.known.is_none()
}

/// Adds a state without variance.
fn grow(structure: &mut CovarianceStructure, p: usize) {
    if let CovarianceKind::Blocks(blocks) = &mut structure.kind {
        blocks.push(vec![p]);
    }
    structure.fixed.push(FixedElement { i: p, j: p, value: 0.0 });
    structure.start = structure.start.take().map(|start| start.resize(p + 1, p + 1, 0.0));
}

/// The model with a parameter as a state; `None` where the parameter is no coefficient.
fn with_state(model: &Model, parameter: usize) -> Option<Model> {
    let definition = &model.parameters[parameter];
    if definition.per.is_some() || matches!(definition.value, Value::Fixed(_)) {
        return None;
    }
    let all = model.expressions();
    let mut sites = all.iter().filter(|(_, expression)| expression.mentions(parameter)).peekable();
    sites.peek()?;
    // an input moves the stationary mean of a state, which no state that does not move can
    let has_stationary = model.states.iter().any(|state| state.initial == Initial::Stationary);
    let may_stand = |site: &Site| match site {
        Site::Constant(_) => true,
        Site::Input(_) => !has_stationary,
        _ => false,
    };
    if !sites.all(|(site, _)| may_stand(site)) {
        return None;
    }
    let (mut other, state) = (model.clone(), model.states.len());
    let forms = other.states.iter_mut().filter_map(|state| match &mut state.motion {
        Motion::Continuous { derivative: form, .. } | Motion::Discrete { next: form, .. } => Some(form),
        Motion::Constant => None,
    });
    for form in forms.chain(other.measurements.iter_mut().map(|measurement| &mut measurement.equation)) {
        move_to_state(form, (parameter, state), model)?;
    }
    let p = other.estimated.len();
    other.states.push(State {
        name: definition.name.clone(),
        unit: definition.unit.clone(),
        motion: Motion::Constant,
        initial: Initial::Estimated,
        offset: None,
        random: false,
    });
    other.estimated.push(state);
    other.mean.elements.push(MeanElement::Free);
    other.mean.start.push(None);
    grow(&mut other.covariance, p);
    other.parameters[parameter].value = Value::Fixed(0.0);
    Some(other)
}

/// Makes the part of a form's constant that a parameter multiplies the coefficient of a state; `None` where the constant
/// is not linear in the parameter, or the part depends on a free parameter.
fn move_to_state(form: &mut Linear, (parameter, state): (usize, usize), model: &Model) -> Option<()> {
    if !form.constant.mentions(parameter) {
        return Some(());
    }
    let (factor, rest) = linear_in(&form.constant, parameter)?;
    let is_free = |other: usize| matches!(model.parameters[other].value, Value::Free { .. });
    if factor.parameters().into_iter().any(is_free) {
        return None;
    }
    form.terms.push((state, factor));
    form.constant = rest;
    Some(())
}

/// (a, b) of an expression a × parameter + b whose a and b are without the parameter; `None` for any other expression.
fn linear_in(expression: &Expression, parameter: usize) -> Option<(Expression, Expression)> {
    let zero = || Expression::Number(0.0);
    if !expression.mentions(parameter) {
        return Some((zero(), expression.clone()));
    }
    match expression {
        Expression::Parameter(_) => Some((Expression::Number(1.0), zero())),
        Expression::Negate(a) => linear_in(a, parameter).map(|(factor, rest)| (negated(factor), negated(rest))),
        Expression::Binary(operator @ (Operator::Add | Operator::Subtract), a, b) => {
            let (a, b) = (linear_in(a, parameter)?, linear_in(b, parameter)?);
            Some((sum(*operator, a.0, b.0), sum(*operator, a.1, b.1)))
        }
        Expression::Binary(Operator::Multiply, a, b) if !a.mentions(parameter) => {
            let (factor, rest) = linear_in(b, parameter)?;
            Some((product((**a).clone(), factor), product((**a).clone(), rest)))
        }
        Expression::Binary(Operator::Multiply, a, b) if !b.mentions(parameter) => {
            let (factor, rest) = linear_in(a, parameter)?;
            Some((product(factor, (**b).clone()), product(rest, (**b).clone())))
        }
        Expression::Binary(Operator::Divide, a, b) if !b.mentions(parameter) => {
            let (factor, rest) = linear_in(a, parameter)?;
            Some((quotient(factor, (**b).clone()), quotient(rest, (**b).clone())))
        }
        Expression::If(condition, a, b) if !condition.mentions(parameter) => {
            let (a, b) = (linear_in(a, parameter)?, linear_in(b, parameter)?);
            let one = |a, b| Expression::If(condition.clone(), Box::new(a), Box::new(b));
            Some((one(a.0, b.0), one(a.1, b.1)))
        }
        _ => None,
    }
}

fn is(expression: &Expression, number: f64) -> bool {
    expression.as_number() == Some(number)
}

fn negated(a: Expression) -> Expression {
    if is(&a, 0.0) { a } else { Expression::Negate(Box::new(a)) }
}

fn sum(operator: Operator, a: Expression, b: Expression) -> Expression {
    match operator {
        _ if is(&b, 0.0) => a,
        Operator::Add if is(&a, 0.0) => b,
        _ if is(&a, 0.0) => negated(b),
        _ => Expression::Binary(operator, Box::new(a), Box::new(b)),
    }
}

fn product(a: Expression, b: Expression) -> Expression {
    match () {
        () if is(&a, 0.0) || is(&b, 1.0) => a,
        () if is(&b, 0.0) || is(&a, 1.0) => b,
        () => Expression::Binary(Operator::Multiply, Box::new(a), Box::new(b)),
    }
}

fn quotient(a: Expression, b: Expression) -> Expression {
    if is(&a, 0.0) { a } else { Expression::Binary(Operator::Divide, Box::new(a), Box::new(b)) }
}

#[cfg(test)]
mod tests;
