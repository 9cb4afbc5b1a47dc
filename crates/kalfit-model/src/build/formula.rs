//! Expressions that refer to states, parameters and columns by name.

use std::ops::{Add, Div, Mul, Neg, Not, Sub};

use crate::model::{Function, Operator};

/// An expression in states, parameters and columns, given by name. Numbers and names convert into formulas; the usual
/// operators combine formulas and numbers. Any number but zero counts as true.
///
/// ```
/// # use kalfit_model as kalfit;
/// use kalfit::build::{dt, name};
///
/// let line = name("intercept") + name("slope") * (name("day") - 3.0);
/// let decay = (-dt() / name("tau")).exp();
/// assert_ne!(line, decay);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Formula(pub(super) Node);

/// Node in the tree of a formula.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Node {
    Number(f64),
    Name(String),
    Step,
    TextIs { column: String, text: String },
    Negate(Box<Node>),
    Not(Box<Node>),
    Binary(Operator, Box<Node>, Box<Node>),
    Call(Function, Vec<Node>),
    When(Box<Node>, Box<Node>, Box<Node>),
}

/// The state or parameter of this name or, if the model has neither, the column of this name in the data.
pub fn name(name: impl Into<String>) -> Formula {
    Formula(Node::Name(name.into()))
}

/// The time since the previous step of the test.
pub fn dt() -> Formula {
    Formula(Node::Step)
}

/// 1 where the cell of a column of texts is `text`, else 0.
pub fn text_is(column: impl Into<String>, text: impl Into<String>) -> Formula {
    Formula(Node::TextIs { column: column.into(), text: text.into() })
}

/// `then` where the condition holds, else `otherwise`.
pub fn when(condition: Formula, then: impl Into<Formula>, otherwise: impl Into<Formula>) -> Formula {
    Formula(Node::When(Box::new(condition.0), Box::new(then.into().0), Box::new(otherwise.into().0)))
}

impl Formula {
    fn binary(self, operator: Operator, other: impl Into<Formula>) -> Formula {
        Formula(Node::Binary(operator, Box::new(self.0), Box::new(other.into().0)))
    }

    fn call(self, function: Function) -> Formula {
        Formula(Node::Call(function, vec![self.0]))
    }

    /// √x.
    #[must_use]
    pub fn sqrt(self) -> Formula {
        self.call(Function::Sqrt)
    }

    /// eˣ.
    #[must_use]
    pub fn exp(self) -> Formula {
        self.call(Function::Exp)
    }

    /// The natural logarithm.
    #[must_use]
    pub fn ln(self) -> Formula {
        self.call(Function::Log)
    }

    /// sin x, of radians.
    #[must_use]
    pub fn sin(self) -> Formula {
        self.call(Function::Sin)
    }

    /// cos x, of radians.
    #[must_use]
    pub fn cos(self) -> Formula {
        self.call(Function::Cos)
    }

    /// tan x, of radians.
    #[must_use]
    pub fn tan(self) -> Formula {
        self.call(Function::Tan)
    }

    /// |x|.
    #[must_use]
    pub fn abs(self) -> Formula {
        self.call(Function::Abs)
    }

    /// x to a power.
    #[must_use]
    pub fn power(self, exponent: impl Into<Formula>) -> Formula {
        self.binary(Operator::Power, exponent)
    }

    /// The smaller of this formula and `other`.
    #[must_use]
    pub fn min(self, other: impl Into<Formula>) -> Formula {
        Formula(Node::Call(Function::Min, vec![self.0, other.into().0]))
    }

    /// The larger of this formula and `other`.
    #[must_use]
    pub fn max(self, other: impl Into<Formula>) -> Formula {
        Formula(Node::Call(Function::Max, vec![self.0, other.into().0]))
    }

    /// Whether this formula is less than `other`.
    #[must_use]
    pub fn less_than(self, other: impl Into<Formula>) -> Formula {
        self.binary(Operator::Less, other)
    }

    /// Whether this formula is more than `other`.
    #[must_use]
    pub fn more_than(self, other: impl Into<Formula>) -> Formula {
        self.binary(Operator::Greater, other)
    }

    /// Whether this formula equals `other`.
    #[must_use]
    pub fn equals(self, other: impl Into<Formula>) -> Formula {
        self.binary(Operator::Equal, other)
    }

    /// Whether this formula and `other` are true.
    #[must_use]
    pub fn and(self, other: impl Into<Formula>) -> Formula {
        self.binary(Operator::And, other)
    }

    /// Whether this formula or `other` is true.
    #[must_use]
    pub fn or(self, other: impl Into<Formula>) -> Formula {
        self.binary(Operator::Or, other)
    }
}

impl From<f64> for Formula {
    fn from(number: f64) -> Formula {
        Formula(Node::Number(number))
    }
}

impl From<&str> for Formula {
    fn from(text: &str) -> Formula {
        name(text)
    }
}

impl From<String> for Formula {
    fn from(text: String) -> Formula {
        name(text)
    }
}

impl Neg for Formula {
    type Output = Formula;

    fn neg(self) -> Formula {
        Formula(Node::Negate(Box::new(self.0)))
    }
}

impl Not for Formula {
    type Output = Formula;

    fn not(self) -> Formula {
        Formula(Node::Not(Box::new(self.0)))
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $operator:ident) => {
        impl<T: Into<Formula>> $trait<T> for Formula {
            type Output = Formula;

            fn $method(self, other: T) -> Formula {
                self.binary(Operator::$operator, other)
            }
        }

        impl $trait<Formula> for f64 {
            type Output = Formula;

            fn $method(self, other: Formula) -> Formula {
                Formula::from(self).binary(Operator::$operator, other)
            }
        }
    };
}

operator!(Add, add, Add);
operator!(Sub, sub, Subtract);
operator!(Mul, mul, Multiply);
operator!(Div, div, Divide);
