//! What each number of a fit with free α is worth.

use crate::dynamic::bench::Bench;
use crate::dynamic::covariances::Covariances;
use crate::dynamic::{DynamicError, DynamicFit, ParameterInference, interval, law, profile, sandwich, worth};
use crate::estimate::{Criterion, Stop};
use crate::infer::{Choices, Inference, IntervalKind, StdErrors, sensitivities};
use crate::model::PhasedModel;
use crate::reduce::PhasedTest;

/// What each number is worth: of μ and Σ with the uncertainty of α in it, and of each free value of α.
pub fn infer(
    model: &PhasedModel,
    tests: &[PhasedTest],
    fit: &DynamicFit,
    choices: Choices,
) -> Result<(Inference, Vec<ParameterInference>), DynamicError> {
    let ml = fit.estimate.criterion == Criterion::Ml;
    if let (StdErrors::Expected, true, Some(slot)) = (choices.std_errors, ml, fit.slots.slots().first()) {
        let parameter = model.shared().parameters[slot.parameter].name.clone();
        return Err(DynamicError::Expected { parameter });
    }
    let bench = Bench::new(model, tests, &fit.slots, &fit.settings);
    let known = (&fit.slots, &bench.coordinates[..]);
    let spread = |mut covariances: Covariances| {
        bench.edges.spread((&fit.sought, &fit.alpha), known, &fit.values, &mut covariances);
        covariances
    };
    let observed = spread(fit.joint.covariances());
    let mut estimate = fit.estimate.clone();
    estimate.state.joint = Some(law::joint(model, fit, &observed));
    // by profiles only once the maximum is certain
    let wald = Choices { intervals: IntervalKind::Wald, ..choices };
    let sandwich = match choices.std_errors {
        StdErrors::Sandwich if ml => Some(spread(sandwich::sandwich(&bench, fit, &observed)?)),
        _ => None,
    };
    let (mut inference, mut parameters) = match &sandwich {
        Some(sandwich) => {
            let mut robust = fit.estimate.clone();
            robust.state.joint = Some(law::joint(model, fit, sandwich));
            let inference = crate::infer::infer(&robust, &fit.reductions, wald);
            // score tests stay those of the observed information
            let inference = Inference { sensitivities: sensitivities(&estimate), ..inference };
            (inference, worth::parameters(model, fit, sandwich))
        }
        None => {
            let inference = crate::infer::infer(&estimate, &fit.reductions, wald);
            (inference, worth::parameters(model, fit, &observed))
        }
    };
    if choices.intervals == IntervalKind::Profile && fit.stop == Stop::Certified {
        interval::profiles(&bench, fit, &observed, &mut parameters)?;
        if fit.estimate.stop == Stop::Certified {
            profile::profiles((&bench, fit), &estimate, &observed, (&mut inference, &parameters));
        }
    }
    Ok((inference, parameters))
}
