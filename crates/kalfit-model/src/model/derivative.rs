//! Derivatives of expressions with respect to parameters, in reverse mode: one evaluation, then one walk back over the
//! computed values.

use crate::model::{EvaluationError, Expression, Function, Operator, Scope};

/// Values that an evaluation computed, each expression after all subexpressions. Successive evaluations reuse the
/// memory.
#[derive(Debug, Clone, Default)]
pub struct Tape(Vec<TapeNode>);

#[derive(Debug, Clone, Copy)]
struct TapeNode {
    value: f64,
    /// Index of the first node of the subexpressions; the nodes from `start` up to this node belong to the expression.
    start: usize,
}

impl Tape {
    fn push(&mut self, start: usize, value: f64) -> Result<f64, EvaluationError> {
        self.0.push(TapeNode { value, start });
        if value.is_finite() { Ok(value) } else { Err(EvaluationError::NotFinite) }
    }

    fn value(&self, at: usize) -> f64 {
        self.0[at].value
    }

    /// Index of the node of the expression before the expression of node `at`.
    fn node_before(&self, at: usize) -> usize {
        self.0[at].start - 1
    }
}

impl Expression {
    /// Calls `sink(parameter, seed × ∂value/∂parameter)` for each mention of a parameter. Comparisons have slope 0,
    /// `if` has the slope of the chosen branch, `min` and `max` have the slope of the chosen argument, and the slope of
    /// `abs` at 0 is 0. Where a slope is infinite (`sqrt` at 0) the value passed to the sink is not finite, unless the
    /// seed is 0.
    pub fn differentiate(
        &self,
        seed: f64,
        scope: &Scope<'_>,
        tape: &mut Tape,
        sink: &mut dyn FnMut(usize, f64),
    ) -> Result<(), EvaluationError> {
        tape.0.clear();
        self.evaluate_on_tape(scope, tape)?;
        self.propagate_back(seed, tape.0.len() - 1, tape, sink);
        Ok(())
    }

    /// Evaluates the expression and appends all values to the tape. An expression with slope 0, such as a comparison,
    /// is one node.
    fn evaluate_on_tape(&self, scope: &Scope<'_>, tape: &mut Tape) -> Result<f64, EvaluationError> {
        let start = tape.0.len();
        let value = match self {
            Expression::Negate(a) => -a.evaluate_on_tape(scope, tape)?,
            Expression::Binary(operator, a, b) if operator.is_arithmetic() => {
                let a = a.evaluate_on_tape(scope, tape)?;
                operator.of(a, b.evaluate_on_tape(scope, tape)?)
            }
            Expression::Call(function, arguments) => {
                let mut value = function.of(arguments[0].evaluate_on_tape(scope, tape)?);
                for argument in &arguments[1..] {
                    let argument = argument.evaluate_on_tape(scope, tape)?;
                    if function.chooses() {
                        value = function.choose(value, argument);
                    }
                }
                value
            }
            Expression::If(condition, a, b) => {
                let truth = condition.evaluate(scope)?;
                tape.push(start, truth)?;
                if truth != 0.0 { a.evaluate_on_tape(scope, tape)? } else { b.evaluate_on_tape(scope, tape)? }
            }
            leaf => leaf.evaluate(scope)?,
        };
        tape.push(start, value)
    }

    /// Walks back over the tape; `at` is the index of the node of this expression.
    fn propagate_back(&self, seed: f64, at: usize, tape: &Tape, sink: &mut dyn FnMut(usize, f64)) {
        if seed == 0.0 {
            return; // the product is 0 even with an infinite slope
        }
        match self {
            Expression::Parameter(index) => sink(*index, seed),
            Expression::Negate(a) => a.propagate_back(-seed, at - 1, tape, sink),
            Expression::Binary(operator, a, b) if operator.is_arithmetic() => {
                let second = at - 1;
                let first = tape.node_before(second);
                let (to_a, to_b) = operator.slopes(tape.value(first), tape.value(second), tape.value(at));
                a.propagate_back(seed_times(seed, to_a), first, tape, sink);
                b.propagate_back(seed_times(seed, to_b), second, tape, sink);
            }
            Expression::Call(function, arguments) if function.chooses() => {
                let (mut node, mut chosen) = (at - 1, None);
                for (k, argument) in arguments.iter().enumerate().rev() {
                    if tape.value(node) == tape.value(at) {
                        chosen = Some((argument, node));
                    }
                    if k > 0 {
                        node = tape.node_before(node);
                    }
                }
                if let Some((argument, node)) = chosen {
                    argument.propagate_back(seed, node, tape, sink);
                }
            }
            Expression::Call(function, arguments) => {
                let node = (1..arguments.len()).fold(at - 1, |node, _| tape.node_before(node));
                let slope = function.slope(tape.value(node), tape.value(at));
                arguments[0].propagate_back(seed_times(seed, slope), node, tape, sink);
            }
            Expression::If(_, a, b) => {
                let taken = if tape.value(tape.node_before(at - 1)) != 0.0 { a } else { b };
                taken.propagate_back(seed, at - 1, tape, sink);
            }
            _ => {}
        }
    }
}

