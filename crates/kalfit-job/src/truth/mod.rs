//! `--from`: the population and the parameters that are taken as true, from a fit or from a model file.

pub(crate) mod error;

use std::collections::{BTreeSet, HashMap};
use std::path::Path;

use kalfit::infer::{Estimand, Knowledge};
use kalfit::model::{Level, ParameterError, Value};
use kalfit::record::RecordError;
use kalfit::{Alpha, FitRecord, Population};
use kalfit_spec::{ParameterAssignment, Spec};

use crate::document::Document;
use crate::failure::Failure;
use crate::job::ModelJob;
use crate::model;
use crate::results::{self, FIT, ResultError};
use crate::truth::error::TruthError;

/// What is taken as true.
#[derive(Debug)]
pub(crate) struct Truth {
    pub(crate) population: Population,
    pub(crate) alpha: Alpha,
    /// Free parameters of the model that got their values from `--from`.
    pub(crate) taken: Vec<String>,
    /// What the user should know.
    pub(crate) warnings: Vec<String>,
    /// How many tests, or groups of the outermost level, the population was estimated from; `None` where it was given.
    pub(crate) fitted: Option<usize>,
    /// The results that it was taken from, if it was not a model.
    pub(crate) record: Option<Box<FitRecord>>,
    /// What `--set` gave other values: `tau`, `sigma[A]`.
    pub(crate) changed: Vec<String>,
}

impl Truth {
    /// Whether `--set` gave a parameter a value, at one level or at all.
    pub(crate) fn is_changed(&self, name: &str, level: Option<&str>) -> bool {
        let own = level.map(|level| format!("{name}[{level}]"));
        self.changed.iter().any(|changed| changed == name || Some(changed) == own.as_ref())
    }
}

impl Truth {
    /// What is known of the estimates; what was given, by a model file or by `--set`, is exact. `None` where the fit does not say.
    pub(crate) fn knowledge(&self, spec: &Spec) -> Option<Knowledge> {
        let Some(record) = &self.record else { return Some(Knowledge::exact()) };
        let knowledge = record.knowledge(&spec.model)?;
        let is_changed = |estimand: &Estimand| match estimand {
            Estimand::Parameter { parameter, level } => {
                self.is_changed(&spec.model.shared().parameters[*parameter].name, level.as_deref())
            }
            Estimand::Population(_) => false,
        };
        Some(knowledge.without(&is_changed))
    }
}

impl From<TruthError> for Failure {
    fn from(error: TruthError) -> Failure {
        Failure::Truth(Box::new(error))
    }
}

/// The value of one parameter, at one level or common to all.
struct KnownValue {
    name: String,
    per: Option<String>,
    level: Option<String>,
    value: f64,
}

/// A model, and what is taken as true of it.
pub(crate) fn load(job: &ModelJob, from: &Document) -> Result<(Spec, Truth), Failure> {
    let mut spec = model::read(&job.document)?;
    let truth = take(&mut spec, from, &job.set)?;
    Ok((spec, truth))
}

/// Takes the truth from a file. Free parameters of the model get its values; then `set` is done.
fn take(spec: &mut Spec, from: &Document, set: &[String]) -> Result<Truth, Failure> {
    let path = from.name();
    let mut warnings = Vec::new();
    let mut fitted = None;
    let mut results = None;
    let (population, known) = if is_model(from)? {
        of_model(spec, from, set)?
    } else {
        let record: FitRecord = results::read(from, FIT).map_err(TruthError::from)?;
        let population =
            record.population(&spec.model).map_err(|error| TruthError::Record { path: path.clone(), error })?;
        if record.model_digest.as_ref().is_some_and(|digest| *digest != spec.digest) {
            warnings.push(format!("`{path}` was made with another version of `{}`", spec.name));
        }
        if !record.converged {
            warnings.push(format!(
                "`{path}` is of a fit that did not converge: its values are not maximum-likelihood estimates"
            ));
        }
        fitted = Some(record.levels.first().map_or(record.data.tests, |level| level.groups));
        let known = of_record(spec, &record, &path)?;
        results = Some(Box::new(record));
        (population, known)
    };
    let assigned = set.iter().filter_map(|assignment| ParameterAssignment::new(assignment).ok());
    let is_set = |name: &str| assigned.clone().any(|assignment| assignment.name == name);
    let mut taken = give(spec, &known, (&path, &is_set), &mut warnings)?;
    model::set(spec, set)?;
    let changed: Vec<String> = assigned.clone().map(|assignment| assignment.target()).collect();
    taken.retain(|name| !is_set(name));
    let alpha = Alpha::fixed(&spec.model.shared().parameters)
        .map_err(|ParameterError::Free { names }| Failure::from(TruthError::NoParameter { names }))?;
    Ok(Truth { population, alpha, taken, warnings, fitted, record: results, changed })
}

