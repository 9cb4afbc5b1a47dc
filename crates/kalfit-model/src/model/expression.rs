//! Coefficients: numbers that depend on a row of the data and on the parameters.

use std::collections::BTreeSet;

use crate::ensemble::Label;
use crate::model::{Alpha, EvaluationError};

/// An expression without states. Any number but zero counts as true.
#[derive(Debug, Clone, PartialEq)]
pub enum Expression {
    /// A constant.
    Number(f64),
    /// Cell of the numeric column with this index.
    Column(usize),
    /// `dt`: time since the previous step of the test; at the first step, time since x_0.
    Step,
    /// Value of the parameter with this index, at the level of the row.
    Parameter(usize),
    /// 1 where the cell of a text column is the literal with this index, else 0.
    TextEquals {
        /// Index of the text column.
        column: usize,
        /// Index of the literal in [`Model::literals`](crate::model::Model::literals).
        literal: usize,
    },
    /// -a.
    Negate(Box<Expression>),
    /// 1 where a is zero, else 0.
    Not(Box<Expression>),
    /// a ∘ b.
    Binary(Operator, Box<Expression>, Box<Expression>),
    /// f(a) or f(a, b, …).
    Call(Function, Vec<Expression>),
    /// b where a is true, else c; only the chosen branch is evaluated.
    If(Box<Expression>, Box<Expression>, Box<Expression>),
}

/// Binary operators.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Operator {
    Add,
    Subtract,
    Multiply,
    Divide,
    Power,
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
    Equal,
    NotEqual,
    And,
    Or,
}

/// Functions of one argument, and `min` and `max` of one or more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Function {
    Sqrt,
    Exp,
    Log,
    Sin,
    Cos,
    Tan,
    Abs,
    Min,
    Max,
}

/// What an expression is evaluated on: one row at one α.
#[derive(Debug, Clone, Copy)]
pub struct Scope<'a> {
    /// Numeric cells of the row; NaN is missing.
    pub numbers: &'a [f64],
    /// Text cells of the row.
    pub texts: &'a [Label],
    /// Value of `dt`.
    pub step: f64,
    /// Values of the parameters.
    pub alpha: &'a Alpha,
}

impl Expression {
    /// Value of the expression on a row: finite, or an error.
    pub fn evaluate(&self, scope: &Scope<'_>) -> Result<f64, EvaluationError> {
        let value = match self {
            Expression::Number(x) => return Ok(*x),
            Expression::Column(column) => {
                let cell = scope.numbers[*column];
                return if cell.is_nan() { Err(EvaluationError::MissingNumber { column: *column }) } else { Ok(cell) };
            }
            Expression::Step => scope.step,
            Expression::Parameter(index) => return scope.alpha.value(*index, scope.texts),
            Expression::TextEquals { column, literal } => {
                let cell = scope.texts[*column];
                if cell.is_missing() {
                    return Err(EvaluationError::MissingText { column: *column });
                }
                truth(cell.index() == *literal)
            }
            Expression::Negate(a) => -a.evaluate(scope)?,
            Expression::Not(a) => truth(a.evaluate(scope)? == 0.0),
            Expression::Binary(operator, a, b) => operator.evaluate(a, b, scope)?,
            Expression::Call(function, arguments) => function.evaluate(arguments, scope)?,
            Expression::If(condition, a, b) => {
                return if condition.evaluate(scope)? != 0.0 { a.evaluate(scope) } else { b.evaluate(scope) };
            }
        };
        if value.is_finite() { Ok(value) } else { Err(EvaluationError::NotFinite) }
    }

    /// The number, if the expression is [`Expression::Number`].
    pub fn as_number(&self) -> Option<f64> {
        match self {
            Expression::Number(x) => Some(*x),
            _ => None,
        }
    }

    /// Whether `test` is true for this expression or for any part of this expression.
    pub fn any(&self, test: &mut dyn FnMut(&Expression) -> bool) -> bool {
        test(self)
            || match self {
                Expression::Negate(a) | Expression::Not(a) => a.any(test),
                Expression::Binary(_, a, b) => a.any(test) || b.any(test),
                Expression::Call(_, arguments) => arguments.iter().any(|a| a.any(test)),
                Expression::If(a, b, c) => a.any(test) || b.any(test) || c.any(test),
                _ => false,
            }
    }

