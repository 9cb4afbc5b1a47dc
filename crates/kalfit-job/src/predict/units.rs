//! Whose tests are predicted: of new units, or of units that a fit knows.

use std::collections::HashMap;

use kalfit::predict::Initial;
use kalfit::reduce::grouping;
use kalfit::{Grouping, Labels, PhasedTest};
use kalfit_spec::Spec;

use crate::failure::{Failure, UnknownUnit};
use crate::job::{PredictJob, PredictedUnits};
use crate::model;
use crate::truth::Truth;

/// The laws of initial states.
pub(super) enum UnitLaws {
    /// All tests are of new units.
    New(Initial),
    /// Of units by name.
    Known {
        units: HashMap<Vec<String>, Initial>,
        /// Name of the innermost level.
        level: String,
        path: String,
    },
}

impl UnitLaws {
    pub(super) fn new(job: &PredictJob, spec: &Spec, truth: &Truth) -> Result<UnitLaws, Failure> {
        if job.units == PredictedUnits::New {
            return Ok(UnitLaws::New(Initial::new(&spec.model, &truth.population)));
        }
        let hint = "`--units new` predicts a new unit at new levels; posteriors of units and levels are in the fit";
        model::refuse_crossed(spec, "known units are not predicted", hint)?;
        let level = spec.model.nested().last().ok_or(Failure::NoUnits { why: "the model has no levels of groups" })?;
        let record = truth.record.as_ref().ok_or(Failure::NoUnits { why: "a model file knows no units" })?;
        let units = record.unit_laws(&spec.model, &truth.population);
        Ok(UnitLaws::Known { units, level: level.name.clone(), path: job.from.name() })
    }

    /// Whether the laws of known units say how their means follow the estimated covariances.
    pub(super) fn have_covariance_errors(&self) -> Option<bool> {
        match self {
            UnitLaws::New(_) => None,
            UnitLaws::Known { units, .. } => Some(units.values().all(|unit| unit.by_estimates.is_some())),
        }
    }

    /// The groups of tests, where they count.
    pub(super) fn grouping(&self, design: &Spec, tests: &[PhasedTest]) -> Result<Option<Grouping>, Failure> {
        match self {
            UnitLaws::New(_) => Ok(None),
            UnitLaws::Known { .. } => {
                let found = grouping(&design.model, tests);
                found.map_err(|error| Failure::Apply(Box::new(error.into())))
            }
        }
    }

    /// The law of a test's initial state.
    pub(super) fn initial(
        &self,
        test: &PhasedTest,
        grouping: Option<&Grouping>,
        labels: &Labels,
    ) -> Result<&Initial, Failure> {
        let (units, level, path) = match self {
            UnitLaws::New(initial) => return Ok(initial),
            UnitLaws::Known { units, level, path } => (units, level, path),
        };
        let group = grouping.and_then(|grouping| {
            let number = grouping.number(&test.id)?;
            Some(grouping.groups(0)[grouping.group_of(number, 0)].path.iter().map(|&name| labels.text(name).to_owned()))
        });
        let name: Vec<String> = group.map(Iterator::collect).unwrap_or_default();
        units.get(&name).ok_or_else(|| {
            let mut known: Vec<String> = units.keys().map(|unit| format!("`{}`", unit.join("/"))).collect();
            known.sort();
            let more = known.len().saturating_sub(MOST);
            let listed = known[..known.len().min(MOST)].join(", ");
            let known = match (known.len(), more) {
                (0, _) => "it was written without what is known of each unit".to_owned(),
                (_, 0) => format!("it knows {listed}"),
                _ => format!("it knows {listed} and {more} more"),
            };
            let (test, unit) = (test.id.to_string(), name.join("/"));
            Failure::UnknownUnit(Box::new(UnknownUnit { test, level: level.clone(), unit, path: path.clone(), known }))
        })
    }
}

/// No more names than this in a message.
const MOST: usize = 10;
