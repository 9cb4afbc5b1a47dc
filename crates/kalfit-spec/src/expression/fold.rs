//! Building expressions with constants folded. Only exact rewritings are done (1·x, x + 0, two numbers), so that a
//! folded expression has the value of the unfolded one on every row, and needs the same cells.

use kalfit::model::{Expression, Function, Operator};

use crate::error::ExpressionProblem;

type FoldedExpression = Result<Expression, ExpressionProblem>;

pub(crate) const ZERO: Expression = Expression::Number(0.0);
pub(crate) const ONE: Expression = Expression::Number(1.0);

/// True for the constant zero.
pub(crate) fn is_zero(a: &Expression) -> bool {
    is(a, 0.0)
}

fn is(a: &Expression, value: f64) -> bool {
    a.as_number().is_some_and(|x| x == value)
}

fn finite(x: f64) -> FoldedExpression {
    if x.is_finite() { Ok(Expression::Number(x)) } else { Err(ExpressionProblem::NotFinite) }
}

fn truth(condition: bool) -> Expression {
    Expression::Number(f64::from(u8::from(condition)))
}

/// -a.
pub(crate) fn negate(a: Expression) -> Expression {
    match a {
        Expression::Number(x) => Expression::Number(-x),
        Expression::Negate(inside) => *inside,
        other => Expression::Negate(Box::new(other)),
    }
}

/// 1 where a is zero.
pub(crate) fn not(a: Expression) -> Expression {
    match a {
        Expression::Number(x) => truth(x == 0.0),
        other => Expression::Not(Box::new(other)),
    }
}

/// a ∘ b.
pub(crate) fn binary(operator: Operator, a: Expression, b: Expression) -> FoldedExpression {
    if operator == Operator::Divide && is_zero(&b) {
        return Err(ExpressionProblem::DivisionByZero);
    }
    if let (Some(x), Some(y)) = (a.as_number(), b.as_number()) {
        return constant(operator, x, y);
    }
    Ok(match operator {
        Operator::Add if is_zero(&a) => b,
        Operator::Add | Operator::Subtract if is_zero(&b) => a,
        Operator::Subtract if is_zero(&a) => negate(b),
        Operator::Multiply if is(&a, 1.0) => b,
        Operator::Multiply | Operator::Divide | Operator::Power if is(&b, 1.0) => a,
        Operator::And if a.as_number().is_some_and(|x| x != 0.0) => b,
        Operator::And if is_zero(&a) => a,
        Operator::Or if is_zero(&a) => b,
        Operator::Or if a.as_number().is_some() => truth(true),
        _ => Expression::Binary(operator, Box::new(a), Box::new(b)),
    })
}

fn constant(operator: Operator, x: f64, y: f64) -> FoldedExpression {
    Ok(match operator {
        Operator::Add => return finite(x + y),
        Operator::Subtract => return finite(x - y),
        Operator::Multiply => return finite(x * y),
        Operator::Divide => return finite(x / y),
        Operator::Power => return finite(x.powf(y)),
        Operator::Less => truth(x < y),
        Operator::LessEqual => truth(x <= y),
        Operator::Greater => truth(x > y),
        Operator::GreaterEqual => truth(x >= y),
        Operator::Equal => truth(x == y),
        Operator::NotEqual => truth(x != y),
        Operator::And => truth(x != 0.0 && y != 0.0),
        Operator::Or => truth(x != 0.0 || y != 0.0),
    })
}

/// f(a, …). The number of arguments is right.
pub(crate) fn call(function: Function, arguments: Vec<Expression>) -> FoldedExpression {
    let numbers: Option<Vec<f64>> = arguments.iter().map(Expression::as_number).collect();
    let Some(numbers) = numbers else { return Ok(Expression::Call(function, arguments)) };
    let (first, rest) = numbers.split_first().expect("a function has an argument");
    finite(match function {
        Function::Sqrt => first.sqrt(),
        Function::Exp => first.exp(),
        Function::Log => first.ln(),
        Function::Sin => first.sin(),
        Function::Cos => first.cos(),
        Function::Tan => first.tan(),
        Function::Abs => first.abs(),
        Function::Min => rest.iter().copied().fold(*first, f64::min),
        Function::Max => rest.iter().copied().fold(*first, f64::max),
    })
}

/// b where the condition holds, else c.
pub(crate) fn choose(condition: &Expression, b: Expression, c: Expression) -> Expression {
    match condition.as_number() {
        Some(x) if x != 0.0 => b,
        Some(_) => c,
        None => Expression::If(Box::new(condition.clone()), Box::new(b), Box::new(c)),
    }
}

/// a².
pub(crate) fn square(a: Expression) -> FoldedExpression {
    binary(Operator::Multiply, a.clone(), a)
}

/// Number of parts.
pub(crate) fn size(a: &Expression) -> usize {
    1 + match a {
        Expression::Negate(a) | Expression::Not(a) => size(a),
        Expression::Binary(_, a, b) => size(a) + size(b),
        Expression::Call(_, arguments) => arguments.iter().map(size).sum(),
        Expression::If(a, b, c) => size(a) + size(b) + size(c),
        _ => 0,
    }
}
