//! The parameters that a plan is made for, and what candidates and earlier tests tell of them.

use std::sync::Arc;

use kalfit::dynamic::{UnitError, UnitInformation, unit_information};
use kalfit::estimate::{ExpectedError, Structure};
use kalfit::infer::Knowledge;
use kalfit::model::{Level, PhasedModel, Slots, Value};
use kalfit::plan::{CandidateInformation, DrawnParameters, PlanError};
use kalfit::reduce::{PhasedReducer, grouping};
use kalfit::{Alpha, Grouping, PhasedTest, Population, Reductions};
use kalfit_data::DataReading;
use kalfit_spec::Spec;

use crate::dynamic;
use crate::failure::Failure;
use crate::job::{BestPlanRequest, SoFar};
use crate::plan::candidates::{self, ReadCandidates};
use crate::plan::error::BestPlanError;
use crate::results::{self, FIT};
use crate::truth::Truth;
use crate::truth::error::TruthError;
use crate::work::JobWork;

/// The model with the parameters free that the model file leaves free, but for parameters with a value for each level of a
/// column: a plan has candidates of few levels.
pub(super) fn freed(spec: &Spec, original: &Spec, truth: &Truth) -> PhasedModel {
    let mut free = spec.model.clone();
    for model in free.models_mut() {
        for (own, original) in model.parameters.iter_mut().zip(&original.model.shared().parameters) {
            if truth.taken.contains(&own.name) && own.per.is_none() {
                own.value = original.value;
            }
        }
    }
    free
}

/// Tests with their reductions and groups.
pub(super) struct TestsToPlan<'a> {
    tests: &'a [PhasedTest],
    pub(super) reductions: Reductions,
    grouping: Option<Arc<Grouping>>,
}

impl<'a> TestsToPlan<'a> {
    pub(super) fn new(
        model: &PhasedModel,
        tests: &'a [PhasedTest],
        reading: &DataReading,
        alpha: &Alpha,
    ) -> Result<TestsToPlan<'a>, Failure> {
        let refused = |error| Failure::Reduce { error, reading: Some(Box::new(reading.clone())) };
        let reducer = PhasedReducer::new(model, alpha).map_err(refused)?;
        let reductions = reducer.reduce_designs(tests).map_err(refused)?;
        let grouping = grouping(model, tests).map_err(|error| dynamic::failure(error.into(), reading))?;
        Ok(TestsToPlan { tests, reductions, grouping: grouping.map(Arc::new) })
    }

    /// The name of each unit: of its test, or of its group of the outermost level.
    pub(super) fn names(&self, found: &UnitInformation, read: &ReadCandidates) -> Vec<String> {
        let of = |members: &Vec<usize>| {
            let test = &self.tests[members[0]];
            let group = self.grouping.as_deref().and_then(|grouping| {
                let number = grouping.number(test.id.as_str())?;
                let group = &grouping.groups(0)[grouping.group_of(number, 0)];
                Some(read.reading.labels.text(*group.path.first()?).to_owned())
            });
            group.unwrap_or_else(|| test.id.to_string())
        };
        found.members.iter().map(of).collect()
    }
}

/// The parameters that are planned for.
pub(super) struct Planned<'a> {
    pub(super) free: &'a PhasedModel,
    pub(super) population: &'a Population,
    pub(super) alpha: &'a Alpha,
}

