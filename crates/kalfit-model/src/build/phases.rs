//! Models of tests in several phases, in code.

use nalgebra::DMatrix;

use crate::build::BuildError;
use crate::build::builder::ModelBuilder;
use crate::build::constraint::finite;
use crate::build::formula::Formula;
use crate::build::linear::linear;
use crate::build::lower;
use crate::build::lower::share;
use crate::build::names::{Names, unknown};
use crate::model::{Carry, Filter, Initial, Model, Phase, PhasedModel};

/// Collects phases, in the order in which they happen.
///
/// ```
/// # use kalfit_model as kalfit;
/// use kalfit::build::{constant, measurement, name, phase};
/// use kalfit::PhasedModel;
///
/// // a level is measured before and after a shock, which adds an error of its own
/// let level = kalfit::Model::builder("A shock").state(constant("level")).measurement(measurement("y", "level", 0.1));
/// let model = PhasedModel::builder("when")
///     .phase(phase("before", &level))
///     .phase(phase("after", &level).carry("level", name("level")))
///     .build()?;
/// assert_eq!(model.estimated_names(), ["before.level", "after.level"]);
/// # Ok::<(), kalfit::build::BuildError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct PhasedModelBuilder {
    column: String,
    phases: Vec<PhaseBuilder>,
}

/// Builder of one phase.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseBuilder {
    name: String,
    model: ModelBuilder,
    carry: Vec<(String, Formula)>,
    filter: Option<SchmidtBuilder>,
}

/// Builder of a filter that need not be optimal; the estimates of the filter replace the measurements of a phase.
#[derive(Debug, Clone, PartialEq)]
pub struct SchmidtBuilder {
    covariance: DMatrix<f64>,
    consider: Vec<String>,
    mean: Vec<(String, f64)>,
    parameters: Vec<(String, f64)>,
}

impl PhasedModel {
    /// Starts to build a model in phases; a column of texts names the phase of each row.
    pub fn builder(phase_column: impl Into<String>) -> PhasedModelBuilder {
        PhasedModelBuilder { column: phase_column.into(), phases: Vec::new() }
    }
}

/// A phase with the states, measurements and constraints of `model`.
pub fn phase(name: impl Into<String>, model: &ModelBuilder) -> PhaseBuilder {
    PhaseBuilder { name: name.into(), model: model.clone(), carry: Vec::new(), filter: None }
}

/// A Kalman-Schmidt filter with the prior covariance of all n states, n × n, in the order of the model.
pub fn schmidt(covariance: DMatrix<f64>) -> SchmidtBuilder {
    SchmidtBuilder { covariance, consider: Vec::new(), mean: Vec::new(), parameters: Vec::new() }
}

impl SchmidtBuilder {
    /// Adds states whose uncertainty the filter accounts for without an estimate of the states.
    #[must_use]
    pub fn consider<'a>(mut self, states: impl IntoIterator<Item = &'a str>) -> Self {
        self.consider.extend(states.into_iter().map(str::to_owned));
        self
    }

    /// Sets the prior mean of a state in the filter; the default is zero.
    #[must_use]
    pub fn mean(mut self, state: impl Into<String>, value: f64) -> Self {
        self.mean.push((state.into(), value));
        self
    }

    /// Sets the value that the filter assumes for a parameter; the default is the value in the model.
    #[must_use]
    pub fn believes(mut self, parameter: impl Into<String>, value: f64) -> Self {
        self.parameters.push((parameter.into(), value));
        self
    }

    fn lower(&self, names: &mut Names) -> Result<Filter, BuildError> {
        let n = names.states.len();
        if self.covariance.shape() != (n, n) {
            let what = "the prior covariance of a filter".to_owned();
            return Err(BuildError::Shape { what, found: self.covariance.shape(), expected: n });
        }
        let mut consider: Vec<usize> =
            self.consider.iter().map(|name| names.required_state(name, "a filter")).collect::<Result<_, _>>()?;
        consider.sort_unstable();
        consider.dedup();
        let mut mean = vec![0.0; n];
        for (state, value) in &self.mean {
            mean[names.required_state(state, "a filter")?] = finite(*value, "a prior mean of a filter")?;
        }
        let mut parameters = Vec::new();
        for (name, value) in &self.parameters {
            let known: Vec<String> = names.parameters.iter().map(|(parameter, _)| parameter.name.clone()).collect();
            let index = known.iter().position(|known| known == name);
            let index = index.ok_or_else(|| unknown("parameter", name, "a filter", &known))?;
            lower::mark_used(names, index);
            parameters.push((index, finite(*value, "a parameter of a filter")?));
        }
        Ok(Filter { consider, mean, covariance: self.covariance.clone(), parameters })
    }
}