    /// Whether the expression contains the parameter with this index.
    pub fn mentions(&self, parameter: usize) -> bool {
        self.any(&mut |part| matches!(part, Expression::Parameter(index) if *index == parameter))
    }

    /// Indices of the parameters in the expression.
    pub fn parameters(&self) -> BTreeSet<usize> {
        let mut all = BTreeSet::new();
        self.any(&mut |part| {
            if let Expression::Parameter(index) = part {
                all.insert(*index);
            }
            false
        });
        all
    }

    /// The expression with `other(k)` in place of each parameter k for which `other(k)` is not `None`.
    pub fn replaced(&self, other: &dyn Fn(usize) -> Option<Expression>) -> Expression {
        let of = |part: &Expression| Box::new(part.replaced(other));
        match self {
            Expression::Parameter(index) => other(*index).unwrap_or_else(|| self.clone()),
            Expression::Negate(a) => Expression::Negate(of(a)),
            Expression::Not(a) => Expression::Not(of(a)),
            Expression::Binary(operator, a, b) => Expression::Binary(*operator, of(a), of(b)),
            Expression::Call(function, arguments) => {
                Expression::Call(*function, arguments.iter().map(|argument| argument.replaced(other)).collect())
            }
            Expression::If(a, b, c) => Expression::If(of(a), of(b), of(c)),
            Expression::Number(_) | Expression::Column(_) | Expression::Step | Expression::TextEquals { .. } => {
                self.clone()
            }
        }
    }
}

impl Operator {
    fn evaluate(self, a: &Expression, b: &Expression, scope: &Scope<'_>) -> Result<f64, EvaluationError> {
        let a = a.evaluate(scope)?;
        match self {
            Operator::And if a == 0.0 => return Ok(0.0),
            Operator::Or if a != 0.0 => return Ok(1.0),
            _ => {}
        }
        let b = b.evaluate(scope)?;
        Ok(self.of(a, b))
    }

    /// a ∘ b.
    pub(super) fn of(self, a: f64, b: f64) -> f64 {
        match self {
            Operator::Add => a + b,
            Operator::Subtract => a - b,
            Operator::Multiply => a * b,
            Operator::Divide => a / b,
            Operator::Power => a.powf(b),
            Operator::Less => truth(a < b),
            Operator::LessEqual => truth(a <= b),
            Operator::Greater => truth(a > b),
            Operator::GreaterEqual => truth(a >= b),
            Operator::Equal => truth(a == b),
            Operator::NotEqual => truth(a != b),
            Operator::And => truth(a != 0.0 && b != 0.0),
            Operator::Or => truth(a != 0.0 || b != 0.0),
        }
    }
}

impl Function {
    fn evaluate(self, arguments: &[Expression], scope: &Scope<'_>) -> Result<f64, EvaluationError> {
        let first = arguments[0].evaluate(scope)?;
        let rest = if matches!(self, Function::Min | Function::Max) { &arguments[1..] } else { &[] };
        rest.iter().try_fold(self.of(first), |best, argument| Ok(self.choose(best, argument.evaluate(scope)?)))
    }

    /// f(a).
    pub(super) fn of(self, a: f64) -> f64 {
        match self {
            Function::Sqrt => a.sqrt(),
            Function::Exp => a.exp(),
            Function::Log => a.ln(),
            Function::Sin => a.sin(),
            Function::Cos => a.cos(),
            Function::Tan => a.tan(),
            Function::Abs => a.abs(),
            Function::Min | Function::Max => a,
        }
    }

    /// min(a, b) or max(a, b).
    pub(super) fn choose(self, a: f64, b: f64) -> f64 {
        if self == Function::Min { a.min(b) } else { a.max(b) }
    }
}

fn truth(condition: bool) -> f64 {
    f64::from(u8::from(condition))
}