impl Planned<'_> {
    /// The free values that a plan takes into account, and the names of free parameters that it takes as known: those with
    /// values of levels, and those that Σ depends on.
    pub(super) fn slots(
        &self,
        tests: &TestsToPlan<'_>,
        reading: &DataReading,
    ) -> Result<(Slots, Vec<String>), Failure> {
        let all = Slots::in_phases(self.free, &reading.labels, tests.tests);
        let parameters = &self.free.shared().parameters;
        let mut known = Vec::new();
        for slot in all.slots() {
            let mut moved = self.alpha.clone();
            if let Level::Common(value) = &mut moved.values[slot.parameter] {
                *value = if *value == 0.0 { 1e-3 } else { *value * 1.001 };
            }
            let structure = Structure::of(self.free, &moved, tests.grouping.as_ref());
            let off = kalfit::estimate::information_at_population(&tests.reductions, &structure, self.population);
            if matches!(off, Err(ExpectedError::Off { .. })) {
                known.push(slot.parameter);
            }
        }
        let name = |&parameter: &usize| parameters[parameter].name.clone();
        let mut names: Vec<String> = known.iter().map(name).collect();
        let is_free = |parameter: &&kalfit::model::Parameter| matches!(parameter.value, Value::Free { .. });
        names.extend(parameters.iter().filter(|own| own.per.is_some()).filter(is_free).map(|own| own.name.clone()));
        Ok((all.without(&known), names))
    }

    /// The candidates with what is known before.
    fn after(
        &self,
        candidates: CandidateInformation,
        slots: &Slots,
        before: &Before,
        work: &mut JobWork<'_>,
    ) -> Result<CandidateInformation, Failure> {
        Ok(match before {
            Before::Nothing => candidates,
            Before::Tests(tests, reading) => {
                let made = TestsToPlan::new(self.free, tests, reading, self.alpha)?;
                candidates.after_tests(&self.information(&made, (slots, &values(slots, self.alpha)), work)?)
            }
            Before::Fit(knowledge) => candidates.after_fit(knowledge, slots),
        })
    }

    /// The candidates at other parameters; `None` where the model's structure cannot have them.
    pub(super) fn at(
        &self,
        other: &DrawnParameters,
        (read, slots): (&ReadCandidates, &Slots),
        before: &Before,
        work: &mut JobWork<'_>,
    ) -> Result<Option<CandidateInformation>, Failure> {
        let alpha = other.alpha(self.alpha, slots);
        let planned = Planned { free: self.free, population: &other.population, alpha: &alpha };
        let tests = TestsToPlan::new(self.free, &read.tests, &read.reading, &alpha)?;
        match planned.information(&tests, (slots, &other.values), work) {
            Ok(found) => Ok(Some(planned.after(CandidateInformation::new(found), slots, before, work)?)),
            Err(Failure::Plan { error, .. }) if matches!(*error, PlanError::OffStructure { .. }) => Ok(None),
            Err(failure) => Err(failure),
        }
    }

    pub(super) fn information(
        &self,
        tests: &TestsToPlan<'_>,
        slots: (&Slots, &[f64]),
        work: &mut JobWork<'_>,
    ) -> Result<UnitInformation, Failure> {
        let structure = Structure::of(self.free, self.alpha, tests.grouping.as_ref());
        let of = (&tests.reductions, &structure, self.population);
        let found = unit_information((self.free, tests.tests), slots, of, work);
        let refused = |error: UnitError| match error {
            UnitError::Expected(error) => {
                Failure::Plan { error: Box::new(PlanError::from(error)), states: self.free.estimated_names() }
            }
            UnitError::Dynamic(error) => Failure::Dynamic(Box::new(error)),
            UnitError::NotByRows => BestPlanError::NotByRows(error.to_string()).into(),
        };
        found.map_err(refused)?.ok_or(Failure::Interrupted)
    }
}

pub(super) fn values(slots: &Slots, alpha: &Alpha) -> Vec<f64> {
    let of = |slot: &kalfit::model::Slot| match &alpha.values[slot.parameter] {
        Level::Common(value) => *value,
        Level::Each { other, .. } => other.unwrap_or(f64::NAN),
    };
    slots.slots().iter().map(of).collect()
}

/// What is known before any test of the plan.
pub(super) enum Before {
    Nothing,
    Tests(Vec<PhasedTest>, DataReading),
    Fit(Box<Knowledge>),
}

/// The candidates with what is known before any test of the plan.
pub(super) fn with_so_far(
    spec: &mut Spec,
    request: &BestPlanRequest,
    (planned, slots): (&Planned<'_>, &Slots),
    candidates: CandidateInformation,
    work: &mut JobWork<'_>,
) -> Result<(CandidateInformation, Before), Failure> {
    let before = match &request.so_far {
        None => Before::Nothing,
        Some(SoFar::Tests(data)) => {
            let (tests, reading) = candidates::read_made(spec, data, work)?;
            Before::Tests(tests, reading)
        }
        Some(SoFar::Fit(document)) => {
            let record: kalfit::FitRecord = results::read(document, FIT).map_err(TruthError::from)?;
            let knowledge = record.knowledge(planned.free);
            let path = document.name();
            let knowledge = knowledge.ok_or(match record.estimates {
                Some(_) => BestPlanError::OtherModel { path },
                None => BestPlanError::NoErrors { path },
            })?;
            Before::Fit(Box::new(knowledge))
        }
    };
    Ok((planned.after(candidates, slots, &before, work)?, before))
}
