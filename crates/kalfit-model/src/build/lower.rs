//! From a builder to a model: names become indices, equations become linear forms.

mod parameter;

use crate::build::BuildError;
use crate::build::builder::ModelBuilder;
use crate::build::constraint::{Elements, as_expressions, finite};
use crate::build::formula::Formula;
use crate::build::linear::scalar;
use crate::build::names::{Names, Role, unknown};
use crate::model::{Clock, Expression, Initial, Model, Parameter, PhasedModel, roles_among};

/// (index, index, covariance) of the noises of two states or of two measurements.
type Covariances = Vec<(usize, usize, Expression)>;

impl ModelBuilder {
    /// Builds the model, of one phase. What no method of the builder covers can be set in the fields of the result,
    /// which are all public: see [`CovarianceKind`](crate::model::CovarianceKind) for the structures of Σ.
    ///
    /// # Errors
    /// Unknown names, equations that are not linear in the states, numbers outside the allowed range, and constraints
    /// that contradict each other.
    pub fn build(&self) -> Result<PhasedModel, BuildError> {
        let mut names = Names::default();
        let mut model = PhasedModel::from(phase(self, &mut names, None)?);
        share(&mut names, &mut model)?;
        Ok(model)
    }
}

/// Gives the models of all phases the common columns, texts and parameters, after all phases are built.
pub(super) fn share(names: &mut Names, model: &mut PhasedModel) -> Result<(), BuildError> {
    let roles = roles_among(model, names.parameters.len());
    roles.into_iter().enumerate().for_each(|(parameter, role)| names.strengthen_role(parameter, role.into()));
    let given = names.parameters.clone();
    let parameters: Vec<Parameter> =
        given.iter().map(|(parameter, role)| parameter.lower_into(names, *role)).collect::<Result<_, _>>()?;
    for model in model.models_mut() {
        model.columns = names.columns.clone();
        model.text_columns = names.text_columns.clone();
        model.literals = names.literals.clone();
        model.parameters = parameters.clone();
    }
    Ok(())
}

/// Builds the model of one phase, without the columns, texts and parameters, which [`share`] adds.
pub(super) fn phase(builder: &ModelBuilder, names: &mut Names, phase_name: Option<&str>) -> Result<Model, BuildError> {
    builder.parameters.iter().try_for_each(|parameter| names.parameter(parameter, phase_name))?;
    builder.parameters.iter().try_for_each(|parameter| parameter.declare(names))?;
    check(builder, names)?;
    names.states = builder.states.iter().flat_map(|state| state.names()).collect();
    names.time = builder.time.is_some();
    let mut states = Vec::new();
    builder.states.iter().try_for_each(|state| state.lower(names, &mut states))?;
    let measurements = builder.measurements.iter().map(|m| m.lower(names)).collect::<Result<_, _>>()?;
    let estimated: Vec<usize> = (0..states.len()).filter(|&i| states[i].initial == Initial::Estimated).collect();
    let of_states = names.states.clone();
    let of_measurements: Vec<String> = builder.measurements.iter().map(|m| m.name.clone()).collect();
    let process = covariances(names, &builder.process_noise_covariance, ("state", &of_states))?;
    let noise = covariances(names, &builder.noise_covariance, ("measurement", &of_measurements))?;
    let element_names: Vec<String> = estimated.iter().map(|&i| of_states[i].clone()).collect();
    let random: Vec<bool> = estimated.iter().map(|&i| states[i].random).collect();
    let elements = Elements { names: &element_names, random: &random };
    let mean = builder.constraints.mean(&elements, names)?;
    let mut covariance = builder.constraints.covariance(&elements)?;
    covariance.known = known(builder, estimated.len())?;
    Ok(Model {
        title: builder.title.clone(),
        columns: Vec::new(),
        text_columns: Vec::new(),
        literals: Vec::new(),
        parameters: Vec::new(),
        states,
        process_noise_covariance: process,
        measurements,
        noise_covariance: noise,
        clock: clock(builder, names)?,
        group: builder.group.as_ref().map(|column| names.text_column(column, "groups of reports")),
        estimated,
        mean,
        covariance,
    })
}

/// Checks that there are states and that no name is used twice.
fn check(builder: &ModelBuilder, names: &Names) -> Result<(), BuildError> {
    if builder.states.is_empty() {
        return Err(BuildError::Nothing { what: "states" });
    }
    let mut seen: Vec<String> = Vec::new();
    for name in builder.states.iter().flat_map(|state| state.names()) {
        if names.parameters.iter().any(|(parameter, _)| parameter.name == name) {
            return Err(BuildError::Twice { what: "a state and a parameter", name });
        }
        if seen.contains(&name) {
            return Err(BuildError::Twice { what: "two states", name });
        }
        seen.push(name);
    }
    let measured = builder.measurements.iter().map(|m| &m.name);
    let measured: Vec<&String> = measured.collect();
    match measured.iter().enumerate().find(|(i, name)| measured[..*i].contains(name)) {
        Some((_, name)) => Err(BuildError::Twice { what: "two measurements", name: (*name).clone() }),
        None => Ok(()),
    }
}

fn covariances(
    names: &mut Names,
    given: &[(String, String, Formula)],
    (what, known): (&'static str, &[String]),
) -> Result<Covariances, BuildError> {
    let mut all: Covariances = Vec::new();
    for (first, second, formula) in given {
        let place = format!("noise covariance of `{first}` and `{second}`");
        let find = |name: &String| {
            known.iter().position(|other| other == name).ok_or_else(|| unknown(what, name, &place, known))
        };
        let (i, j) = (find(first)?, find(second)?);
        let (i, j) = (i.max(j), i.min(j));
        if all.iter().any(|(a, b, _)| (*a, *b) == (i, j)) {
            return Err(BuildError::Contradiction { first: format!("one {place}"), second: "another".to_owned() });
        }
        all.push((i, j, scalar(names, formula, &place)?));
    }
    Ok(all)
}

fn known(builder: &ModelBuilder, p: usize) -> Result<Option<Vec<Vec<Expression>>>, BuildError> {
    let Some(matrix) = &builder.known else { return Ok(None) };
    let what = "the known covariance".to_owned();
    if matrix.shape() != (p, p) {
        return Err(BuildError::Shape { what, found: matrix.shape(), expected: p });
    }
    matrix.iter().try_for_each(|&x| finite(x, &what).map(drop))?;
    Ok(Some(as_expressions(matrix)))
}

fn clock(builder: &ModelBuilder, names: &mut Names) -> Result<Clock, BuildError> {
    let require_times = |place: &str| match builder.time {
        Some(_) => Ok(()),
        None => Err(BuildError::NoTime { place: place.to_owned() }),
    };
    let initial_time = match &builder.initial_time {
        Some(formula) => {
            require_times("an initial time")?;
            Some(scalar(names, formula, "initial time")?)
        }
        None => None,
    };
    if builder.time_unit.is_some() {
        require_times("a unit of time")?;
    }
    Ok(Clock {
        time: builder.time.as_ref().map(|column| names.column(column, "time")),
        unit: builder.time_unit.clone(),
        initial_time,
        step_first: builder.step_first,
        previous_inputs: builder.previous_inputs,
    })
}

/// Marks a parameter as used, because a filter assumes a value for it.
pub(super) fn mark_used(names: &mut Names, parameter: usize) {
    names.parameters[parameter].1 = names.parameters[parameter].1.max(Role::Coefficient);
}
