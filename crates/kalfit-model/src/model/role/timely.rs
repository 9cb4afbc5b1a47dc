//! How a parameter occurs in motion, where the parameter may be a time constant τ.

use crate::model::{Expression, Function, Operator};

/// Dependence of a coefficient of motion on τ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Decay {
    /// No dependence, or one that does not determine the sign of τ.
    None,
    /// A decay: -c/τ in a rate, exp(-dt/τ) in a factor.
    Falling,
    /// Any other dependence, which a time constant cannot have.
    Other,
}

impl Expression {
    /// Dependence on τ of a coefficient of a derivative, from the form c/τ^k.
    pub(super) fn rate(&self, parameter: usize) -> Decay {
        match self.exponents(parameter) {
            Some(exponents) if exponents.iter().all(|k| *k == 0.0) => Decay::None,
            Some(exponents) if exponents.iter().all(|k| *k <= 0.0) => {
                if self.is_negative() {
                    Decay::Falling
                } else {
                    Decay::None
                }
            }
            _ => Decay::Other,
        }
    }

    /// Dependence on τ of a coefficient of a step: a decay if τ occurs only in exp(-dt/τ).
    pub(super) fn decay(&self, parameter: usize) -> Decay {
        let of = |part: &Expression| part.decay(parameter);
        match self {
            Expression::Parameter(index) if *index == parameter => Decay::Other,
            Expression::Call(Function::Exp, arguments) => match arguments[0].rate(parameter) {
                Decay::Falling if arguments[0].any(&mut |part| *part == Expression::Step) => Decay::Falling,
                Decay::None if of(&arguments[0]) == Decay::None => Decay::None,
                _ => Decay::Other,
            },
            Expression::Negate(a) => of(a),
            Expression::Binary(
                Operator::Add | Operator::Subtract | Operator::Multiply | Operator::Divide | Operator::Power,
                a,
                b,
            ) => of(a).max(of(b)),
            Expression::Call(Function::Sqrt, arguments) => of(&arguments[0]),
            Expression::If(condition, a, b) if of(condition) == Decay::None => of(a).max(of(b)),
            _ => {
                if self.mentions(parameter) {
                    Decay::Other
                } else {
                    Decay::None
                }
            }
        }
    }
}
