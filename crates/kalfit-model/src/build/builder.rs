//! Builder of a model of one phase, or of one phase of a model in several phases.

use nalgebra::DMatrix;

use crate::build::BuildError;
use crate::build::constraint::{Constraints, CovarianceForm, MeanRule};
use crate::build::formula::Formula;
use crate::build::measurement::MeasurementBuilder;
use crate::build::parameter::ParameterBuilder;
use crate::build::state::{StateBuilder, constant};
use crate::model::{Model, PhasedModel};

/// Collects the parts of a model. Clones of a builder can serve as the common part of several models or phases.
///
/// ```
/// # use kalfit_model as kalfit;
/// use kalfit::build::{constant, free, gauss_markov, measurement, name};
///
/// let model = kalfit::Model::builder("Gyros on a bench")
///     .time("hours")
///     .state(constant("bias").unit("deg/h"))
///     .state(constant("scale").unit("ppm"))
///     .state(gauss_markov("drift", "tau", 0.15))
///     .measurement(measurement("rate", name("bias") + name("scale") * name("turn") + name("drift"), 0.06))
///     .parameter(free("tau").lower(0.01))
///     .build()?;
/// assert_eq!(model.estimated_names(), ["bias", "scale"]);
/// # Ok::<(), kalfit::build::BuildError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModelBuilder {
    pub(super) title: String,
    pub(super) time: Option<String>,
    pub(super) time_unit: Option<String>,
    pub(super) initial_time: Option<Formula>,
    pub(super) step_first: bool,
    pub(super) previous_inputs: bool,
    pub(super) group: Option<String>,
    pub(super) states: Vec<StateBuilder>,
    pub(super) process_noise_covariance: Vec<(String, String, Formula)>,
    pub(super) measurements: Vec<MeasurementBuilder>,
    pub(super) noise_covariance: Vec<(String, String, Formula)>,
    pub(super) parameters: Vec<ParameterBuilder>,
    pub(super) constraints: Constraints,
    pub(super) known: Option<DMatrix<f64>>,
}

impl Model {
    /// Starts to build a model in code.
    pub fn builder(title: impl Into<String>) -> ModelBuilder {
        ModelBuilder { title: title.into(), ..ModelBuilder::default() }
    }

    /// A model that consists of the names of ξ alone, for tests that come as matrices or as reductions. Constraints on
    /// μ and Σ go into the fields `mean` and `covariance` of the only phase.
    ///
    /// # Errors
    /// There are no names, or a name occurs twice.
    pub fn unknowns<N: Into<String>>(names: impl IntoIterator<Item = N>) -> Result<PhasedModel, BuildError> {
        names.into_iter().fold(Model::builder(""), |builder, name| builder.state(constant(name))).build()
    }
}

impl ModelBuilder {
    /// Names the column with the time of each row. Rows of a test with equal times are one step.
    #[must_use]
    pub fn time(mut self, column: impl Into<String>) -> Self {
        self.time = Some(column.into());
        self
    }

    /// Names the unit of times, for messages.
    #[must_use]
    pub fn time_unit(mut self, unit: impl Into<String>) -> Self {
        self.time_unit = Some(unit.into());
        self
    }

    /// Sets the time of x_0, a formula in columns that are constant within a test. By default x_0 is at the first row.
    #[must_use]
    pub fn initial_time(mut self, time: impl Into<Formula>) -> Self {
        self.initial_time = Some(time.into());
        self
    }

    /// Lets one transition precede the first row too, as in the paper's k = 1.
    #[must_use]
    pub fn step_first(mut self) -> Self {
        self.step_first = true;
        self
    }

    /// Lets the step from row k-1 to row k use the columns of row k-1, not of row k.
    #[must_use]
    pub fn previous_inputs(mut self) -> Self {
        self.previous_inputs = true;
        self
    }

    /// Names the column of texts that reports are grouped by.
    #[must_use]
    pub fn group(mut self, column: impl Into<String>) -> Self {
        self.group = Some(column.into());
        self
    }

    /// Adds a state. The states whose start is estimated make up μ and Σ, in the order in which they are added.
    #[must_use]
    pub fn state(mut self, state: StateBuilder) -> Self {
        self.states.push(state);
        self
    }

