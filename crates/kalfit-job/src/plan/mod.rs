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
    let hint = "a plan of the model without `crossed` promises too small errors; `kalfit simulate` and fits of what it draws tell them";
    model::refuse_crossed(&spec, "plans are not made", hint)?;
    match &job.request {
        PlanRequest::Design(plan) => design::expected(job, plan, (spec, truth), watch),
        PlanRequest::Best(best) => choose::choose(job, best, (spec, truth), watch),
    }
}
