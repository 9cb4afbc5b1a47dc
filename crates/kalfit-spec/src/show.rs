//! Writing expressions and linear forms as a person would.

use kalfit::Model;
use kalfit::model::{Expression, Linear, Operator};
use kalfit::record::Words;

use crate::expression::{ONE, is_zero};
use crate::figure::figure;
use crate::spec::Spec;
use crate::token::is_name;
use crate::vocabulary::{self, symbol};

/// How tightly a written expression holds together; larger is tighter.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
enum Precedence {
    Or,
    And,
    Not,
    Comparison,
    Sum,
    Product,
    Minus,
    Power,
    Atom,
}

/// Puts expressions of one phase of a model into words.
#[derive(Debug)]
pub struct PhaseWords<'a>(&'a Model);

impl Spec {
    /// What puts expressions of a phase into words, with the names of its states, parameters and columns.
    pub fn words(&self, phase: usize) -> PhaseWords<'_> {
        PhaseWords(&self.model.phases[phase].model)
    }
}

impl Words for PhaseWords<'_> {
    fn of(&self, a: &Expression) -> String {
        expression(self.0, a)
    }
}

/// Noise by its standard deviation where that is what was written, else by its variance; true for a standard deviation.
pub(crate) fn noise(model: &Model, variance: &Expression) -> (String, bool) {
    let deviation = match variance {
        Expression::Binary(Operator::Multiply, a, b) if a == b => Some(expression(model, a)),
        Expression::Number(x) => Some(figure(x.sqrt())).filter(|root| root.len() < figure(*x).len()),
        _ => None,
    };
    match deviation {
        Some(deviation) => (format!("noise of standard deviation {deviation}"), true),
        None => (format!("noise of variance {}", expression(model, variance)), false),
    }
}

/// An expression with the names of a model.
pub(crate) fn expression(model: &Model, a: &Expression) -> String {
    write(model, a).0
}

/// A linear form with the names of a model.
pub(crate) fn linear(model: &Model, form: &Linear) -> String {
    let mut parts: Vec<String> =
        form.terms.iter().map(|(state, coefficient)| term(model, *state, coefficient)).collect();
    if !is_zero(&form.constant) || form.terms.is_empty() {
        parts.push(enclosed(write(model, &form.constant), Precedence::Sum));
    }
    sum(&parts)
}

/// "a + b - c" of the parts a, b and -c.
pub(crate) fn sum(parts: &[String]) -> String {
    let mut text = String::new();
    for part in parts {
        match part.strip_prefix('-') {
            _ if text.is_empty() => text.clone_from(part),
            Some(rest) => text = format!("{text} - {rest}"),
            None => text = format!("{text} + {part}"),
        }
    }
    text
}

fn term(model: &Model, state: usize, coefficient: &Expression) -> String {
    let name = &model.states[state].name;
    match coefficient {
        a if *a == ONE => name.clone(),
        Expression::Number(-1.0) => format!("-{name}"),
        Expression::Negate(inside) => {
            format!("-{} * {name}", enclosed(write(model, inside), Precedence::Product))
        }
        a => format!("{} * {name}", enclosed(write(model, a), Precedence::Product)),
    }
}

fn enclosed((text, grip): (String, Precedence), least: Precedence) -> String {
    if grip < least { format!("({text})") } else { text }
}

fn write(model: &Model, a: &Expression) -> (String, Precedence) {
    let atom = |text: String| (text, Precedence::Atom);
    match a {
        Expression::Number(x) if *x < 0.0 => (figure(*x), Precedence::Minus),
        Expression::Number(x) => atom(figure(*x)),
        Expression::Column(column) => atom(quoted(model, &model.columns[*column].name)),
        Expression::Step => atom("dt".to_owned()),
        Expression::Parameter(index) => atom(model.parameters[*index].name.clone()),
        Expression::TextEquals { column, literal } => {
            let text = model.literals[*literal].replace('\'', "''");
            (format!("{} == '{text}'", quoted(model, &model.text_columns[*column].name)), Precedence::Comparison)
        }
        Expression::Negate(a) => (format!("-{}", enclosed(write(model, a), Precedence::Minus)), Precedence::Minus),
        Expression::Not(a) => (format!("not {}", enclosed(write(model, a), Precedence::Not)), Precedence::Not),
        Expression::Binary(operator, a, b) => binary(model, *operator, a, b),
        Expression::Call(function, arguments) => {
            atom(format!("{}({})", vocabulary::function(*function), list(model, arguments)))
        }
        Expression::If(a, b, c) => {
            let parts = [a, b, c].map(|part| expression(model, part));
            atom(format!("if({})", parts.join(", ")))
        }
    }
}

fn binary(model: &Model, operator: Operator, a: &Expression, b: &Expression) -> (String, Precedence) {
    let grip = match operator {
        Operator::Or => Precedence::Or,
        Operator::And => Precedence::And,
        Operator::Add | Operator::Subtract => Precedence::Sum,
        Operator::Multiply | Operator::Divide => Precedence::Product,
        Operator::Power => Precedence::Power,
        _ => Precedence::Comparison,
    };
    if operator == Operator::Multiply && a == b {
        return (format!("{}^2", enclosed(write(model, a), Precedence::Atom)), Precedence::Power);
    }
    let (left_least, right_least) = match operator {
        Operator::Power => (Precedence::Atom, Precedence::Minus),
        Operator::Add | Operator::And | Operator::Or => (grip, grip),
        Operator::Multiply => (grip, Precedence::Minus),
        Operator::Subtract => (grip, Precedence::Product),
        Operator::Divide => (grip, Precedence::Minus),
        _ => (Precedence::Sum, Precedence::Sum),
    };
    let (left, right) = (enclosed(write(model, a), left_least), enclosed(write(model, b), right_least));
    let symbol = symbol(operator);
    match operator {
        Operator::Power => (format!("{left}{symbol}{right}"), grip),
        _ => (format!("{left} {symbol} {right}"), grip),
    }
}

fn list(model: &Model, arguments: &[Expression]) -> String {
    arguments.iter().map(|a| expression(model, a)).collect::<Vec<_>>().join(", ")
}

/// The name of a column as expressions hold it: in backticks where a state or a parameter hides it.
fn quoted(model: &Model, name: &str) -> String {
    let hidden = model.states.iter().any(|state| state.name == name)
        || model.parameters.iter().any(|parameter| parameter.name == name);
    if is_name(name) && !hidden { name.to_owned() } else { format!("`{name}`") }
}