/// The results of a fit, from their JSON.
///
/// # Errors
/// [`Failure::Truth`] for anything else.
pub fn fit_record(name: &str, json: &str) -> Result<FitRecord, Failure> {
    Ok(results::of_bytes(name.to_owned(), json.as_bytes(), FIT).map_err(TruthError::from)?)
}

/// Gives the model's free parameters the values of a fit; what the user should know.
pub(crate) fn parameters(spec: &mut Spec, from: &Document) -> Result<Vec<String>, Failure> {
    let path = from.name();
    let record: FitRecord = results::read(from, FIT).map_err(TruthError::from)?;
    let known = of_record(spec, &record, &path)?;
    let mut warnings = Vec::new();
    give(spec, &known, (&path, &|_| false), &mut warnings)?;
    Ok(warnings)
}

/// True for a model file: by its extension, else by its first character.
fn is_model(from: &Document) -> Result<bool, TruthError> {
    match from
        .path()
        .and_then(Path::extension)
        .and_then(|extension| extension.to_str())
        .map(str::to_ascii_lowercase)
        .as_deref()
    {
        Some("toml") => return Ok(true),
        Some("json") => return Ok(false),
        _ if model::is_table(&from.name()) => return Ok(false),
        _ => {}
    }
    let (start, _) = from.bytes(64).map_err(|error| ResultError::unreadable(from, &error))?;
    Ok(!start.trim_ascii_start().starts_with(b"{"))
}

/// The population of a model file, in the order of the model, and the values of its parameters.
fn of_model(spec: &Spec, from: &Document, set: &[String]) -> Result<(Population, Vec<KnownValue>), Failure> {
    let path = from.name();
    let mut truth = model::read(from)?;
    for parameter in truth.model.shared().parameters.clone() {
        if let Value::Free { start: Some(start) } = parameter.value {
            truth
                .give(&parameter.name, &[(None, start)])
                .map_err(|error| Failure::from(TruthError::Value { path: path.clone(), error: Box::new(error) }))?;
        }
    }
    let is_there = |name: &str| truth.model.shared().parameters.iter().any(|p| p.name == name);
    let is_own =
        |assignment: &&String| ParameterAssignment::new(assignment).is_ok_and(|assigned| is_there(assigned.name));
    let own: Vec<String> = set.iter().filter(is_own).cloned().collect();
    model::set(&mut truth, &own)?;
    let alpha = Alpha::fixed(&truth.model.shared().parameters)
        .map_err(|ParameterError::Free { names }| Failure::from(TruthError::NoParameter { names }))?;
    let (found, expected) = (truth.model.estimated_names(), spec.model.estimated_names());
    let place: Option<Vec<usize>> = expected.iter().map(|name| found.iter().position(|other| other == name)).collect();
    let Some(own) = place.filter(|place| place.len() == found.len()) else {
        let error = RecordError::Names { what: "the estimated states".to_owned(), found, expected };
        return Err(TruthError::Record { path, error }.into());
    };
    let refused = |error| Failure::from(TruthError::Population { path: path.clone(), error });
    let mut population = Population::of_model(&truth.model, &alpha).map_err(refused)?;
    // what groups of each level add stands after the tests' own
    let size = own.len();
    let place: Vec<usize> =
        (0..=truth.model.levels.len()).flat_map(|level| own.iter().map(move |i| level * size + i)).collect();
    population.mean = place.iter().map(|&i| population.mean[i]).collect();
    population.covariance = population.covariance.select_rows(&place).select_columns(&place);
    population.check(&spec.model).map_err(refused)?;
    Ok((population, levels(&truth, &alpha)))
}

