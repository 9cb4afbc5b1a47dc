//! Known inputs: an expression in columns as a sum of terms with constant coefficients.

use kalfit_model::{Expression, Operator};

/// (Coefficient, term) of each term of a sum; a term is an expression in columns, or 1 for the constant.
pub(super) type Terms = Vec<(f64, Expression)>;

/// The term 1, whose coefficient is the constant.
pub(super) const ONE: Expression = Expression::Number(1.0);

/// The terms of a bound expression, each once, none with coefficient zero.
pub(super) fn terms(expression: &Expression) -> Terms {
    let mut terms = Terms::new();
    add(1.0, expression, &mut terms);
    terms.retain(|(coefficient, _)| *coefficient != 0.0);
    terms
}

fn add(factor: f64, expression: &Expression, terms: &mut Terms) {
    match expression {
        Expression::Negate(a) => add(-factor, a, terms),
        Expression::Binary(Operator::Add, a, b) => {
            add(factor, a, terms);
            add(factor, b, terms);
        }
        Expression::Binary(Operator::Subtract, a, b) => {
            add(factor, a, terms);
            add(-factor, b, terms);
        }
        Expression::Number(x) => push(factor * x, ONE, terms),
        other => {
            let (coefficient, rest) = split_factor(other);
            match rest {
                // a number times a sum
                Expression::Negate(_) | Expression::Binary(Operator::Add | Operator::Subtract, ..) => {
                    add(factor * coefficient, &rest, terms);
                }
                rest => push(factor * coefficient, rest, terms),
            }
        }
    }
}

fn push(coefficient: f64, term: Expression, terms: &mut Terms) {
    match terms.iter_mut().find(|(_, other)| *other == term) {
        Some((sum, _)) => *sum += coefficient,
        None => terms.push((coefficient, term)),
    }
}

/// A product or quotient as a number times the rest.
fn split_factor(expression: &Expression) -> (f64, Expression) {
    let Expression::Binary(operator @ (Operator::Multiply | Operator::Divide), a, b) = expression else {
        return match expression {
            Expression::Number(x) => (*x, ONE),
            Expression::Negate(a) => {
                let (coefficient, rest) = split_factor(a);
                (-coefficient, rest)
            }
            other => (1.0, other.clone()),
        };
    };
    let ((left, a), (right, b)) = (split_factor(a), split_factor(b));
    let divides = *operator == Operator::Divide;
    let coefficient = if divides { left / right } else { left * right };
    let rest = match (a, b) {
        (a, b) if b == ONE => a,
        (a, b) if a == ONE && !divides => b,
        (a, b) => Expression::Binary(*operator, Box::new(a), Box::new(b)),
    };
    (coefficient, rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(x: f64) -> Box<Expression> {
        Box::new(Expression::Number(x))
    }

    fn column(c: usize) -> Box<Expression> {
        Box::new(Expression::Column(c))
    }

    fn binary(operator: Operator, a: Box<Expression>, b: Box<Expression>) -> Box<Expression> {
        Box::new(Expression::Binary(operator, a, b))
    }

    #[test]
    fn sums_are_taken_apart_and_equal_terms_put_together() {
        use Operator::{Add, Divide, Multiply, Subtract};
        // 3 * (T - 20) / 2 - (-T) + u * 4 * T
        let first =
            binary(Divide, binary(Multiply, number(3.0), binary(Subtract, column(0), number(20.0))), number(2.0));
        let second = binary(Subtract, first, Box::new(Expression::Negate(column(0))));
        let whole = binary(Add, second, binary(Multiply, binary(Multiply, column(1), number(4.0)), column(0)));
        let product = *binary(Multiply, column(1), column(0));
        let expected = vec![(2.5, *column(0)), (-30.0, ONE), (4.0, product)];
        assert_eq!(terms(&whole), expected);
    }

    #[test]
    fn what_cancels_is_no_input() {
        let nothing = binary(Operator::Subtract, column(0), column(0));
        assert_eq!(terms(&nothing), vec![]);
        assert_eq!(
            terms(&binary(Operator::Divide, number(2.0), column(0))),
            vec![(2.0, *binary(Operator::Divide, number(1.0), column(0)))]
        );
    }
}