    /// Adds a measurement.
    #[must_use]
    pub fn measurement(mut self, measurement: MeasurementBuilder) -> Self {
        self.measurements.push(measurement);
        self
    }

    /// Adds a parameter.
    #[must_use]
    pub fn parameter(mut self, parameter: ParameterBuilder) -> Self {
        self.parameters.push(parameter);
        self
    }

    /// Sets the covariance of the process noises of two states: per step for discrete motion, per time unit for
    /// continuous motion.
    #[must_use]
    pub fn process_noise_covariance(
        mut self,
        first: impl Into<String>,
        second: impl Into<String>,
        covariance: impl Into<Formula>,
    ) -> Self {
        self.process_noise_covariance.push((first.into(), second.into(), covariance.into()));
        self
    }

    /// Sets the covariance of the noises of two measurements of one step.
    #[must_use]
    pub fn noise_covariance(
        mut self,
        first: impl Into<String>,
        second: impl Into<String>,
        covariance: impl Into<Formula>,
    ) -> Self {
        self.noise_covariance.push((first.into(), second.into(), covariance.into()));
        self
    }

    /// Fixes the mean of a state at a known value.
    #[must_use]
    pub fn fix_mean(self, state: impl Into<String>, value: f64) -> Self {
        self.mean(state, MeanRule::Fixed(value))
    }

    /// Sets the value from which the search for the mean of a state starts.
    #[must_use]
    pub fn start_mean(self, state: impl Into<String>, value: f64) -> Self {
        self.mean(state, MeanRule::Start(value))
    }

    /// Ties the mean of a state to other means: the mean is `constant` + Σ weight × mean of the state of each term.
    #[must_use]
    pub fn tie_mean<'a>(
        self,
        state: impl Into<String>,
        constant: f64,
        terms: impl IntoIterator<Item = (&'a str, f64)>,
    ) -> Self {
        let terms = terms.into_iter().map(|(state, weight)| (state.to_owned(), weight)).collect();
        self.mean(state, MeanRule::Tied { constant, terms })
    }

    /// Makes the means of states proportional: each mean is weight × one unknown factor, (34).
    #[must_use]
    pub fn proportional_means<'a>(self, weights: impl IntoIterator<Item = (&'a str, f64)>) -> Self {
        weights.into_iter().fold(self, |builder, (state, weight)| builder.mean(state, MeanRule::Proportional(weight)))
    }

    fn mean(mut self, state: impl Into<String>, rule: MeanRule) -> Self {
        self.constraints.means.push((state.into(), rule));
        self
    }

    /// Lets the mean of a state depend linearly on a column that is constant within a test.
    #[must_use]
    pub fn regress_mean(mut self, state: impl Into<String>, column: impl Into<String>) -> Self {
        self.constraints.regressions.push((state.into(), column.into()));
        self
    }

    /// Makes Σ diagonal: different states are not correlated.
    #[must_use]
    pub fn diagonal(mut self) -> Self {
        self.constraints.kind = CovarianceForm::Diagonal;
        self
    }

    /// Makes Σ block diagonal: states of different blocks are not correlated. A state that no block names is a separate
    /// block.
    #[must_use]
    pub fn blocks(mut self, blocks: &[&[&str]]) -> Self {
        let owned = blocks.iter().map(|block| block.iter().map(|name| (*name).to_owned()).collect());
        self.constraints.kind = CovarianceForm::Blocks(owned.collect());
        self
    }

    /// Fixes an element of Σ at a known value: a variance if both names are equal.
    #[must_use]
    pub fn fix_covariance(mut self, first: impl Into<String>, second: impl Into<String>, value: f64) -> Self {
        self.constraints.fixed.push((first.into(), second.into(), value));
        self
    }

    /// Makes elements of Σ equal to each other; an element is a pair of names of states.
    #[must_use]
    pub fn equal_covariances(mut self, elements: &[(&str, &str)]) -> Self {
        let owned = elements.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned()));
        self.constraints.equal.push(owned.collect());
        self
    }

    /// Adds a known covariance to the estimated Σ, (29)-(30), p × p for p estimated states.
    #[must_use]
    pub fn known_covariance(mut self, known: DMatrix<f64>) -> Self {
        self.known = Some(known);
        self
    }
}
