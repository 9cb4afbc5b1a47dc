//! How states move: the named processes and own equations, each as a linear form and a noise variance.

use kalfit::model::{Expression, Linear, Motion, Operator};

use crate::error::{Result, Span, SpecError, SpecProblem};
use crate::expression::{self, ExpressionScope, ONE, ZERO, binary, negate, square};
use crate::names::{NameContext, ParameterRole};
use crate::table::{TomlField, TomlTable};

/// The ways in which a state can move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MotionProcess {
    Constant,
    RandomWalk,
    GaussMarkov,
    GaussMarkov2,
    Integral,
    Derivative,
    Next,
}

/// A motion, and what comes with it.
pub(crate) struct DeclaredMotion {
    pub(crate) motion: Motion,
    /// It starts in its stationary distribution when nothing else is said.
    pub(crate) stationary: bool,
    pub(crate) hidden: Option<HiddenRate>,
}

/// The hidden rate of a second-order process: its motion and its stationary variance.
pub(crate) struct HiddenRate {
    pub(crate) motion: Motion,
    pub(crate) variance: Expression,
}

const PROCESSES: [(&str, MotionProcess); 5] = [
    ("constant", MotionProcess::Constant),
    ("random-walk", MotionProcess::RandomWalk),
    ("gauss-markov", MotionProcess::GaussMarkov),
    ("gauss-markov-2", MotionProcess::GaussMarkov2),
    ("integral", MotionProcess::Integral),
];

