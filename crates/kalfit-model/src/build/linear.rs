//! Formulas taken apart into exact linear forms in the states, or into expressions without states.

use std::collections::{BTreeMap, BTreeSet};

use crate::build::BuildError;
use crate::build::formula::{Formula, Node};
use crate::build::names::{Names, Role};
use crate::model::{Expression, Linear, Operator};

pub(super) const ZERO: Expression = Expression::Number(0.0);
pub(super) const ONE: Expression = Expression::Number(1.0);

/// Unfinished linear form Σ coefficient × state + constant; `terms` maps the index of a state to the coefficient.
struct Form {
    terms: BTreeMap<usize, Expression>,
    constant: Expression,
}

/// The linear form of an equation in states.
pub(super) fn linear(names: &mut Names, formula: &Formula, place: &str) -> Result<Linear, BuildError> {
    let form = FormulaReader { names, place }.form(&formula.0)?;
    let terms = form.terms.into_iter().filter(|(_, coefficient)| *coefficient != ZERO).collect();
    Ok(Linear { terms, constant: form.constant })
}

/// The expression of a formula without states.
pub(super) fn scalar(names: &mut Names, formula: &Formula, place: &str) -> Result<Expression, BuildError> {
    let form = FormulaReader { names: &mut *names, place }.form(&formula.0)?;
    match form.terms.keys().next() {
        None => Ok(form.constant),
        Some(&state) => Err(BuildError::HasState { place: place.to_owned(), state: names.states[state].clone() }),
    }
}

/// The expression of a formula whose value must not be negative or, for a time constant, must be positive.
pub(super) fn nonnegative(
    names: &mut Names,
    formula: &Formula,
    role: Role,
    place: &str,
) -> Result<Expression, BuildError> {
    let value = scalar(names, formula, place)?;
    if let Expression::Number(found) = value {
        role.check(found, place)?;
    }
    names.mark_role(&value, role);
    Ok(value)
}

/// The square of the expression of a formula for a standard deviation.
pub(super) fn squared(names: &mut Names, formula: &Formula, place: &str) -> Result<Expression, BuildError> {
    nonnegative(names, formula, Role::NonNegative, place).map(|deviation| multiply(deviation.clone(), deviation))
}

impl Role {
    /// Checks that a number in this role may have the value `found`.
    pub(super) fn check(self, found: f64, what: &str) -> Result<(), BuildError> {
        let expected = match self {
            Role::TimeConstant if found <= 0.0 => "more than 0",
            Role::NonNegative if found < 0.0 => "0 or more",
            _ if !found.is_finite() => "a finite number",
            _ => return Ok(()),
        };
        Err(BuildError::OutOfRange { what: what.to_owned(), found, expected: expected.to_owned() })
    }
}

struct FormulaReader<'a> {
    names: &'a mut Names,
    place: &'a str,
}

