//! How expressions and models go with the scale of one parameter.

use crate::model::{Expression, Function, Model, Operator, Site};

/// How an expression goes with a parameter θ > 0.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Power {
    /// It is zero.
    Zero,
    /// It is θ to this power, times what does not depend on θ.
    Of(f64),
    /// In some other way.
    Other,
}

impl Power {
    /// That of a sum, and of an alternative.
    fn plus(self, other: Power) -> Power {
        match (self, other) {
            (Power::Zero, other) => other,
            (own, Power::Zero) => own,
            (Power::Of(a), Power::Of(b)) if a == b => self,
            _ => Power::Other,
        }
    }

    fn times(self, other: Power, sign: f64) -> Power {
        match (self, other) {
            (Power::Other, _) | (_, Power::Other) => Power::Other,
            (Power::Zero, _) | (_, Power::Zero) => Power::Zero,
            (Power::Of(a), Power::Of(b)) => Power::Of(a + sign * b),
        }
    }
}

impl Expression {
    fn power(&self, parameter: usize) -> Power {
        let flat = !self.mentions(parameter);
        match self {
            Expression::Number(0.0) => Power::Zero,
            Expression::Parameter(index) if *index == parameter => Power::Of(1.0),
            _ if flat => Power::Of(0.0),
            Expression::Negate(a) => a.power(parameter),
            Expression::Binary(operator, a, b) => binary(*operator, a, b, parameter),
            Expression::Call(function, arguments) => called(*function, arguments, parameter),
            Expression::If(condition, a, b) if condition.power(parameter) == Power::Of(0.0) => {
                a.power(parameter).plus(b.power(parameter))
            }
            _ => Power::Other,
        }
    }
}

fn binary(operator: Operator, a: &Expression, b: &Expression, parameter: usize) -> Power {
    let (left, right) = (a.power(parameter), b.power(parameter));
    match operator {
        Operator::Add | Operator::Subtract => left.plus(right),
        Operator::Multiply => left.times(right, 1.0),
        Operator::Divide if right != Power::Zero => left.times(right, -1.0),
        Operator::Power => match (left, b.as_number()) {
            (Power::Of(power), Some(exponent)) => Power::Of(power * exponent),
            _ => Power::Other,
        },
        _ => Power::Other,
    }
}

fn called(function: Function, arguments: &[Expression], parameter: usize) -> Power {
    let powers = || arguments.iter().map(|argument| argument.power(parameter));
    match (function, arguments) {
        (Function::Sqrt, [only]) => match only.power(parameter) {
            Power::Of(power) => Power::Of(0.5 * power),
            other => other,
        },
        (Function::Abs, [only]) => only.power(parameter),
        // zero among the arguments is one more size, which the others may fall short of or not, whatever θ is
        (Function::Min | Function::Max, _) => powers().fold(Power::Zero, Power::plus),
        _ => Power::Other,
    }
}

impl Model {
    /// k, where every variance of the model is proportional to θ^k, and nothing else, Σ apart, depends on θ: a scale of all
    /// noise there is.
    pub(crate) fn noise_power(&self, parameter: usize) -> Option<f64> {
        let flat = |e: &Expression| matches!(e.power(parameter), Power::Zero | Power::Of(0.0));
        let all: Vec<(Site, &Expression)> =
            self.expressions().into_iter().filter(|(site, _)| !matches!(site, Site::Structure { .. })).collect();
        let fixed = all.iter().all(|(site, expression)| site.is_variance() || flat(expression));
        let variances = all.iter().filter(|(site, _)| site.is_variance());
        let power = variances.map(|(_, variance)| variance.power(parameter)).fold(Power::Zero, Power::plus);
        match power {
            Power::Of(power) if fixed && power != 0.0 => Some(power),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn theta() -> Expression {
        Expression::Parameter(0)
    }

    fn of(operator: Operator, a: Expression, b: Expression) -> Expression {
        Expression::Binary(operator, Box::new(a), Box::new(b))
    }

    fn number(x: f64) -> Expression {
        Expression::Number(x)
    }

    #[test]
    fn powers_of_a_parameter_are_found_through_products_roots_and_sums() {
        let square = || of(Operator::Power, theta(), number(2.0));
        let product = of(Operator::Divide, of(Operator::Multiply, square(), Expression::Column(0)), Expression::Step);
        let sum = of(Operator::Add, product.clone(), of(Operator::Multiply, theta(), theta()));
        let root = Expression::Call(Function::Sqrt, vec![sum.clone()]);
        let largest = Expression::Call(Function::Max, vec![square(), product.clone(), number(0.0)]);
        for (expression, power) in [(product, 2.0), (sum, 2.0), (root, 1.0), (largest, 2.0), (number(3.0), 0.0)] {
            assert_eq!(expression.power(0), Power::Of(power), "{expression:?}");
        }
        assert_eq!(of(Operator::Multiply, theta(), number(0.0)).power(0), Power::Zero);
    }

    #[test]
    fn what_is_not_a_power_is_not_taken_for_one() {
        let more = of(Operator::Add, theta(), number(1.0));
        let exponential = Expression::Call(Function::Exp, vec![theta()]);
        let exponent = of(Operator::Power, number(2.0), theta());
        let compared = of(Operator::Less, theta(), number(2.0));
        let chosen = Expression::If(Box::new(compared.clone()), Box::new(theta()), Box::new(theta()));
        let largest = Expression::Call(Function::Max, vec![theta(), number(1.0)]);
        for expression in [more, exponential, exponent, compared, chosen, largest] {
            assert_eq!(expression.power(0), Power::Other, "{expression:?}");
        }
    }
}