/// seed × slope; exactly 0 where the slope is 0, even with an infinite seed.
fn seed_times(seed: f64, slope: f64) -> f64 {
    if slope == 0.0 { 0.0 } else { seed * slope }
}

impl Operator {
    fn is_arithmetic(self) -> bool {
        matches!(self, Operator::Add | Operator::Subtract | Operator::Multiply | Operator::Divide | Operator::Power)
    }

    /// Derivatives of a ∘ b = `value` with respect to a and to b.
    fn slopes(self, a: f64, b: f64, value: f64) -> (f64, f64) {
        match self {
            Operator::Add => (1.0, 1.0),
            Operator::Subtract => (1.0, -1.0),
            Operator::Multiply => (b, a),
            Operator::Divide => (1.0 / b, -value / b),
            Operator::Power => {
                let to_base = if b == 0.0 { 0.0 } else { b * a.powf(b - 1.0) };
                // 0^b is 0 for every b > 0. A negative base has no logarithm: then the exponent is constant, or there
                // is no slope.
                (to_base, if value == 0.0 { 0.0 } else { value * a.ln() })
            }
            _ => (0.0, 0.0),
        }
    }
}

impl Function {
    fn chooses(self) -> bool {
        matches!(self, Function::Min | Function::Max)
    }

    /// Derivative of f(a) = `value` with respect to a.
    fn slope(self, a: f64, value: f64) -> f64 {
        match self {
            Function::Sqrt => 0.5 / value,
            Function::Exp => value,
            Function::Log => 1.0 / a,
            Function::Sin => a.cos(),
            Function::Cos => -a.sin(),
            Function::Tan => 1.0 + value * value,
            Function::Abs if a == 0.0 => 0.0,
            Function::Abs => a.signum(),
            Function::Min | Function::Max => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::model::{Alpha, Level};

    fn parameter(index: usize) -> Expression {
        Expression::Parameter(index)
    }

    fn binary(operator: Operator, a: Expression, b: Expression) -> Expression {
        Expression::Binary(operator, Box::new(a), Box::new(b))
    }

    fn alpha(values: &[f64]) -> Alpha {
        Alpha { values: values.iter().map(|&x| Level::Common(x)).collect() }
    }

    const CELLS: [f64; 2] = [0.7, -1.3];

    fn value(expression: &Expression, values: &[f64]) -> Option<f64> {
        let scope = Scope { numbers: &CELLS, texts: &[], step: 0.4, alpha: &alpha(values) };
        expression.evaluate(&scope).ok()
    }

    fn gradient(expression: &Expression, values: &[f64]) -> Vec<f64> {
        let alpha = alpha(values);
        let scope = Scope { numbers: &CELLS, texts: &[], step: 0.4, alpha: &alpha };
        let mut found = vec![0.0; values.len()];
        let sink = &mut |index: usize, x: f64| found[index] += x;
        expression.differentiate(1.0, &scope, &mut Tape::default(), sink).expect("a value");
        found
    }

    fn random(depth: usize, rng: &mut ChaCha8Rng) -> Expression {
        if depth == 0 || rng.random_bool(0.15) {
            return match rng.random_range(0..6) {
                0 => Expression::Number(rng.random_range(-2.0..2.0)),
                1 => Expression::Column(rng.random_range(0..2)),
                2 => Expression::Step,
                _ => parameter(rng.random_range(0..3)),
            };
        }
        let mut part = || random(depth - 1, rng);
        let (a, b, c) = (part(), part(), part());
        match rng.random_range(0..16) {
            0 | 1 => binary(Operator::Add, a, b),
            2 => binary(Operator::Subtract, a, b),
            3 | 4 => binary(Operator::Multiply, a, b),
            5 => binary(Operator::Divide, a, b),
            6 => binary(Operator::Power, Expression::Call(Function::Exp, vec![a]), b),
            7 => binary(Operator::Power, a, Expression::Number(3.0)),
            8 => Expression::Call(Function::Max, vec![a, b, c]),
            9 => Expression::Call(Function::Min, vec![a, b]),
            10 => Expression::If(Box::new(binary(Operator::Less, a, b.clone())), Box::new(b), Box::new(c)),
            11 => Expression::Negate(Box::new(a)),
            12 => binary(Operator::Multiply, binary(Operator::And, a, b), c),
            13 => Expression::Call(Function::Sin, vec![a]),
            14 => Expression::Call(Function::Tan, vec![Expression::Call(Function::Cos, vec![a])]),
            _ => Expression::Call(Function::Sqrt, vec![Expression::Call(Function::Abs, vec![a])]),
        }
    }

    /// (central difference with two halvings of the step, its error); `None` where there is no smooth value nearby.
    fn difference(expression: &Expression, values: &[f64], index: usize) -> Option<(f64, f64)> {
        let central = |h: f64| {
            let mut moved = values.to_vec();
            moved[index] = values[index] + h;
            let up = value(expression, &moved)?;
            moved[index] = values[index] - h;
            Some((up - value(expression, &moved)?) / (2.0 * h))
        };
        let d: Vec<f64> = [4e-3, 2e-3, 1e-3].into_iter().map(central).collect::<Option<_>>()?;
        let (a, b) = ((4.0 * d[1] - d[0]) / 3.0, (4.0 * d[2] - d[1]) / 3.0);
        let best = (16.0 * b - a) / 15.0;
        Some((best, (best - b).abs()))
    }

    #[test]
    fn gradients_of_random_expressions_equal_difference_quotients() {
        let (mut compared, values) = (0, [0.6173, -1.7041, 2.2979]);
        for seed in 0..4000 {
            let expression = random(4, &mut ChaCha8Rng::seed_from_u64(seed));
            let Some(here) = value(&expression, &values).filter(|x| x.abs() < 1e4) else { continue };
            let found = gradient(&expression, &values);
            for (index, &found) in found.iter().enumerate() {
                let Some((expected, doubt)) = difference(&expression, &values, index) else { continue };
                if doubt > 1e-8 * (1.0 + expected.abs()) {
                    continue; // a kink or a steep slope nearby
                }
                let bound = 1e-8 * (1.0 + expected.abs() + here.abs());
                assert!((found - expected).abs() <= bound, "{seed}: {found} against {expected} of {expression:?}");
                compared += usize::from(expected != 0.0);
            }
        }
        assert!(compared > 2000, "only {compared} were compared");
    }

    #[test]
    fn powers_at_zero_and_of_negative_bases_have_their_slopes() {
        let power = |a, b| binary(Operator::Power, a, b);
        assert_eq!(gradient(&power(parameter(0), Expression::Number(2.0)), &[0.0]), [0.0]);
        assert_eq!(gradient(&power(parameter(0), Expression::Number(1.0)), &[0.0]), [1.0]);
        assert_eq!(gradient(&power(parameter(0), Expression::Number(0.0)), &[0.0]), [0.0]);
        assert_eq!(gradient(&power(parameter(0), Expression::Number(3.0)), &[-2.0]), [12.0]);
        assert_eq!(gradient(&power(Expression::Number(0.0), parameter(0)), &[1.5]), [0.0]);
    }

    #[test]
    fn an_infinite_slope_shows_unless_nothing_is_asked_of_it() {
        let root = Expression::Call(Function::Sqrt, vec![parameter(0)]);
        assert_eq!(gradient(&root, &[0.0]), [f64::INFINITY]);
        let unused = binary(Operator::Multiply, Expression::Number(0.0), root);
        assert_eq!(gradient(&unused, &[0.0]), [0.0]);
    }

    #[test]
    fn choices_follow_what_is_chosen() {
        let best = Expression::Call(Function::Max, vec![parameter(0), parameter(1), parameter(1)]);
        assert_eq!(gradient(&best, &[1.0, 2.0]), [0.0, 1.0]);
        assert_eq!(gradient(&best, &[2.0, 2.0]), [1.0, 0.0]);
        let condition = binary(Operator::Greater, parameter(0), Expression::Number(0.0));
        let branch = Expression::If(
            Box::new(condition),
            Box::new(parameter(1)),
            Box::new(Expression::Call(Function::Log, vec![Expression::Number(-1.0)])),
        );
        assert_eq!(gradient(&branch, &[1.0, 5.0]), [0.0, 1.0]);
        assert_eq!(gradient(&Expression::Call(Function::Abs, vec![parameter(0)]), &[-3.0]), [-1.0]);
    }
}
