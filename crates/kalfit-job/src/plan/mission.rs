//! The mission of a plan: a test that has not been made.

use kalfit::model::Slots;
use kalfit::plan::{CandidateInformation, MissionValue, mission};
use kalfit::predict::What;
use kalfit::{Alpha, PhasedTest};
use kalfit_data::Input;
use kalfit_spec::{DesignSpec, Spec};

use crate::evidence::CommandInputs;
use crate::failure::Failure;
use crate::job::BestPlanRequest;
use crate::plan::error::BestPlanError;
use crate::refused::by_predict;
use crate::work::JobWork;
use crate::{predict, tests};

/// The test that has not been made, whose values are figures.
pub(super) struct Mission {
    design: DesignSpec,
    test: Option<PhasedTest>,
}

impl Mission {
    pub(super) fn read(spec: &Spec, request: &BestPlanRequest, work: &mut JobWork<'_>) -> Result<Mission, Failure> {
        let design = predict::design(spec, request.outputs.as_ref(), false)?;
        if request.mission.is_empty() {
            return Ok(Mission { design, test: None });
        }
        let inputs = Input::expand(&request.mission).map_err(|error| Failure::data(error, &design.spec))?;
        let (mut tests, _) = tests::read(&design.spec, &CommandInputs::rows_of(inputs), work)?;
        match tests.len() {
            1 => Ok(Mission { design, test: tests.pop() }),
            found => Err(BestPlanError::Mission { found }.into()),
        }
    }

    /// The candidates with the values of the mission at their parameters.
    pub(super) fn on(
        &self,
        candidates: CandidateInformation,
        slots: &Slots,
        alpha: &Alpha,
    ) -> Result<CandidateInformation, Failure> {
        let Some(test) = &self.test else { return Ok(candidates) };
        let design = (&self.design.spec.model, &self.design.outputs[..], alpha);
        let found = mission(design, test, (&candidates.candidates, slots)).map_err(|error| by_predict(error, None))?;
        Ok(candidates.with_mission(found))
    }

    /// `range, 3` for output `range` at row 3, with the phase where there are several.
    pub(super) fn names(&self, candidates: &CandidateInformation) -> Vec<String> {
        let model = &self.design.spec.model;
        let of = |one: &MissionValue| {
            let phase = &model.phases[one.phase];
            let name = match one.what {
                What::State(state) => &phase.model.states[state].name,
                What::Output(output) => &self.design.outputs[one.phase][output].name,
            };
            let prefix = if model.is_single() { String::new() } else { format!("{}.", phase.name) };
            format!("{prefix}{name}, {}", one.row + 1)
        };
        candidates.mission().iter().map(of).collect()
    }
}
