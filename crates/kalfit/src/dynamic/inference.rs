//! What each number of a fit with free α is worth.

use crate::dynamic::covariances::ValueCovariances;
use crate::dynamic::mixed::mixed;
use crate::dynamic::profile_likelihood::ProfileLikelihood;
use crate::dynamic::{
    Coordinate, DynamicError, DynamicFit, ParameterInference, Standing, expected, interval, law, profile, sandwich,
};
use crate::estimate::{Criterion, Estimate, JointLaw, Stop};
use crate::infer::{Choices, Inference, IntervalKind, QUANTILE, StdErrors, sensitivities};
use crate::model::PhasedModel;
use crate::reduce::PhasedTest;

/// A logarithm with a standard error beyond this is not determined by the data.
const UNDETERMINED: f64 = 10.0;

/// What each number is worth: of μ and Σ with the uncertainty of α in it, and of each free value of α.
pub fn infer(
    model: &PhasedModel,
    tests: &[PhasedTest],
    fit: &DynamicFit,
    choices: Choices,
) -> Result<(Inference, Vec<ParameterInference>), DynamicError> {
    let ml = fit.estimate.criterion == Criterion::Ml;
    let objective = match fit.reductions.remote() {
        Some(remote) => {
            ProfileLikelihood::elsewhere(model, (&fit.slots, &fit.settings), (&remote.answers, fit.values.clone()))
        }
        None => ProfileLikelihood::new(model, tests, &fit.slots, &fit.settings),
    };
    let spread = |covariances: ValueCovariances| spread(&objective, fit, covariances);
    let (estimate, observed) = with_law(&objective, fit);
    // by profiles only once the maximum is certain
    let wald = Choices { intervals: IntervalKind::Wald, ..choices };
    let asked = match choices.std_errors {
        StdErrors::Sandwich if ml => Some(spread(sandwich::sandwich(&objective, fit, &observed)?)),
        StdErrors::Expected if ml => Some(spread(of_expectation(&objective, fit)?)),
        _ => None,
    };
    let (mut inference, mut parameters) = match &asked {
        Some(asked) => {
            let mut other = fit.estimate.clone();
            other.state.joint = Some(law::joint(model, fit, asked));
            let inference = crate::infer::infer(&other, &fit.reductions, wald);
            // score tests stay those of the observed information
            let inference = Inference { sensitivities: sensitivities(&estimate), ..inference };
            (inference, parameter_inferences(model, fit, asked))
        }
        None => {
            let inference = crate::infer::infer(&estimate, &fit.reductions, wald);
            (inference, parameter_inferences(model, fit, &observed))
        }
    };
    if choices.intervals == IntervalKind::Profile && fit.stop == Stop::Certified {
        let kept = interval::profiles(&objective, fit, &observed, &mut parameters)?;
        if fit.estimate.stop == Stop::Certified {
            profile::profiles((&objective, fit), &estimate, &observed, (&mut inference, &parameters));
        }
        inference.intervals.unprofiled += kept;
    }
    Ok((inference, parameters))
}

/// The estimate with the law of (α, μ, Σ) from the observed information, and that law.
pub(super) fn with_law(objective: &ProfileLikelihood<'_>, fit: &DynamicFit) -> (Estimate, ValueCovariances) {
    let observed = spread(objective, fit, fit.joint.covariances());
    let joint = law::joint(objective.model, fit, &observed);
    let mut estimate = fit.estimate.clone();
    estimate.state.joint = Some(JointLaw { mixed: mixed(objective, fit, &observed), ..joint });
    (estimate, observed)
}

/// Covariances with those of noises that are as large as their variances allow.
fn spread(objective: &ProfileLikelihood<'_>, fit: &DynamicFit, mut covariances: ValueCovariances) -> ValueCovariances {
    let known = (&fit.slots, &objective.coordinates[..]);
    objective.edges.spread((&fit.sought, &fit.alpha), known, &fit.values, &mut covariances);
    covariances
}

/// Covariances from the expected information, where it is worked out.
fn of_expectation(objective: &ProfileLikelihood<'_>, fit: &DynamicFit) -> Result<ValueCovariances, DynamicError> {
    let found = if expected::is_possible(objective) { expected::expected(objective, fit)? } else { None };
    found.ok_or_else(|| {
        let parameter = fit.slots.slots().first().map_or(0, |slot| slot.parameter);
        DynamicError::Expected { parameter: objective.model.shared().parameters[parameter].name.clone() }
    })
}

/// Standard errors by the delta method; intervals by Wald in the coordinate, so that those of positive values are positive.
fn parameter_inferences(
    model: &PhasedModel,
    fit: &DynamicFit,
    covariances: &ValueCovariances,
) -> Vec<ParameterInference> {
    let coordinates = Coordinate::of(model, &fit.slots);
    let one = |s: usize| {
        let (coordinate, value) = (coordinates[s], fit.values[s]);
        let nothing = |standing| ParameterInference { std_error: None, interval: None, standing };
        if fit.standing[s] != Standing::Inside {
            return nothing(fit.standing[s]);
        }
        let Some(error) = covariances.alpha[s].map(f64::sqrt).filter(|e| e.is_finite()) else {
            return nothing(Standing::Unidentified);
        };
        if coordinate.log && error > UNDETERMINED {
            return nothing(Standing::Unidentified);
        }
        let ends = [-QUANTILE, QUANTILE].map(|quantile| coordinate.moved(value, quantile * error));
        ParameterInference {
            std_error: Some(error * coordinate.slope(value)),
            interval: Some(ends.map(Some)),
            standing: Standing::Inside,
        }
    };
    (0..fit.values.len()).map(one).collect()
}