impl MotionProcess {
    /// Which process the keys of a state ask for.
    pub(crate) fn of(section: &mut TomlTable<'_>) -> Result<MotionProcess> {
        let mut asked: Vec<(TomlField<'_>, MotionProcess)> = Vec::new();
        if let Some(field) = section.take("process") {
            let words = PROCESSES.map(|(word, _)| word);
            let process = PROCESSES[field.word(&words)?].1;
            asked.push((field, process));
        }
        for (key, process) in [("derivative", MotionProcess::Derivative), ("next", MotionProcess::Next)] {
            asked.extend(section.peek(key).map(|field| (field, process)));
        }
        match asked.as_slice() {
            [] => MotionProcess::none(section),
            [(_, process)] => Ok(*process),
            [(first, _), (second, _), ..] => {
                let (first, key) = (first.key.to_owned(), second.key.to_owned());
                let problem = SpecProblem::Both { place: section.place.clone(), first, second: key };
                Err(SpecError::new(problem).at(second.key_span.clone()))
            }
        }
    }

    /// No process and no equation: a constant, unless keys say that something else was meant.
    fn none(section: &TomlTable<'_>) -> Result<MotionProcess> {
        let meant = [
            ("time_constant", "process = \"gauss-markov\""),
            ("sigma", "process = \"gauss-markov\""),
            ("noise_density", "process = \"random-walk\""),
            ("step_noise", "process = \"random-walk\""),
            ("of", "process = \"integral\""),
        ];
        for (key, hint) in meant {
            if let Some(field) = section.peek(key) {
                return Err(field.no_effect(MotionProcess::Constant.words().0).hint(format!("write `{hint}`")));
            }
        }
        Ok(MotionProcess::Constant)
    }

    /// "on a …", and the keys it takes.
    pub(crate) fn words(self) -> (&'static str, &'static str) {
        match self {
            MotionProcess::Constant => ("on a constant", "a constant takes no keys of motion"),
            MotionProcess::RandomWalk => ("on a random walk", "it takes `noise_density` or `step_noise`"),
            MotionProcess::GaussMarkov => ("on a Gauss-Markov process", "it takes `time_constant` and `sigma`"),
            MotionProcess::GaussMarkov2 => {
                ("on a second-order Gauss-Markov process", "it takes `time_constant` and `sigma`")
            }
            MotionProcess::Integral => (
                "on an integral",
                "it takes `of`; an integral with noise is written `derivative = …` with `noise_density`",
            ),
            MotionProcess::Derivative => {
                ("beside `derivative`", "white noise that drives a derivative is `noise_density`")
            }
            MotionProcess::Next => ("beside `next`", "the noise of a step is `step_noise`"),
        }
    }
}

/// Reads the motion of state `index`.
pub(crate) fn moved(
    context: &mut NameContext<'_>,
    section: &mut TomlTable<'_>,
    process: MotionProcess,
    index: usize,
) -> Result<DeclaredMotion> {
    let plain = |motion| DeclaredMotion { motion, stationary: false, hidden: None };
    match process {
        MotionProcess::Constant => Ok(plain(Motion::Constant)),
        MotionProcess::RandomWalk => random_walk(context, section, index).map(plain),
        MotionProcess::GaussMarkov => gauss_markov(context, section, index),
        MotionProcess::GaussMarkov2 => gauss_markov_2(context, section, index),
        MotionProcess::Integral => {
            let of = section.need("of")?;
            continuous(context, section, &of)?;
            let derivative = equation(context, &of)?;
            Ok(plain(Motion::Continuous { derivative, noise_variance: ZERO }))
        }
        MotionProcess::Derivative => {
            let field = section.need("derivative")?;
            continuous(context, section, &field)?;
            let derivative = equation(context, &field)?;
            let noise_variance = driving_noise(context, section, "noise_density")?;
            Ok(plain(Motion::Continuous { derivative, noise_variance }))
        }
        MotionProcess::Next => {
            let field = section.need("next")?;
            let next = equation(context, &field)?;
            let noise_variance = driving_noise(context, section, "step_noise")?;
            Ok(plain(Motion::Discrete { next, noise_variance }))
        }
    }
}

fn random_walk(context: &mut NameContext<'_>, section: &mut TomlTable<'_>, index: usize) -> Result<Motion> {
    let (density, step) = (section.peek("noise_density"), section.peek("step_noise"));
    let problem = |both: bool| {
        let (place, first, second) = (section.place.clone(), "noise_density".to_owned(), "step_noise".to_owned());
        if both { SpecProblem::Both { place, first, second } } else { SpecProblem::Neither { place, first, second } }
    };
    match (density, step) {
        (Some(_), Some(step)) => Err(SpecError::new(problem(true)).at(step.key_span)),
        (None, None) => Err(SpecError::new(problem(false))
            .at(section.span.clone())
            .hint("`noise_density` is per square root of the time unit, `step_noise` per step")),
        (Some(density), None) => {
            continuous(context, section, &density)?;
            let derivative = Linear { terms: Vec::new(), constant: ZERO };
            Ok(Motion::Continuous { derivative, noise_variance: driving_noise(context, section, "noise_density")? })
        }
        (None, Some(_)) => {
            let next = Linear { terms: vec![(index, ONE)], constant: ZERO };
            Ok(Motion::Discrete { next, noise_variance: driving_noise(context, section, "step_noise")? })
        }
    }
}

/// dx = -x/τ + w, w of variance 2σ²/τ per unit of time.
fn gauss_markov(context: &mut NameContext<'_>, section: &mut TomlTable<'_>, index: usize) -> Result<DeclaredMotion> {
    let (tau, sigma, span) = time_constant_and_sigma(context, section)?;
    let mut algebra = ExpressionAlgebra { context, span };
    let rate = algebra.divide(ONE, tau.clone())?;
    let variance = algebra.square(sigma)?;
    let twice = algebra.multiply(Expression::Number(2.0), variance)?;
    let noise_variance = algebra.divide(twice, tau)?;
    let derivative = Linear { terms: vec![(index, negate(rate))], constant: ZERO };
    Ok(DeclaredMotion { motion: Motion::Continuous { derivative, noise_variance }, stationary: true, hidden: None })
}

/// dx = v, dv = -β²x - 2βv + w with β = 1/τ and w of variance 4β³σ² per unit of time: critically damped, variance of x
/// σ², of v β²σ², autocovariance σ² exp(-βδ)(1 + βδ).
fn gauss_markov_2(context: &mut NameContext<'_>, section: &mut TomlTable<'_>, index: usize) -> Result<DeclaredMotion> {
    let (tau, sigma, span) = time_constant_and_sigma(context, section)?;
    let mut algebra = ExpressionAlgebra { context, span };
    let beta = algebra.divide(ONE, tau.clone())?;
    let stiffness = algebra.square(beta)?;
    let damping = algebra.divide(Expression::Number(2.0), tau.clone())?;
    let variance = algebra.square(sigma)?;
    let rate_variance = algebra.multiply(stiffness.clone(), variance)?;
    let four = algebra.divide(Expression::Number(4.0), tau)?;
    let noise_variance = algebra.multiply(four, rate_variance.clone())?;
    let terms = vec![(index, negate(stiffness)), (index + 1, negate(damping))];
    let rate = Motion::Continuous { derivative: Linear { terms, constant: ZERO }, noise_variance };
    let derivative = Linear { terms: vec![(index + 1, ONE)], constant: ZERO };
    Ok(DeclaredMotion {
        motion: Motion::Continuous { derivative, noise_variance: ZERO },
        stationary: true,
        hidden: Some(HiddenRate { motion: rate, variance: rate_variance }),
    })
}

fn time_constant_and_sigma(
    context: &mut NameContext<'_>,
    section: &mut TomlTable<'_>,
) -> Result<(Expression, Expression, Span)> {
    let tau = section.need("time_constant")?;
    continuous(context, section, &tau)?;
    let place = tau.what();
    let time_constant = deviation(context, &tau, ExpressionScope::row(&place), ParameterRole::TimeConstant)?;
    let sigma = section.need("sigma")?;
    let place = sigma.what();
    let sigma = deviation(context, &sigma, ExpressionScope::row(&place), ParameterRole::StandardDeviation)?;
    Ok((time_constant, sigma, tau.span))
}

/// Refuses motion in continuous time without time.
fn continuous(context: &NameContext<'_>, section: &TomlTable<'_>, field: &TomlField<'_>) -> Result<()> {
    if context.time {
        return Ok(());
    }
    let span = section.peek("process").map_or(field.key_span.clone(), |process| process.span);
    Err(SpecError::new(SpecProblem::NoTime { what: section.place.clone() })
        .at(span)
        .hint("`time` names the column with the time of each row; `next` and `step_noise` need no time"))
}

fn equation(context: &mut NameContext<'_>, field: &TomlField<'_>) -> Result<Linear> {
    let place = field.what();
    expression::linear(context, field, ExpressionScope::equation(&place))
}

/// The variance of the noise whose standard deviation stands under `key`; zero when nothing does.
fn driving_noise(context: &mut NameContext<'_>, section: &mut TomlTable<'_>, key: &str) -> Result<Expression> {
    let Some(field) = section.take(key) else { return Ok(ZERO) };
    let place = field.what();
    let deviation = deviation(context, &field, ExpressionScope::row(&place), ParameterRole::StandardDeviation)?;
    squared(context, deviation, &field.span)
}

/// A number that cannot be negative: a standard deviation, a variance or a time constant. A parameter that is the whole of it has
/// that role whatever else it does; those that are parts of it get their role when the model is whole.
pub(crate) fn deviation(
    context: &mut NameContext<'_>,
    field: &TomlField<'_>,
    scope: ExpressionScope<'_>,
    role: ParameterRole,
) -> Result<Expression> {
    let value = expression::scalar(context, field, scope)?;
    match value {
        Expression::Parameter(index) => context.use_parameter(index, role),
        Expression::Number(found) => {
            if let Some(expected) = role.expected(found) {
                let problem = SpecProblem::OutOfRange { what: field.what(), found, expected: expected.to_owned() };
                return Err(SpecError::new(problem).at(field.span.clone()));
            }
        }
        _ => {}
    }
    Ok(value)
}

/// The variance of a standard deviation.
pub(crate) fn squared(context: &mut NameContext<'_>, deviation: Expression, span: &Span) -> Result<Expression> {
    ExpressionAlgebra { context, span: span.clone() }.square(deviation)
}

/// Arithmetic on expressions whose faults are put at one place.
struct ExpressionAlgebra<'c, 't> {
    context: &'c mut NameContext<'t>,
    span: Span,
}

impl ExpressionAlgebra<'_, '_> {
    fn square(&mut self, a: Expression) -> Result<Expression> {
        self.spend(&a)?;
        square(a).map_err(|problem| SpecError::new(problem).at(self.span.clone()))
    }

    fn multiply(&mut self, a: Expression, b: Expression) -> Result<Expression> {
        self.binary(Operator::Multiply, a, b)
    }

    fn divide(&mut self, a: Expression, b: Expression) -> Result<Expression> {
        self.binary(Operator::Divide, a, b)
    }

    fn binary(&mut self, operator: Operator, a: Expression, b: Expression) -> Result<Expression> {
        self.spend(&b)?;
        binary(operator, a, b).map_err(|problem| SpecError::new(problem).at(self.span.clone()))
    }

    fn spend(&mut self, a: &Expression) -> Result<()> {
        self.context.spend(expression::size(a)).map_err(|problem| SpecError::new(problem).at(self.span.clone()))
    }
}
