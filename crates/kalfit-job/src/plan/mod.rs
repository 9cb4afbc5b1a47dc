//! `kalfit plan`.

mod candidates;
mod choose;
mod design;
pub(crate) mod error;
mod goal;
mod mission;
mod planned;

use kalfit::record::PlanRecord;

use crate::failure::Failure;
use crate::job::{JobDone, PlanJob, PlanRequest};
use crate::work::JobWatch;
use crate::{memory, model, truth};

impl From<error::BestPlanError> for Failure {
    fn from(error: error::BestPlanError) -> Failure {
        Failure::BestPlan(Box::new(error))
    }
}

/// Expects standard errors against the number of tests, or chooses the best plan among candidates.
///
/// # Errors
/// Bad input, or [`Failure::Interrupted`].
pub fn plan(job: &PlanJob, watch: &mut dyn JobWatch) -> Result<JobDone<PlanRecord>, Failure> {
    let (spec, truth) = truth::load(&job.model, &job.from)?;
    memory::suffices(&spec)?;
    match &job.request {
        PlanRequest::Design(plan) => design::expected(job, plan, (spec, truth), watch),
        PlanRequest::Best(best) => {
            let hint =
                "`--groups` and `--tests` compare numbers of levels, units and tests, as in `--groups bench=6,12`";
            model::refuse_crossed(&spec, "the best of candidates is not sought", hint)?;
            choose::choose(job, best, (spec, truth), watch)
        }
    }
}
