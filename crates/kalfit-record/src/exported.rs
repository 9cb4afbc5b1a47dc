//! The filter that follows from a fit, as a record.

use serde::{Deserialize, Serialize};

use crate::square::rows;
use kalfit_apply::export::Exported;
use kalfit_model::{Expression, PhasedModel};

/// The schema of [`ExportRecord`].
pub const EXPORT_SCHEMA: &str = "kalfit-filter/1";

/// A filter of constant matrices: x_k = F x_{k-1} + B u_k + w_k, z_k = H x_k + D u_k + v_k, w ~ N(0, Q), v ~ N(0, R).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExportRecord {
    /// Always `kalfit-filter/1`.
    pub schema: String,
    /// Version that made it.
    pub kalfit_version: String,
    /// Title of the model.
    pub title: String,
    /// What the parameters were taken from, as named by the user.
    pub from: String,
    /// Parameters that were given other values.
    #[serde(default)]
    pub changed: Vec<String>,
    /// Name of the phase; `main` where there is only one.
    pub phase: String,
    /// Columns that were given a value for all rows, each as `column=value`.
    pub at: Vec<String>,
    /// Length of a step; null where nothing depends on it and none was given.
    pub step: Option<f64>,
    /// Unit label of the step.
    pub time_unit: Option<String>,
    /// Names of the states, hidden ones too.
    pub states: Vec<String>,
    /// Unit labels of the states.
    pub units: Vec<Option<String>>,
    /// Names of the measurements.
    pub measurements: Vec<String>,
    /// Column of the data that each measurement is read from.
    pub columns: Vec<String>,
    /// Condition for the rows that each measurement is read from; null for all rows.
    #[serde(rename = "where")]
    pub rows: Vec<Option<String>>,
    /// u: expressions in columns of the data, `1` for what is constant.
    pub inputs: Vec<String>,
    /// Transition matrix, n × n.
    #[serde(rename = "F")]
    pub f: Vec<Vec<f64>>,
    /// Covariance of the process noise, n × n.
    #[serde(rename = "Q")]
    pub q: Vec<Vec<f64>>,
    /// Effect of the inputs on the states, n × k.
    #[serde(rename = "B")]
    pub b: Vec<Vec<f64>>,
    /// Measurement matrix, m × n.
    #[serde(rename = "H")]
    pub h: Vec<Vec<f64>>,
    /// Effect of the inputs on the measurements, m × k.
    #[serde(rename = "D")]
    pub d: Vec<Vec<f64>>,
    /// Covariance of the measurement noise, m × m.
    #[serde(rename = "R")]
    pub r: Vec<Vec<f64>>,
    /// Mean of the initial state of a new test; null for a phase that inherits from the phase before.
    pub x0: Option<Vec<f64>>,
    /// Covariance of the initial state, n × n.
    #[serde(rename = "P0")]
    pub p0: Option<Vec<Vec<f64>>>,
    /// Time of x0: `first row`, `one step before the first row` or `time …`.
    pub x0_at: String,
    /// Row whose columns the inputs u of a step are computed from: `own`, the row that the step leads to, or
    /// `previous`. In measurements it is the own row.
    pub input_row: String,
    /// What else should be known, in plain words.
    pub notes: Vec<String>,
}

/// Facts about a filter that the core does not know.
#[derive(Debug)]
pub struct ExportSource<'a> {
    /// What the parameters were taken from, as named by the user.
    pub from: String,
    /// Parameters that were given other values.
    pub changed: Vec<String>,
    /// Columns that were given a value, as (name, value).
    pub at: &'a [(String, String)],
    /// Puts expressions of the filter's phase into words.
    pub words: &'a dyn Words,
}

/// Puts expressions into words.
pub trait Words: std::fmt::Debug {
    /// The expression with the names of the model.
    fn of(&self, expression: &Expression) -> String;
}

impl ExportRecord {
    /// The record of a filter of a model.
    pub fn new(model: &PhasedModel, filter: &Exported, source: &ExportSource<'_>) -> ExportRecord {
        let phase = &model.phases[filter.phase];
        let own = &phase.model;
        let words = |expression: &Expression| source.words.of(expression);
        let measured = || filter.measurements.iter().map(|&m| &own.measurements[m]);
        ExportRecord {
            schema: EXPORT_SCHEMA.to_owned(),
            kalfit_version: env!("CARGO_PKG_VERSION").to_owned(),
            title: own.title.clone(),
            from: source.from.clone(),
            changed: source.changed.clone(),
            phase: phase.name.clone(),
            at: source.at.iter().map(|(column, value)| format!("{column}={value}")).collect(),
            step: filter.step,
            time_unit: own.clock.unit.clone(),
            states: own.states.iter().map(|state| state.name.clone()).collect(),
            units: own.states.iter().map(|state| state.unit.clone()).collect(),
            measurements: measured().map(|measurement| measurement.name.clone()).collect(),
            columns: measured().map(|measurement| own.columns[measurement.column].name.clone()).collect(),
            rows: filter.filters.iter().map(|filter| filter.as_ref().map(words)).collect(),
            inputs: filter.inputs.iter().map(words).collect(),
            f: rows(&filter.F),
            q: rows(&filter.Q),
            b: rows(&filter.B),
            h: rows(&filter.H),
            d: rows(&filter.D),
            r: rows(&filter.R),
            x0: filter.start.as_ref().map(|(x0, _)| x0.as_slice().to_vec()),
            p0: filter.start.as_ref().map(|(_, p0)| rows(p0)),
            x0_at: match &own.clock.initial_time {
                Some(time) => format!("time {}", words(time)),
                None if own.clock.step_first => "one step before the first row".to_owned(),
                None => "first row".to_owned(),
            },
            input_row: if own.clock.previous_inputs { "previous" } else { "own" }.to_owned(),
            notes: notes(model, filter),
        }
    }
}

fn notes(model: &PhasedModel, filter: &Exported) -> Vec<String> {
    let phase = &model.phases[filter.phase];
    let mut notes = Vec::new();
    if filter.start.is_none() {
        notes.push(format!(
            "phase `{}` inherits its start from the end of the phase before it, so x0 and P0 are left out",
            phase.name
        ));
    } else if !model.levels.is_empty() {
        notes.push("a new test is one of a new unit: P0 holds the spreads of all levels together".to_owned());
    }
    if phase.filter.is_some() {
        notes.push("this is the optimal filter of the model, not the one of `[filter]`".to_owned());
    }
    if phase.model.covariance.known.is_some() && filter.start.is_some() {
        notes.push("P0 holds the known covariance that the model adds to the estimated one".to_owned());
    }
    notes
}
