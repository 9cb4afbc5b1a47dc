//! Options of a fit that would have no effect.

use kalfit::estimate::Combination;
use kalfit_spec::Spec;

use crate::failure::Failure;
use crate::job::FitJob;

/// Other starts of α have no effect when nothing of it is free. The methods are then one and the same, and any may be named.
pub(crate) fn refuse_idle(job: &FitJob) -> Result<(), Failure> {
    if job.search.starts > 0 { Err(Failure::NoFreeParameter { option: "--starts" }) } else { Ok(()) }
}

/// One phase cannot be put together with others; to name the default is no harm.
pub(crate) fn refuse_one_phase(job: &FitJob, spec: &Spec) -> Result<(), Failure> {
    match (spec.model.is_single(), job.settings.phases) {
        (false, _) | (true, Combination::Chain) => Ok(()),
        (true, Combination::Marginal) => Err(Failure::OnePhase { found: "marginal" }),
        (true, Combination::Stacked) => Err(Failure::OnePhase { found: "stacked" }),
    }
}
