//! Writing expressions and linear forms as a person would.

use kalfit::Model;
use kalfit::model::{Expression, Function, Linear, Operator};

use crate::expression::{ONE, is_name, is_zero, symbol};

/// How tightly a written expression holds together; larger is tighter.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
enum Grip {
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

/// An expression with the names of a model.
pub(crate) fn expression(model: &Model, a: &Expression) -> String {
    write(model, a).0
}

/// A linear form with the names of a model.
pub(crate) fn linear(model: &Model, form: &Linear) -> String {
    let mut text = String::new();
    let mut join = |(part, _): (String, Grip)| match part.strip_prefix('-') {
        _ if text.is_empty() => text = part,
        Some(rest) => text = format!("{text} - {rest}"),
        None => text = format!("{text} + {part}"),
    };
    for (state, coefficient) in &form.terms {
        join(term(model, *state, coefficient));
    }
    if !is_zero(&form.constant) || form.terms.is_empty() {
        join(write(model, &form.constant));
    }
    text
}

fn term(model: &Model, state: usize, coefficient: &Expression) -> (String, Grip) {
    let name = &model.states[state].name;
    match coefficient {
        a if *a == ONE => (name.clone(), Grip::Atom),
        Expression::Number(-1.0) => (format!("-{name}"), Grip::Minus),
        Expression::Negate(inside) => {
            (format!("-{} * {name}", enclosed(write(model, inside), Grip::Product)), Grip::Product)
        }
        a => (format!("{} * {name}", enclosed(write(model, a), Grip::Product)), Grip::Product),
    }
}

fn enclosed((text, grip): (String, Grip), least: Grip) -> String {
    if grip < least { format!("({text})") } else { text }
}

fn write(model: &Model, a: &Expression) -> (String, Grip) {
    let atom = |text: String| (text, Grip::Atom);
    match a {
        Expression::Number(x) if *x < 0.0 => (x.to_string(), Grip::Minus),
        Expression::Number(x) => atom(x.to_string()),
        Expression::Column(column) => atom(quoted(&model.columns[*column].name)),
        Expression::Step => atom("dt".to_owned()),
        Expression::Parameter(index) => atom(model.parameters[*index].name.clone()),
        Expression::TextEquals { column, literal } => {
            let text = model.literals[*literal].replace('\'', "''");
            (format!("{} == '{text}'", quoted(&model.text_columns[*column].name)), Grip::Comparison)
        }
        Expression::Negate(a) => (format!("-{}", enclosed(write(model, a), Grip::Minus)), Grip::Minus),
        Expression::Not(a) => (format!("not {}", enclosed(write(model, a), Grip::Not)), Grip::Not),
        Expression::Binary(operator, a, b) => binary(model, *operator, a, b),
        Expression::Call(function, arguments) => atom(format!("{}({})", name(*function), list(model, arguments))),
        Expression::If(a, b, c) => {
            let parts = [a, b, c].map(|part| expression(model, part));
            atom(format!("if({})", parts.join(", ")))
        }
    }
}

fn binary(model: &Model, operator: Operator, a: &Expression, b: &Expression) -> (String, Grip) {
    let grip = match operator {
        Operator::Or => Grip::Or,
        Operator::And => Grip::And,
        Operator::Add | Operator::Subtract => Grip::Sum,
        Operator::Multiply | Operator::Divide => Grip::Product,
        Operator::Power => Grip::Power,
        _ => Grip::Comparison,
    };
    if operator == Operator::Multiply && a == b {
        return (format!("{}^2", enclosed(write(model, a), Grip::Atom)), Grip::Power);
    }
    let (left_least, right_least) = match operator {
        Operator::Power => (Grip::Atom, Grip::Minus),
        Operator::Add | Operator::And | Operator::Or => (grip, grip),
        Operator::Multiply => (grip, Grip::Minus),
        Operator::Subtract => (grip, Grip::Product),
        Operator::Divide => (grip, Grip::Minus),
        _ => (Grip::Sum, Grip::Sum),
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

/// The name of a column as expressions hold it.
fn quoted(name: &str) -> String {
    if is_name(name) { name.to_owned() } else { format!("`{name}`") }
}

fn name(function: Function) -> &'static str {
    match function {
        Function::Sqrt => "sqrt",
        Function::Exp => "exp",
        Function::Log => "log",
        Function::Sin => "sin",
        Function::Cos => "cos",
        Function::Tan => "tan",
        Function::Abs => "abs",
        Function::Min => "min",
        Function::Max => "max",
    }
}
