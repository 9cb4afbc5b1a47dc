//! States in code: the named processes, and user-defined motion.

use crate::build::BuildError;
use crate::build::formula::{Formula, name};
use crate::build::linear::{ONE, ZERO, divide, linear, multiply, negate, nonnegative, scalar, squared};
use crate::build::names::{Names, Role};
use crate::model::{Expression, Initial, Linear, Motion, State};

/// Builder of a state.
#[derive(Debug, Clone, PartialEq)]
pub struct StateBuilder {
    pub(super) name: String,
    unit: Option<String>,
    process: Process,
    initial: Start,
    offset: Option<Formula>,
    pub(super) random: bool,
}

#[derive(Debug, Clone, PartialEq)]
enum Process {
    Constant,
    RandomWalk(Formula),
    RandomWalkByStep(Formula),
    GaussMarkov { time_constant: Formula, sigma: Formula },
    GaussMarkov2 { time_constant: Formula, sigma: Formula },
    Moving { derivative: Formula, noise_density: Formula },
    Stepping { next: Formula, step_noise: Formula },
}

#[derive(Debug, Clone, PartialEq)]
enum Start {
    Estimated,
    Stationary,
    Known(Formula, Formula),
}

/// A state whose value never changes.
pub fn constant(name: impl Into<String>) -> StateBuilder {
    StateBuilder::new(name.into(), Process::Constant, Start::Estimated)
}

/// A random walk in continuous time: `noise_density` is the standard deviation per square root of the time unit.
pub fn random_walk(name: impl Into<String>, noise_density: impl Into<Formula>) -> StateBuilder {
    StateBuilder::new(name.into(), Process::RandomWalk(noise_density.into()), Start::Estimated)
}

/// A random walk from row to row: `step_noise` is the standard deviation of one step.
pub fn random_walk_by_step(name: impl Into<String>, step_noise: impl Into<Formula>) -> StateBuilder {
    StateBuilder::new(name.into(), Process::RandomWalkByStep(step_noise.into()), Start::Estimated)
}

/// A Gauss-Markov process of first order with the given time constant and steady-state standard deviation. By default
/// the process starts in the stationary law.
pub fn gauss_markov(
    name: impl Into<String>,
    time_constant: impl Into<Formula>,
    sigma: impl Into<Formula>,
) -> StateBuilder {
    let process = Process::GaussMarkov { time_constant: time_constant.into(), sigma: sigma.into() };
    StateBuilder::new(name.into(), process, Start::Stationary)
}

/// A Gauss-Markov process of second order, critically damped; the hidden rate of the process is never estimated.
pub fn gauss_markov_2(
    name: impl Into<String>,
    time_constant: impl Into<Formula>,
    sigma: impl Into<Formula>,
) -> StateBuilder {
    let process = Process::GaussMarkov2 { time_constant: time_constant.into(), sigma: sigma.into() };
    StateBuilder::new(name.into(), process, Start::Stationary)
}

/// The integral over time of a state or of a formula in states.
pub fn integral(name: impl Into<String>, of: impl Into<Formula>) -> StateBuilder {
    moving(name, of, 0.0)
}

/// A state that moves in continuous time: `derivative` is linear in the states, and `noise_density` is the standard
/// deviation of the white noise per square root of the time unit.
pub fn moving(
    name: impl Into<String>,
    derivative: impl Into<Formula>,
    noise_density: impl Into<Formula>,
) -> StateBuilder {
    let process = Process::Moving { derivative: derivative.into(), noise_density: noise_density.into() };
    StateBuilder::new(name.into(), process, Start::Estimated)
}

/// A state that moves from row to row: `next` is linear in the states at the row before, and `step_noise` is the
/// standard deviation of the noise of one step.
pub fn stepping(name: impl Into<String>, next: impl Into<Formula>, step_noise: impl Into<Formula>) -> StateBuilder {
    let process = Process::Stepping { next: next.into(), step_noise: step_noise.into() };
    StateBuilder::new(name.into(), process, Start::Estimated)
}

impl StateBuilder {
    fn new(name: String, process: Process, initial: Start) -> StateBuilder {
        StateBuilder { name, unit: None, process, initial, offset: None, random: true }
    }

    /// Sets the label of the unit.
    #[must_use]
    pub fn unit(mut self, unit: impl Into<String>) -> Self {
        self.unit = Some(unit.into());
        self
    }

    /// Makes the start of the state estimated: an element of ξ ~ N(μ, Σ).
    #[must_use]
    pub fn estimated(mut self) -> Self {
        self.initial = Start::Estimated;
        self
    }

    /// Starts the state in the stationary distribution of the motion.
    #[must_use]
    pub fn stationary(mut self) -> Self {
        self.initial = Start::Stationary;
        self
    }

    /// Gives the start of the state a known mean and standard deviation.
    #[must_use]
    pub fn known(mut self, mean: impl Into<Formula>, sigma: impl Into<Formula>) -> Self {
        self.initial = Start::Known(mean.into(), sigma.into());
        self
    }

    /// Gives the start of the state one unknown value common to all tests: an element of μ with zero variance in Σ.
    #[must_use]
    pub fn common(mut self) -> Self {
        self.random = false;
        self
    }

    /// Adds a known amount, constant within a test, to the estimated start of the state.
    #[must_use]
    pub fn offset(mut self, offset: impl Into<Formula>) -> Self {
        self.offset = Some(offset.into());
        self
    }

    /// Names that the state adds to the model: the name of the state and, if there is a hidden rate, the name of the
    /// rate.
    pub(super) fn names(&self) -> impl Iterator<Item = String> {
        let hidden = matches!(self.process, Process::GaussMarkov2 { .. }).then(|| rate_name(&self.name));
        std::iter::once(self.name.clone()).chain(hidden)
    }

