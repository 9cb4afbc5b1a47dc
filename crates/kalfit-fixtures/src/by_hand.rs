//! Models for unit tests, built by hand.

use std::collections::BTreeMap;

use kalfit_model::{
    Clock, Column, CovarianceStructure, Expression, Initial, Linear, MeanStructure, Measurement, Model, Motion,
    Operator, Parameter, State, Value,
};

/// A known number.
pub fn number(x: f64) -> Expression {
    Expression::Number(x)
}

/// The value of a column of the data, by its index.
pub fn column(c: usize) -> Expression {
    Expression::Column(c)
}

/// A parameter, by its index.
pub fn alpha(index: usize) -> Expression {
    Expression::Parameter(index)
}

fn binary(operator: Operator, a: Expression, b: Expression) -> Expression {
    Expression::Binary(operator, Box::new(a), Box::new(b))
}

/// a + b.
pub fn plus(a: Expression, b: Expression) -> Expression {
    binary(Operator::Add, a, b)
}

/// a b.
pub fn times(a: Expression, b: Expression) -> Expression {
    binary(Operator::Multiply, a, b)
}

/// a / b.
pub fn over(a: Expression, b: Expression) -> Expression {
    binary(Operator::Divide, a, b)
}

/// a².
pub fn square(a: Expression) -> Expression {
    binary(Operator::Power, a, number(2.0))
}

/// -a.
pub fn minus(a: Expression) -> Expression {
    Expression::Negate(Box::new(a))
}

/// A linear form: (state, coefficient) pairs and a constant.
pub fn linear(terms: Vec<(usize, Expression)>, constant: Expression) -> Linear {
    Linear { terms, constant }
}

/// A random state without unit or offset.
pub fn state(name: &str, motion: Motion, initial: Initial) -> State {
    State { name: name.to_owned(), unit: None, motion, initial, offset: None, random: true }
}

/// Motion dx/dt = terms + input + white noise of the variance per unit of time.
pub fn continuous(terms: Vec<(usize, Expression)>, input: Expression, noise_variance: Expression) -> Motion {
    Motion::Continuous { derivative: linear(terms, input), noise_variance }
}

/// Motion x_k = terms + input + noise of the variance of one step.
pub fn discrete(terms: Vec<(usize, Expression)>, input: Expression, noise_variance: Expression) -> Motion {
    Motion::Discrete { next: linear(terms, input), noise_variance }
}

/// Motion of a Gauss-Markov state with this time constant and steady-state standard deviation.
pub fn gauss_markov(index: usize, tau: Expression, sigma: Expression) -> Motion {
    let noise_variance = over(times(number(2.0), square(sigma)), tau.clone());
    continuous(vec![(index, over(number(-1.0), tau))], number(0.0), noise_variance)
}

/// A start with known mean and variance.
pub fn known(mean: Expression, variance: Expression) -> Initial {
    Initial::Known { mean, variance }
}

/// A measurement of a column.
pub fn meter(name: &str, column: usize, equation: Linear, noise_variance: Expression) -> Measurement {
    Measurement { name: name.to_owned(), column, filter: None, equation, noise_variance }
}

/// A free parameter.
pub fn parameter(name: &str, start: Option<f64>, per: Option<usize>, positive: bool) -> Parameter {
    Parameter {
        name: name.to_owned(),
        unit: None,
        value: Value::Free { start },
        per,
        fixed_levels: BTreeMap::new(),
        lower: None,
        upper: None,
        positive,
    }
}

/// A model with the given columns, text columns and literals, and the time in the first column; the mean and covariance
/// of the estimated states are free.
pub fn model(
    [columns, texts, literals]: [&[&str]; 3],
    parameters: Vec<Parameter>,
    states: Vec<State>,
    measurements: Vec<Measurement>,
) -> Model {
    let named = |name: &&str| Column { name: (*name).to_owned(), used_in: String::new() };
    let estimated: Vec<usize> = (0..states.len()).filter(|&i| states[i].initial == Initial::Estimated).collect();
    Model {
        title: String::new(),
        columns: columns.iter().map(named).collect(),
        text_columns: texts.iter().map(named).collect(),
        literals: literals.iter().map(|&literal| literal.to_owned()).collect(),
        parameters,
        process_noise_covariance: Vec::new(),
        measurements,
        noise_covariance: Vec::new(),
        clock: Clock { time: Some(0), ..Clock::default() },
        group: None,
        mean: MeanStructure::free(estimated.len()),
        covariance: CovarianceStructure::full(),
        estimated,
        states,
    }
}

/// Uniform numbers in (-½, ½), the same on every machine.
pub struct Lcg(pub u64);

impl Lcg {
    /// The next number.
    #[expect(clippy::should_implement_trait, reason = "numbers without end: an iterator would give options")]
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 40) as f64 + 0.5) / f64::from(1 << 24) - 0.5
    }

    /// The sum of twelve numbers: nearly N(0, 1).
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum()
    }
}
