//! Models: states and the motion of states, measurements, parameters, and the structure of μ and Σ.
//!
//! A [`Model`] holds its equations as exact linear forms whose coefficients are [`Expression`]s in the columns of the
//! data and the parameters. A model refers to columns, states and parameters by index; names serve reports only.

mod coefficient;
mod derivative;
mod error;
mod expression;
mod parameter;
mod phased;
mod population;
mod power;
mod role;
mod site;
mod slots;
mod stacked;
mod structure;

pub use coefficient::CoefficientsAsStates;
pub use derivative::Tape;
pub use error::EvaluationError;
pub use expression::{Expression, Function, Operator, Scope};
pub use parameter::{Alpha, Level, Parameter, ParameterError, Value};
pub use phased::{Carry, Filter, GroupLevel, MAIN, Membership, Phase, PhasedModel, effect_names, slot_of};
pub use population::{Population, PopulationError};
pub(crate) use role::roles_among;
pub use role::{Role, roles};
pub use site::Site;
pub use slots::{Slot, Slots};
pub use structure::{
    CovarianceKind, CovarianceStructure, FixedElement, MeanElement, MeanStructure, Regression, StructureError,
};

/// A whole model of one phase. Invariants, which the maker of a model must keep: every index is in range; `estimated`
/// lists each state whose `initial` is [`Initial::Estimated`] exactly once; the structures have `estimated.len()`
/// elements; continuous motion and [`Expression::Step`] appear only when `clock.time` is given.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Free text that heads reports.
    pub title: String,
    /// Numeric columns read from the data, indexed by [`Expression::Column`].
    pub columns: Vec<Column>,
    /// Text columns read from the data, indexed by [`Expression::TextEquals`] and [`Parameter::per`].
    pub text_columns: Vec<Column>,
    /// Texts that the model names: literals of comparisons and named levels. [`Labels`](crate::ensemble::Labels) start
    /// with these texts.
    pub literals: Vec<String>,
    /// Dynamic parameters α, in file order.
    pub parameters: Vec<Parameter>,
    /// All states, in file order. A hidden state, such as the rate of a second-order Gauss-Markov process, follows the
    /// main state of the process.
    pub states: Vec<State>,
    /// (state, state, covariance) of two process noises: per step for discrete motion, per time unit for continuous
    /// motion.
    pub process_noise_covariance: Vec<(usize, usize, Expression)>,
    /// Measurements, in file order.
    pub measurements: Vec<Measurement>,
    /// (measurement, measurement, covariance) of the noises of two measurements of one step.
    pub noise_covariance: Vec<(usize, usize, Expression)>,
    /// Where steps and their times come from.
    pub clock: Clock,
    /// Text column that reports are grouped by.
    pub group: Option<usize>,
    /// Indices in `states` of the p estimated states, in the order of μ and Σ.
    pub estimated: Vec<usize>,
    /// Constraints on μ.
    pub mean: MeanStructure,
    /// Constraints on Σ.
    pub covariance: CovarianceStructure,
}

/// One column of the data that the model reads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// Name of the column in the data.
    pub name: String,
    /// First use of the column in the model, in words: "equation of measurement `gyro`".
    pub used_in: String,
}

/// Where steps and their times come from.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Clock {
    /// Index of the numeric column with the time of a row; rows of a test with equal times are one step. If `None`,
    /// each row is a step.
    pub time: Option<usize>,
    /// Unit of time, for messages.
    pub unit: Option<String>,
    /// Time of x_0, an expression in columns constant within a test. If `None`, x_0 is at the first row.
    pub initial_time: Option<Expression>,
    /// Whether one transition precedes the first row too.
    pub step_first: bool,
    /// Whether the step from row k-1 to row k uses the columns of row k-1, not of row k.
    pub previous_inputs: bool,
}

/// A linear form in the states: Σ coefficient × state + constant.
#[derive(Debug, Clone, PartialEq)]
pub struct Linear {
    /// (index of the state, coefficient), each state at most once, in ascending order of state.
    pub terms: Vec<(usize, Expression)>,
    /// The term without a state: a known input or offset.
    pub constant: Expression,
}