impl FormulaReader<'_> {
    fn form(&mut self, node: &Node) -> Result<Form, BuildError> {
        Ok(match node {
            Node::Name(name) => match self.names.state(name) {
                Some(state) => Form { terms: BTreeMap::from([(state, ONE)]), constant: ZERO },
                None => Form::from(self.names.scalar(name, self.place)),
            },
            Node::Negate(a) => self.form(a)?.map(negate),
            Node::Binary(Operator::Add, a, b) => self.form(a)?.merge(self.form(b)?, add),
            Node::Binary(Operator::Subtract, a, b) => self.form(a)?.merge(self.form(b)?.map(negate), add),
            Node::Binary(Operator::Multiply, a, b) => {
                let (a, b) = (self.form(a)?, self.form(b)?);
                let (form, factor) = if a.terms.is_empty() { (b, a) } else { (a, b) };
                let factor = self.constant(factor)?;
                form.map(|x| multiply(x, factor.clone()))
            }
            Node::Binary(Operator::Divide, a, b) => {
                let (a, b) = (self.form(a)?, self.scalar(b)?);
                a.map(|x| divide(x, b.clone()))
            }
            Node::When(condition, a, b) => {
                let condition = self.scalar(condition)?;
                let either = |a, b| Expression::If(Box::new(condition.clone()), Box::new(a), Box::new(b));
                self.form(a)?.merge(self.form(b)?, either)
            }
            other => Form::from(self.expression(other)?),
        })
    }

    /// The expression of a node in which no state may occur.
    fn expression(&mut self, node: &Node) -> Result<Expression, BuildError> {
        Ok(match node {
            Node::Number(x) if x.is_finite() => Expression::Number(*x),
            Node::Number(x) => {
                let (what, expected) = (format!("a number in {}", self.place), "a finite number".to_owned());
                return Err(BuildError::OutOfRange { what, found: *x, expected });
            }
            Node::Step if self.names.time => Expression::Step,
            Node::Step => return Err(BuildError::NoTime { place: self.place.to_owned() }),
            Node::TextIs { column, text } => Expression::TextEquals {
                column: self.names.text_column(column, self.place),
                literal: self.names.literal(text),
            },
            Node::Not(a) => Expression::Not(Box::new(self.scalar(a)?)),
            Node::Binary(operator, a, b) => {
                Expression::Binary(*operator, Box::new(self.scalar(a)?), Box::new(self.scalar(b)?))
            }
            Node::Call(function, arguments) => {
                Expression::Call(*function, arguments.iter().map(|a| self.scalar(a)).collect::<Result<_, _>>()?)
            }
            Node::Name(_) | Node::Negate(_) | Node::When(..) => self.scalar(node)?,
        })
    }

    fn scalar(&mut self, node: &Node) -> Result<Expression, BuildError> {
        let form = self.form(node)?;
        self.constant(form)
    }

    fn constant(&self, form: Form) -> Result<Expression, BuildError> {
        if form.terms.is_empty() {
            Ok(form.constant)
        } else {
            Err(BuildError::NotLinear { place: self.place.to_owned() })
        }
    }
}

impl From<Expression> for Form {
    fn from(constant: Expression) -> Form {
        Form { terms: BTreeMap::new(), constant }
    }
}

impl Form {
    fn map(self, f: impl Fn(Expression) -> Expression) -> Form {
        let terms = self.terms.into_iter().map(|(state, coefficient)| (state, f(coefficient))).collect();
        Form { terms, constant: f(self.constant) }
    }

    /// Combines two forms coefficient by coefficient; a state that one form lacks has coefficient zero.
    fn merge(mut self, mut other: Form, f: impl Fn(Expression, Expression) -> Expression) -> Form {
        let states: BTreeSet<usize> = self.terms.keys().chain(other.terms.keys()).copied().collect();
        let mut coefficient = |state| {
            let (a, b) = (self.terms.remove(&state), other.terms.remove(&state));
            (state, f(a.unwrap_or(ZERO), b.unwrap_or(ZERO)))
        };
        let terms = states.into_iter().map(&mut coefficient).collect();
        Form { terms, constant: f(self.constant, other.constant) }
    }
}

pub(super) fn negate(a: Expression) -> Expression {
    match a {
        Expression::Number(0.0) => ZERO, // avoids negative zero
        Expression::Number(x) => Expression::Number(-x),
        other => Expression::Negate(Box::new(other)),
    }
}

fn add(a: Expression, b: Expression) -> Expression {
    match (a, b) {
        (Expression::Number(x), Expression::Number(y)) => Expression::Number(x + y),
        (Expression::Number(0.0), other) | (other, Expression::Number(0.0)) => other,
        (a, b) => Expression::Binary(Operator::Add, Box::new(a), Box::new(b)),
    }
}

pub(super) fn multiply(a: Expression, b: Expression) -> Expression {
    match (a, b) {
        (Expression::Number(x), Expression::Number(y)) => Expression::Number(x * y),
        (Expression::Number(0.0), _) | (_, Expression::Number(0.0)) => ZERO,
        (Expression::Number(1.0), other) | (other, Expression::Number(1.0)) => other,
        (a, b) => Expression::Binary(Operator::Multiply, Box::new(a), Box::new(b)),
    }
}

pub(super) fn divide(a: Expression, b: Expression) -> Expression {
    match (a, b) {
        (Expression::Number(x), Expression::Number(y)) if y != 0.0 => Expression::Number(x / y),
        (other, Expression::Number(1.0)) => other,
        (a, b) => Expression::Binary(Operator::Divide, Box::new(a), Box::new(b)),
    }
}
