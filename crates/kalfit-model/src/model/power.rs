//! How expressions and models scale with one parameter θ.

use crate::model::{Expression, Function, Model, Operator, Site};

impl Expression {
    /// k, if on every row the expression is zero or θ^k times a factor without θ; 0 if the expression is zero on all
    /// rows.
    pub fn exponent(&self, parameter: usize) -> Option<f64> {
        match self.exponents(parameter)?[..] {
            [] => Some(0.0),
            [k] => Some(k),
            _ => None,
        }
    }

    /// The exponents k with which the expression is θ^k, θ > 0, times a factor without θ: the exponents of all rows
    /// with a nonzero value, ascending, without repetition; `None` if the expression has another form.
    pub(super) fn exponents(&self, parameter: usize) -> Option<Vec<f64>> {
        let of = |part: &Expression| part.exponents(parameter);
        match self {
            Expression::Number(0.0) => Some(Vec::new()),
            Expression::Parameter(index) if *index == parameter => Some(vec![1.0]),
            Expression::Negate(a) => of(a),
            Expression::Binary(Operator::Multiply, a, b) => Some(combined_exponents(&of(a)?, &of(b)?, |j, k| j + k)),
            Expression::Binary(Operator::Divide, a, b) => Some(combined_exponents(&of(a)?, &of(b)?, |j, k| j - k)),
            Expression::Binary(Operator::Power, a, n) if n.as_number().is_some() => {
                let n = n.as_number()?;
                Some(ascending(of(a)?.into_iter().map(|k| k * n).collect()))
            }
            Expression::Binary(Operator::Add | Operator::Subtract, a, b) => common_exponents(of(a)?, of(b)?),
            Expression::Call(Function::Sqrt, arguments) => {
                Some(of(&arguments[0])?.into_iter().map(|k| 0.5 * k).collect())
            }
            Expression::Call(Function::Abs, arguments) => of(&arguments[0]),
            // the comparison of an argument of zero with any other argument does not depend on θ
            Expression::Call(Function::Min | Function::Max, arguments) => {
                arguments.iter().try_fold(Vec::new(), |known, argument| common_exponents(known, of(argument)?))
            }
            Expression::If(condition, a, b) if !condition.mentions(parameter) => {
                let mut both = of(a)?;
                both.extend(of(b)?);
                Some(ascending(both))
            }
            _ => (!self.mentions(parameter)).then(|| vec![0.0]),
        }
    }
}

/// Exponents of a sum a + b, if both terms have one and the same exponent or one term is zero.
fn common_exponents(a: Vec<f64>, b: Vec<f64>) -> Option<Vec<f64>> {
    match (&a[..], &b[..]) {
        ([], _) => Some(b),
        (_, []) => Some(a),
        ([j], [k]) if j == k => Some(a),
        _ => None,
    }
}

fn combined_exponents(a: &[f64], b: &[f64], of: fn(f64, f64) -> f64) -> Vec<f64> {
    ascending(a.iter().flat_map(|&j| b.iter().map(move |&k| of(j, k))).collect())
}

fn ascending(mut exponents: Vec<f64>) -> Vec<f64> {
    exponents.sort_by(f64::total_cmp);
    exponents.dedup();
    exponents
}

impl Model {
    /// k, if every variance of the model is proportional to θ^k and, except for Σ, no other expression depends on θ:
    /// then θ scales all noise.
    pub fn noise_power(&self, parameter: usize) -> Option<f64> {
        let mut variance_exponents = Vec::new();
        for (site, expression) in self.expressions() {
            if site.is_variance() {
                variance_exponents.extend(expression.exponents(parameter)?);
            } else if !matches!(site, Site::Structure { .. }) && expression.exponent(parameter) != Some(0.0) {
                return None;
            }
        }
        match ascending(variance_exponents)[..] {
            [power] if power != 0.0 => Some(power),
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
            assert_eq!(expression.exponent(0), Some(power), "{expression:?}");
        }
        let zero = of(Operator::Multiply, theta(), number(0.0));
        assert_eq!((zero.exponents(0), zero.exponent(0)), (Some(vec![]), Some(0.0)));
    }

    #[test]
    fn what_is_zero_on_some_rows_has_the_power_of_the_others() {
        let on_some =
            |a: Expression, b: Expression| Expression::If(Box::new(Expression::Column(0)), Box::new(a), Box::new(b));
        let once = on_some(theta(), number(0.0));
        assert_eq!(of(Operator::Multiply, once.clone(), once).exponent(0), Some(2.0));
        let either = on_some(theta(), number(1.0));
        assert_eq!((either.exponents(0), either.exponent(0)), (Some(vec![0.0, 1.0]), None));
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
            assert_eq!(expression.exponent(0), None, "{expression:?}");
        }
    }
}
