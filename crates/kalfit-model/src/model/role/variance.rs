//! How a parameter occurs in a variance.

use crate::model::{Expression, Function, Operator};

/// Role of a parameter θ in an expression that is a variance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Use {
    /// θ does not occur.
    Absent,
    /// A standard deviation: the variance is even in θ.
    Deviation,
    /// A variance: θ is a factor, or a term of a sum whose other terms cannot be negative.
    Variance,
    /// Any other role.
    Other,
}

impl Expression {
    /// Role of θ in this expression, which is a variance.
    pub(super) fn use_as_variance(&self, parameter: usize) -> Use {
        let of = |part: &Expression| part.use_as_variance(parameter);
        let found = match self {
            Expression::Parameter(index) if *index == parameter => Use::Variance,
            Expression::Negate(a) => reject_odd(of(a)),
            Expression::Binary(Operator::Multiply, a, b) if a == b => a.use_as_deviation(parameter),
            Expression::Binary(Operator::Multiply | Operator::Divide, a, b) => {
                let both = of(a).max(of(b));
                if a.is_negative() != b.is_negative() { reject_odd(both) } else { both }
            }
            Expression::Binary(Operator::Power, a, n) => match n.as_number() {
                Some(n) if n % 2.0 == 0.0 => a.use_as_deviation(parameter),
                Some(_) => of(a),
                None => self.absent_or_other(parameter),
            },
            Expression::Binary(Operator::Add, a, b) => {
                let both = of(a).max(of(b));
                if both == Use::Variance && !self.adds_variances() { Use::Other } else { both }
            }
            Expression::Binary(Operator::Subtract, a, b) => reject_odd(of(a).max(of(b))),
            Expression::Call(Function::Sqrt | Function::Abs, arguments) => of(&arguments[0]),
            Expression::Call(Function::Min | Function::Max, arguments) => strictest(arguments.iter().map(of)),
            Expression::If(condition, a, b) => condition.absent_or_other(parameter).max(of(a)).max(of(b)),
            _ => self.absent_or_other(parameter),
        };
        if found == Use::Other && self.is_multiple(parameter) { Use::Variance } else { found }
    }

    /// Role of θ in this expression, which is a standard deviation.
    fn use_as_deviation(&self, parameter: usize) -> Use {
        let of = |part: &Expression| part.use_as_deviation(parameter);
        let found = match self {
            Expression::Parameter(index) if *index == parameter => Use::Deviation,
            Expression::Negate(a) => of(a),
            Expression::Binary(Operator::Multiply | Operator::Divide, a, b) => of(a).max(of(b)),
            Expression::Binary(Operator::Power, a, n) => match n.as_number() {
                Some(n) if n.fract() == 0.0 => of(a),
                Some(n) if (2.0 * n).fract() == 0.0 => a.use_as_variance(parameter),
                _ => self.absent_or_other(parameter),
            },
            Expression::Binary(Operator::Add | Operator::Subtract, a, b) => {
                reject_odd(a.use_as_variance(parameter).max(b.use_as_variance(parameter)))
            }
            Expression::Call(Function::Sqrt, arguments) => arguments[0].use_as_variance(parameter),
            Expression::Call(Function::Abs, arguments) => of(&arguments[0]),
            Expression::Call(Function::Min | Function::Max, arguments) => strictest(arguments.iter().map(of)),
            Expression::If(condition, a, b) => condition.absent_or_other(parameter).max(of(a)).max(of(b)),
            _ => self.absent_or_other(parameter),
        };
        if found == Use::Other && self.is_multiple(parameter) { Use::Deviation } else { found }
    }

    /// Role of θ in an expression that is no product of scales: [`Use::Absent`] or [`Use::Other`].
    fn absent_or_other(&self, parameter: usize) -> Use {
        if self.mentions(parameter) { Use::Other } else { Use::Absent }
    }

    /// Whether the expression is θ times a factor without θ.
    fn is_multiple(&self, parameter: usize) -> bool {
        self.exponents(parameter).is_some_and(|exponents| exponents == [1.0]) && !self.is_negative()
    }

    /// Whether each term of the sum contains no parameter, is an even function of each of its parameters, or is a
    /// product of parameters and numbers alone.
    fn adds_variances(&self) -> bool {
        if let Expression::Binary(Operator::Add, a, b) = self {
            return a.adds_variances() && b.adds_variances();
        }
        if let Expression::If(_, a, b) = self {
            return a.adds_variances() && b.adds_variances();
        }
        let in_product = |part: &Expression| {
            matches!(
                part,
                Expression::Parameter(_) | Expression::Number(_) | Expression::Binary(Operator::Multiply, ..)
            )
        };
        let bare = !self.is_negative() && !self.any(&mut |part| !in_product(part));
        bare || self.parameters().into_iter().all(|parameter| self.use_as_variance(parameter) == Use::Deviation)
    }

    /// Whether the expression has a negative sign.
    pub(super) fn is_negative(&self) -> bool {
        match self {
            Expression::Number(x) => *x < 0.0,
            Expression::Negate(a) => !a.is_negative(),
            Expression::Binary(Operator::Multiply | Operator::Divide, a, b) => a.is_negative() != b.is_negative(),
            Expression::If(_, a, b) => a.is_negative() && b.is_negative(),
            _ => false,
        }
    }
}

/// With a minus sign, an expression that is odd in θ is not a variance.
fn reject_odd(found: Use) -> Use {
    if found == Use::Variance { Use::Other } else { found }
}

fn strictest(uses: impl Iterator<Item = Use>) -> Use {
    uses.fold(Use::Absent, Use::max)
}