    /// Appends the state and, if there is one, the hidden rate of the state.
    pub(super) fn lower(&self, names: &mut Names, states: &mut Vec<State>) -> Result<(), BuildError> {
        let place = format!("state `{}`", self.name);
        let index = states.len();
        let (motion, rate) = self.process.lower(names, index, &self.name)?;
        let initial = match &self.initial {
            Start::Estimated => Initial::Estimated,
            Start::Stationary => Initial::Stationary,
            Start::Known(mean, sigma) => Initial::Known {
                mean: scalar(names, mean, &format!("initial mean of {place}"))?,
                variance: squared(names, sigma, &format!("initial standard deviation of {place}"))?,
            },
        };
        let unused_setting = if self.offset.is_some() { Some("an offset") } else { None };
        let unused_setting = unused_setting.or((!self.random).then_some("one value common to all tests"));
        if let Some(first) = unused_setting.filter(|_| initial != Initial::Estimated) {
            let second = format!("the start of {place}, which is not estimated");
            return Err(BuildError::Contradiction { first: first.to_owned(), second });
        }
        if initial == Initial::Stationary && !self.process.settles() {
            let first = format!("the motion of {place}, which never settles,");
            return Err(BuildError::Contradiction { first, second: "a stationary start".to_owned() });
        }
        let offset = self.offset.as_ref().map(|f| scalar(names, f, &format!("offset of {place}"))).transpose()?;
        let hidden = rate.map(|(motion, variance)| State {
            name: rate_name(&self.name),
            unit: None,
            motion,
            initial: if initial == Initial::Stationary {
                Initial::Stationary
            } else {
                Initial::Known { mean: ZERO, variance }
            },
            offset: None,
            random: true,
        });
        let (name, unit) = (self.name.clone(), self.unit.clone());
        states.push(State { name, unit, motion, initial, offset, random: self.random });
        states.extend(hidden);
        Ok(())
    }
}

impl Process {
    fn settles(&self) -> bool {
        !matches!(self, Process::Constant | Process::RandomWalk(_) | Process::RandomWalkByStep(_))
    }

    /// The motion of state `index`; for a second-order process also the motion and the stationary variance of the
    /// hidden rate.
    fn lower(
        &self,
        names: &mut Names,
        index: usize,
        state: &str,
    ) -> Result<(Motion, Option<(Motion, Expression)>), BuildError> {
        let of = |what: &str| format!("{what} of state `{state}`");
        let motion = match self {
            Process::Constant => Motion::Constant,
            Process::RandomWalk(density) => {
                let derivative = Linear { terms: Vec::new(), constant: ZERO };
                Motion::Continuous { derivative, noise_variance: squared(names, density, &of("noise density"))? }
            }
            Process::RandomWalkByStep(noise) => {
                return Process::Stepping { next: name(state), step_noise: noise.clone() }.lower(names, index, state);
            }
            Process::GaussMarkov { time_constant, sigma } => {
                let tau = nonnegative(names, time_constant, Role::TimeConstant, &of("time constant"))?;
                let variance = squared(names, sigma, &of("standard deviation"))?;
                let noise_variance = divide(multiply(Expression::Number(2.0), variance), tau.clone());
                let derivative = Linear { terms: vec![(index, negate(divide(ONE, tau)))], constant: ZERO };
                Motion::Continuous { derivative, noise_variance }
            }
            Process::GaussMarkov2 { time_constant, sigma } => {
                let tau = nonnegative(names, time_constant, Role::TimeConstant, &of("time constant"))?;
                let variance = squared(names, sigma, &of("standard deviation"))?;
                let derivative = Linear { terms: vec![(index + 1, ONE)], constant: ZERO };
                let motion = Motion::Continuous { derivative, noise_variance: ZERO };
                require_times(names, &motion, state)?;
                return Ok((motion, Some(second_order(index, tau, variance))));
            }
            Process::Moving { derivative, noise_density } => Motion::Continuous {
                derivative: linear(names, derivative, &of("derivative"))?,
                noise_variance: squared(names, noise_density, &of("noise density"))?,
            },
            Process::Stepping { next, step_noise } => Motion::Discrete {
                next: linear(names, next, &of("next value"))?,
                noise_variance: squared(names, step_noise, &of("step noise"))?,
            },
        };
        require_times(names, &motion, state)?;
        Ok((motion, None))
    }
}

/// dv = -β²x - 2βv + w with β = 1/τ, w of variance 4β³σ² per unit of time, and the stationary variance β²σ² of v.
fn second_order(index: usize, tau: Expression, variance: Expression) -> (Motion, Expression) {
    let beta = divide(ONE, tau.clone());
    let stiffness = multiply(beta.clone(), beta);
    let rate_variance = multiply(stiffness.clone(), variance);
    let damping = divide(Expression::Number(2.0), tau.clone());
    let noise_variance = multiply(divide(Expression::Number(4.0), tau), rate_variance.clone());
    let terms = vec![(index, negate(stiffness)), (index + 1, negate(damping))];
    (Motion::Continuous { derivative: Linear { terms, constant: ZERO }, noise_variance }, rate_variance)
}

fn require_times(names: &Names, motion: &Motion, state: &str) -> Result<(), BuildError> {
    match motion {
        Motion::Continuous { .. } if !names.time => Err(BuildError::NoTime { place: format!("state `{state}`") }),
        _ => Ok(()),
    }
}

/// Name of a hidden rate. No formula would use such a name, so that the name hides no column or parameter.
fn rate_name(owner: &str) -> String {
    format!("{owner} (rate)")
}