impl PhaseBuilder {
    /// Adds a formula, linear in the final states of the phase before, to the start of a state.
    #[must_use]
    pub fn carry(mut self, state: impl Into<String>, from: impl Into<Formula>) -> Self {
        self.carry.push((state.into(), from.into()));
        self
    }

    /// Replaces the measurements of the phase by the estimates of this filter.
    #[must_use]
    pub fn filter(mut self, filter: SchmidtBuilder) -> Self {
        self.filter = Some(filter);
        self
    }

    fn lower(&self, names: &mut Names, before: Option<&[String]>) -> Result<Phase, BuildError> {
        let model = lower::phase(&self.model, names, Some(&self.name))?;
        let own = names.states.clone();
        let filter = self.filter.as_ref().map(|filter| filter.lower(names)).transpose()?;
        let carry = self.lower_carries(names, &model, before)?;
        names.states = own;
        Ok(Phase { name: self.name.clone(), label: Some(names.literal(&self.name)), model, carry, filter })
    }

    fn lower_carries(
        &self,
        names: &mut Names,
        model: &Model,
        before: Option<&[String]>,
    ) -> Result<Vec<Carry>, BuildError> {
        let own = names.states.clone();
        let before = match before {
            Some(before) => before,
            None if self.carry.is_empty() => return Ok(Vec::new()),
            None => return Err(BuildError::FirstCarries { phase: self.name.clone() }),
        };
        let mut carry: Vec<Carry> = Vec::new();
        for (name, from) in &self.carry {
            let place = format!("what state `{name}` of phase `{}` inherits", self.name);
            let index = own.iter().position(|known| known == name);
            let state = index.ok_or_else(|| unknown("state", name, &place, &own))?;
            if model.states[state].initial == Initial::Stationary {
                return Err(BuildError::Contradiction { first: place, second: "a stationary start".to_owned() });
            }
            if carry.iter().any(|known| known.state == state) {
                return Err(BuildError::Twice { what: "two states that inherit", name: name.clone() });
            }
            names.states = before.to_vec();
            let from = linear(names, from, &place)?;
            carry.push(Carry { state, from });
        }
        carry.sort_by_key(|carry| carry.state);
        Ok(carry)
    }
}

impl PhasedModelBuilder {
    /// Adds a phase after the phases added so far.
    #[must_use]
    pub fn phase(mut self, phase: PhaseBuilder) -> Self {
        self.phases.push(phase);
        self
    }

    /// Builds the model.
    ///
    /// # Errors
    /// The errors of [`ModelBuilder::build`] for each phase, two phases with one name, and phases that differ in title,
    /// in group or in a parameter of one name.
    pub fn build(&self) -> Result<PhasedModel, BuildError> {
        let Some(first) = self.phases.first() else { return Err(BuildError::Nothing { what: "phases" }) };
        let mut names = Names::default();
        let column = names.text_column(&self.column, "the phase of a row");
        let mut phases: Vec<Phase> = Vec::new();
        let mut before: Option<Vec<String>> = None;
        for builder in &self.phases {
            if phases.iter().any(|phase| phase.name == builder.name) {
                return Err(BuildError::Twice { what: "two phases", name: builder.name.clone() });
            }
            for (what, differs) in [
                ("title", builder.model.title != first.model.title),
                ("group", builder.model.group != first.model.group),
            ] {
                if differs {
                    return Err(BuildError::PhasesDiffer { phase: builder.name.clone(), what: what.to_owned() });
                }
            }
            phases.push(builder.lower(&mut names, before.as_deref())?);
            before = Some(names.states.clone());
        }
        let mut model = PhasedModel { phases, column: Some(column), levels: Vec::new() };
        share(&mut names, &mut model)?;
        Ok(model)
    }
}
