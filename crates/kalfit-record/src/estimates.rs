//! The covariance of all estimates in a record: later uses of a fit compute errors from it.

use std::collections::HashMap;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use kalfit_infer::{Estimand, EstimateCovariance, Estimated, Knowledge};
use kalfit_model::Labels;
use kalfit_model::{PhasedModel, Slots};

use crate::cut::BlockCut;
use crate::{FitRecord, ParameterRecord, SquareRecord};

/// The covariance of all estimates, except fixed numbers and those on bounds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EstimatesRecord {
    /// Name of each row and column: `mean[a]`, `regression[a, column]`, `covariance[a, b]`, `tau`, `tau[level]`. Where
    /// there are several phases, and for levels of groups, the name of the phase or level comes first, as in `coast:
    /// mean[a]`.
    pub names: Vec<String>,
    /// Covariance of the estimates.
    pub covariance: SquareRecord,
    /// Estimates that the data do not determine.
    pub open: Vec<String>,
    /// Variances and noise levels that were estimated as zero.
    pub at_zero: Vec<String>,
}

/// Names of the elements of μ, of the regression coefficients, and of the elements of Σ.
fn names(model: &PhasedModel) -> Vec<(Estimated, String)> {
    let mut all = Vec::new();
    for cut in BlockCut::blocks(model) {
        let prefix = match cut.level {
            None if model.is_single() => String::new(),
            _ => format!("{}: ", cut.name()),
        };
        let (states, first) = (cut.states(), cut.elements.start);
        if cut.level.is_none() {
            let means = states.iter().enumerate();
            all.extend(means.map(|(i, name)| (Estimated::Mean(first + i), format!("{prefix}mean[{name}]"))));
            let own = &cut.phase.model;
            let regressions = cut.regressions.clone().zip(&own.mean.regression);
            all.extend(regressions.map(|(c, regression)| {
                let (state, column) = (&states[regression.element], &own.columns[regression.column].name);
                (Estimated::Coefficient(c), format!("{prefix}regression[{state}, {column}]"))
            }));
        }
        for (i, second) in states.iter().enumerate() {
            for (j, one) in states[..=i].iter().enumerate() {
                let name = format!("{prefix}covariance[{one}, {second}]");
                all.push((Estimated::Covariance(first + i, first + j), name));
            }
        }
    }
    all
}

/// Name of a parameter, `tau`, or of its value at a level, `tau[level]`.
fn parameter_name(name: &str, level: Option<&str>) -> String {
    level.map_or(name.to_owned(), |level| format!("{name}[{level}]"))
}

impl EstimatesRecord {
    /// Free values of `found` are in the order of the slots; `labels`: texts of the levels of the free values.
    pub(super) fn new(
        model: &PhasedModel,
        found: &EstimateCovariance,
        values: Option<(&Slots, &Labels)>,
    ) -> EstimatesRecord {
        let of: HashMap<Estimated, String> = names(model).into_iter().collect();
        let name = |one: &Estimated| match one {
            Estimated::Value(slot) => {
                let (slots, labels) = values.expect("free values have slots");
                let slot = slots.slots()[*slot];
                let level = slot.level.map(|level| labels.text(level));
                parameter_name(&model.shared().parameters[slot.parameter].name, level)
            }
            other => of[other].clone(),
        };
        EstimatesRecord {
            names: found.quantities.iter().map(name).collect(),
            covariance: (&found.covariance).into(),
            open: found.open.iter().map(name).collect(),
            at_zero: found.at_zero.iter().map(name).collect(),
        }
    }
}

impl FitRecord {
    /// Errors of the estimates, for a model with the same states and parameters; `None` where the record contains no
    /// errors, or errors of estimates with different names.
    pub fn knowledge(&self, model: &PhasedModel) -> Option<Knowledge> {
        let record = self.estimates.as_ref()?;
        let size = record.names.len();
        if record.covariance.size() != size {
            return None;
        }
        let mut of: HashMap<String, Estimand> =
            names(model).into_iter().map(|(one, name)| (name, Estimand::Population(one))).collect();
        for ParameterRecord { name, level, .. } in &self.parameters {
            let parameter = model.shared().parameters.iter().position(|parameter| parameter.name == *name);
            if let Some(parameter) = parameter {
                let known = Estimand::Parameter { parameter, level: level.clone() };
                of.insert(parameter_name(name, level.as_deref()), known);
            }
        }
        let all = |names: &[String]| names.iter().map(|name| of.get(name).cloned()).collect::<Option<Vec<Estimand>>>();
        let covariance = DMatrix::from_fn(size, size, |i, k| record.covariance[i][k]);
        let [quantities, open, at_zero] = [&record.names, &record.open, &record.at_zero].map(|names| all(names));
        let is_restricted = self.criterion == "reml";
        let tests = self.levels.first().map_or(self.data.tests, |level| level.groups) as f64;
        let (quantities, open, at_zero) = (quantities?, open?, at_zero?);
        Some(Knowledge { quantities, covariance, open, at_zero, tests, is_restricted })
    }
}