/// All values of a model's parameters.
fn levels(spec: &Spec, alpha: &Alpha) -> Vec<KnownValue> {
    let mut known = Vec::new();
    for (parameter, level) in spec.model.shared().parameters.iter().zip(&alpha.values) {
        let per = parameter.per.map(|column| spec.model.shared().text_columns[column].name.clone());
        let mut add = |level: Option<&String>, value: f64| {
            known.push(KnownValue { name: parameter.name.clone(), per: per.clone(), level: level.cloned(), value });
        };
        match level {
            Level::Common(value) => add(None, *value),
            Level::Each { values, other, .. } => {
                other.iter().for_each(|value| add(None, *value));
                values.iter().for_each(|(label, value)| add(spec.model.shared().literals.get(label.index()), *value));
            }
        }
    }
    known
}

/// The parameters of a fit, all of which the model must have.
fn of_record(spec: &Spec, record: &FitRecord, path: &str) -> Result<Vec<KnownValue>, TruthError> {
    let names: BTreeSet<&str> = spec.model.shared().parameters.iter().map(|own| own.name.as_str()).collect();
    let known = |p: &kalfit::record::ParameterRecord| {
        if !names.contains(p.name.as_str()) {
            return Err(TruthError::UnknownParameter { path: path.to_owned(), name: p.name.clone() });
        }
        Ok(KnownValue { name: p.name.clone(), per: p.per.clone(), level: p.level.clone(), value: p.estimate })
    };
    record.parameters.iter().map(known).collect()
}

/// Gives the model's free parameters the values that are known in a file; the names of those that got one. Of parameters that will be set
/// nobody needs to know what they are elsewhere.
fn give(
    spec: &mut Spec,
    known: &[KnownValue],
    (path, is_set): (&str, &dyn Fn(&str) -> bool),
    warnings: &mut Vec<String>,
) -> Result<Vec<String>, Failure> {
    let literals: HashMap<String, usize> =
        spec.model.shared().literals.iter().enumerate().map(|(literal, text)| (text.clone(), literal)).collect();
    let mut taken = Vec::new();
    for parameter in spec.model.shared().parameters.clone() {
        let mut values = Vec::new();
        for KnownValue { per, level, value, .. } in known.iter().filter(|known| known.name == parameter.name) {
            let literal = level.as_ref().and_then(|level| literals.get(level));
            let at_level = literal.and_then(|literal| parameter.fixed_levels.get(literal).copied());
            let own = match parameter.value {
                Value::Fixed(own) => Some(at_level.unwrap_or(own)),
                Value::Free { .. } => at_level,
            };
            if let Some(own) = own {
                if own != *value && !is_set(&parameter.name) {
                    warnings.push(difference(spec, &parameter.name, level.as_deref(), (own, *value), path));
                }
                continue;
            }
            let expected = parameter.per.map(|column| spec.model.shared().text_columns[column].name.clone());
            if *per != expected {
                let (path, name, found) = (path.to_owned(), parameter.name.clone(), per.clone());
                return Err(TruthError::Per { path, name, found, expected }.into());
            }
            values.push((level.as_deref(), *value));
        }
        if values.is_empty() {
            continue;
        }
        spec.give(&parameter.name, &values)
            .map_err(|error| Failure::from(TruthError::Value { path: path.to_owned(), error: Box::new(error) }))?;
        taken.push(parameter.name.clone());
    }
    Ok(taken)
}

fn difference(spec: &Spec, name: &str, level: Option<&str>, (own, other): (f64, f64), path: &str) -> String {
    let at = level.map_or(String::new(), |level| format!("[{level}]"));
    format!("`{name}{at}` is {own} in `{}` and {other} in `{path}`: {own} is used", spec.name)
}