impl Linear {
    /// The coefficients, followed by the constant.
    pub fn expressions(&self) -> impl Iterator<Item = &Expression> {
        self.terms.iter().map(|(_, coefficient)| coefficient).chain([&self.constant])
    }
}

/// One state.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Name of the state.
    pub name: String,
    /// Unit label; units never convert.
    pub unit: Option<String>,
    /// How the state moves from row to row.
    pub motion: Motion,
    /// How the state starts: the law of x_0.
    pub initial: Initial,
    /// Known amount added to x_0, constant within a test.
    pub offset: Option<Expression>,
    /// Whether x_0 differs from test to test; if not, x_0 is one unknown value common to all tests (zero variance).
    pub random: bool,
}

/// How a state moves from row to row.
#[derive(Debug, Clone, PartialEq)]
pub enum Motion {
    /// x_k = x_{k-1}.
    Constant,
    /// dx/dt = derivative + white noise of the given variance per unit time.
    Continuous {
        /// dx/dt, linear in the states.
        derivative: Linear,
        /// Variance of the driving noise per unit time.
        noise_variance: Expression,
    },
    /// x_k = next(x_{k-1}) + noise of the given variance.
    Discrete {
        /// x_k without noise, linear in the states of the previous step.
        next: Linear,
        /// Variance of the noise of one step.
        noise_variance: Expression,
    },
}

impl Motion {
    /// (linear form of the motion, variance of the noise of the motion); `None` for a constant state.
    pub fn parts(&self) -> Option<(&Linear, &Expression)> {
        match self {
            Motion::Constant => None,
            Motion::Continuous { derivative: form, noise_variance }
            | Motion::Discrete { next: form, noise_variance } => Some((form, noise_variance)),
        }
    }

    /// Variance of the noise of the motion; `None` for a constant state.
    pub fn noise_variance(&self) -> Option<&Expression> {
        self.parts().map(|(_, noise_variance)| noise_variance)
    }
}

/// How a state starts.
#[derive(Debug, Clone, PartialEq)]
pub enum Initial {
    /// Part of ξ ~ N(μ, Σ).
    Estimated,
    /// In the stationary distribution of the motion (Lyapunov equation), jointly with the other stationary states.
    Stationary,
    /// Known mean and variance.
    Known {
        /// Mean of x_0.
        mean: Expression,
        /// Variance of x_0.
        variance: Expression,
    },
}

/// One scalar measurement z = h'x + d + v.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// Name of the measurement.
    pub name: String,
    /// Index of the numeric column with the measured value z; an empty cell means that z was not measured.
    pub column: usize,
    /// Condition that is true on the rows with the measurement; `None` for all rows.
    pub filter: Option<Expression>,
    /// h'x + d.
    pub equation: Linear,
    /// Variance of v; zero is legal.
    pub noise_variance: Expression,
}

impl Model {
    /// p, the number of estimated states.
    pub fn dimension(&self) -> usize {
        self.estimated.len()
    }

    /// Whether two parameters both occur in the motion of one state, or in one covariance of two noises.
    pub fn occur_together(&self, a: usize, b: usize) -> bool {
        let moved = |(form, noise): (&Linear, &Expression)| {
            let any = |p: usize| noise.mentions(p) || form.terms.iter().any(|(_, coefficient)| coefficient.mentions(p));
            any(a) && any(b)
        };
        let crossed = |(.., covariance): &(usize, usize, Expression)| covariance.mentions(a) && covariance.mentions(b);
        self.states.iter().filter_map(|state| state.motion.parts()).any(moved)
            || self.process_noise_covariance.iter().chain(&self.noise_covariance).any(crossed)
    }

    /// Names of the estimated states, in the order of μ and Σ.
    pub fn estimated_names(&self) -> Vec<String> {
        self.estimated.iter().map(|&s| self.states[s].name.clone()).collect()
    }
}
