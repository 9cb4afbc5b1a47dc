//! A plan as others read it: plan.json. Unknown figures are null, never NaN.

use serde::{Deserialize, Serialize};

use crate::model::Model;
use crate::plan::{Plan, Planned, Quantity, Reason};
use crate::record::DataRecord;

/// Expected standard errors against the number of tests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanRecord {
    /// Always `kalfit-plan/1`.
    pub schema: String,
    /// Version that made it.
    pub kalfit_version: String,
    /// Title of the model.
    pub title: String,
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: Option<String>,
    /// What the population was taken from, as named by the user.
    pub from: String,
    /// Counts of the design.
    pub design: DataRecord,
    /// Always `expected`: the kind of information the standard errors come from.
    pub information: String,
    /// Dynamic parameters that the model leaves free. They are taken as known at the population's values.
    pub parameters_taken_as_known: Vec<String>,
    /// The numbers of tests.
    pub tests: Vec<usize>,
    /// All quantities, in the order of [`Plan::quantities`].
    pub quantities: Vec<PlannedRecord>,
}

/// One quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlannedRecord {
    /// `mean`, `regression`, `std_dev`, `correlation` or `covariance`.
    pub quantity: String,
    /// Its phase; `main` when there is but one.
    pub phase: String,
    /// Its state, or its two states.
    pub states: Vec<String>,
    /// Column of a regression coefficient.
    pub column: Option<String>,
    /// Unit label of the state, for a mean or a standard deviation.
    pub unit: Option<String>,
    /// Its value in the population.
    pub value: Option<f64>,
    /// Its standard error at each number of tests.
    pub std_error: Vec<Option<f64>>,
    /// Why the standard errors are null: `fixed`, `unidentified` or `boundary`.
    pub reason: Option<String>,
}

/// What the core does not know about a plan.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanProvenance {
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: Option<String>,
    /// What the population was taken from, as named by the user.
    pub from: String,
    /// Counts of the design.
    pub design: DataRecord,
    /// Free parameters that were given the population's values.
    pub parameters_taken_as_known: Vec<String>,
}

impl PlanRecord {
    /// The record of a plan.
    pub fn new(model: &Model, plan: &Plan, provenance: PlanProvenance) -> PlanRecord {
        PlanRecord {
            schema: "kalfit-plan/1".to_owned(),
            kalfit_version: env!("CARGO_PKG_VERSION").to_owned(),
            title: model.title.clone(),
            model_digest: provenance.model_digest,
            from: provenance.from,
            design: provenance.design,
            information: "expected".to_owned(),
            parameters_taken_as_known: provenance.parameters_taken_as_known,
            tests: plan.tests.clone(),
            quantities: plan.quantities.iter().map(|planned| record(model, planned, plan.tests.len())).collect(),
        }
    }
}

fn record(model: &Model, planned: &Planned, many: usize) -> PlannedRecord {
    let state = |element: usize| &model.states[model.estimated[element]];
    let name = |element: usize| state(element).name.clone();
    let (quantity, states, unit) = match planned.quantity {
        Quantity::Mean(i) => ("mean", vec![name(i)], state(i).unit.clone()),
        Quantity::Coefficient(c) => ("regression", vec![name(model.mean.regression[c].element)], None),
        Quantity::StdDev(i) => ("std_dev", vec![name(i)], state(i).unit.clone()),
        Quantity::Correlation(i, j) => ("correlation", vec![name(j), name(i)], None),
        Quantity::Covariance(i, j) => ("covariance", vec![name(j), name(i)], None),
    };
    let column = match planned.quantity {
        Quantity::Coefficient(c) => Some(model.columns[model.mean.regression[c].column].name.clone()),
        _ => None,
    };
    let reason = planned.std_errors.as_ref().err().map(|reason| match reason {
        Reason::Fixed => "fixed",
        Reason::Unidentified => "unidentified",
        Reason::Boundary => "boundary",
    });
    PlannedRecord {
        quantity: quantity.to_owned(),
        phase: "main".to_owned(),
        states,
        column,
        unit,
        value: planned.value,
        std_error: match &planned.std_errors {
            Ok(errors) => errors.iter().map(|&error| Some(error).filter(|e| e.is_finite())).collect(),
            Err(_) => vec![None; many],
        },
        reason: reason.map(str::to_owned),
    }
}
