//! From a record back to the population it describes.

use nalgebra::DMatrix;

use crate::model::{Model, PhasedModel, Population, PopulationError};
use crate::record::{FitRecord, PhaseRecord};

/// Why a record has no population for a model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RecordError {
    /// The schema is another.
    #[error("the schema is `{found}`, expected `{expected}`")]
    Schema {
        /// What the record says.
        found: String,
        /// What can be read.
        expected: &'static str,
    },
    /// More phases than one, or none.
    #[error("found {found} phases, expected the one phase of the model")]
    Phases {
        /// Number of phases.
        found: usize,
    },
    /// Other names than the model's.
    #[error("{what} are {}, expected {} as in the model", shown(found), shown(expected))]
    Names {
        /// What is named.
        what: &'static str,
        /// Names in the record.
        found: Vec<String>,
        /// Names in the model.
        expected: Vec<String>,
    },
    /// A count that does not go with the number of states.
    #[error("found {found} {what}, expected {expected}, one for each state")]
    Count {
        /// What was counted.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
    /// The values are no population.
    #[error(transparent)]
    Population(#[from] PopulationError),
}

fn shown(names: &[String]) -> String {
    const MOST: usize = 12;
    if names.is_empty() {
        return "none".to_owned();
    }
    let more = if names.len() > MOST { format!(" and {} more", names.len() - MOST) } else { String::new() };
    let first: Vec<String> = names.iter().take(MOST).map(|name| format!("`{name}`")).collect();
    format!("{}{more}", first.join(", "))
}

/// The schema of [`FitRecord`].
pub const FIT_SCHEMA: &str = "kalfit-fit/1";

impl FitRecord {
    /// The estimates of μ, the regression coefficients and Σ, in the order of a model with the same estimated states and
    /// regressions; theirs in the record may differ.
    ///
    /// # Errors
    /// Another schema, more than one phase, other states or regressions, figures that are no population.
    pub fn population(&self, model: &Model) -> Result<Population, RecordError> {
        if self.schema != FIT_SCHEMA {
            return Err(RecordError::Schema { found: self.schema.clone(), expected: FIT_SCHEMA });
        }
        let [phase] = &self.phases[..] else { return Err(RecordError::Phases { found: self.phases.len() }) };
        let place = places("the estimated states", &phase.states, &model.estimated_names())?;
        let p = place.len();
        refuse_ragged(phase, p)?;
        let population = Population {
            mean: place.iter().map(|&i| phase.mean.estimate[i]).collect(),
            coefficients: coefficients(phase, model)?,
            covariance: DMatrix::from_fn(p, p, |i, j| phase.covariance.estimate[place[i]][place[j]]),
        };
        population.check(&PhasedModel::from(model.clone()))?;
        Ok(population)
    }
}

fn refuse_ragged(phase: &PhaseRecord, p: usize) -> Result<(), RecordError> {
    let rows = &phase.covariance.estimate;
    let ragged = rows.iter().map(Vec::len).find(|&length| length != p);
    for (what, found) in [
        ("means", phase.mean.estimate.len()),
        ("rows of the covariance", rows.len()),
        ("columns of the covariance", ragged.unwrap_or(p)),
    ] {
        if found != p {
            return Err(RecordError::Count { what, found, expected: p });
        }
    }
    Ok(())
}

fn coefficients(phase: &PhaseRecord, model: &Model) -> Result<Vec<f64>, RecordError> {
    let found: Vec<String> = phase.mean.regression.iter().map(|r| format!("{} on {}", r.state, r.column)).collect();
    let wanted = model
        .mean
        .regression
        .iter()
        .map(|r| format!("{} on {}", model.states[model.estimated[r.element]].name, model.columns[r.column].name));
    let place = places("the regressions", &found, &wanted.collect::<Vec<_>>())?;
    Ok(place.iter().map(|&r| phase.mean.regression[r].estimate).collect())
}

/// For each expected name its place among those found.
fn places(what: &'static str, found: &[String], expected: &[String]) -> Result<Vec<usize>, RecordError> {
    let place: Option<Vec<usize>> = expected.iter().map(|name| found.iter().position(|other| other == name)).collect();
    match place {
        Some(place) if found.len() == expected.len() => Ok(place),
        _ => Err(RecordError::Names { what, found: found.to_vec(), expected: expected.to_vec() }),
    }
}
