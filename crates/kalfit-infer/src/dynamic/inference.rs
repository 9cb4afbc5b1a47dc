//! Uncertainty of each number of a fit with free α.

use crate::dynamic::mixed::mixed;
use crate::dynamic::{expected, interval, law, profile, sandwich, started};
use crate::freed::{self, Freed, Refits};
use crate::score_test::p_value;
use crate::small_sample::{DfChoice, JointTest, NoDf, SmallSample, slopes};
use crate::{Choices, Inference, IntervalKind, QUANTILE, SharedProgress, StdErrors};
use crate::{Sensitivity, holds_any, inferred, sensitivities};
use kalfit_estimate::{Criterion, Estimate, Progress, Silent, Stop};
use kalfit_model::Labels;
use kalfit_model::PhasedModel;
use kalfit_model::PhasedTest;
use kalfit_model::Slots;
use kalfit_search::BeforeRuns;
use kalfit_search::ProfileLikelihood;
use kalfit_search::ValueCovariances;
use kalfit_search::{Coordinate, DynamicError, DynamicFit, ParameterInference, Standing, flat};

/// Standard error of a logarithm beyond which the value counts as not determined by the data.
const UNDETERMINED: f64 = 10.0;

/// Refuses intervals with drawn quantiles where values of α are free.
///
/// # Errors
/// [`DynamicError::Bootstrap`] with the first free parameter.
pub fn accepts_intervals(choices: Choices, model: &PhasedModel, slots: &Slots) -> Result<(), DynamicError> {
    match slots.slots().first().filter(|_| choices.intervals == IntervalKind::Bootstrap) {
        Some(slot) => {
            Err(DynamicError::Bootstrap { parameter: model.shared().parameters[slot.parameter].name.clone() })
        }
        None => Ok(()),
    }
}

/// Uncertainty of μ and Σ with α estimated, and of each free value of α. Reports to `progress` which interval is
/// sought. Once `progress` stops, intervals come from standard errors, standard errors come from the observed
/// information where the expected information is not complete, and fits without each test are omitted.
pub fn infer(
    model: &PhasedModel,
    (labels, tests): (&Labels, &[PhasedTest]),
    fit: &DynamicFit,
    choices: Choices,
    progress: &mut dyn Progress,
) -> Result<(Inference, Vec<ParameterInference>), DynamicError> {
    accepts_intervals(choices, model, &fit.slots)?;
    let progress = &SharedProgress::new(progress, Some(model));
    let ml = fit.estimate.criterion == Criterion::Ml;
    let objective = match fit.reductions.remote() {
        Some(remote) => {
            ProfileLikelihood::elsewhere(model, (&fit.slots, &fit.settings), (&remote.answers, fit.values.clone()))
        }
        None => ProfileLikelihood::new(model, tests, &fit.slots, &fit.settings),
    };
    let (estimate, observed) = estimate_with_law(&objective, fit);
    let spread = |mut covariances: ValueCovariances| {
        covariances.without_flat(&observed);
        spread(&objective, fit, covariances)
    };
    // intervals by profiles only where the maximum is certified
    let mut wald = Choices { intervals: IntervalKind::Wald, ..choices };
    let requested = match choices.std_errors {
        StdErrors::Sandwich if ml => Some(spread(sandwich::sandwich(&objective, fit, &observed)?)),
        StdErrors::Expected if ml => expected_covariances(&objective, fit, progress)?.map(spread),
        _ => None,
    };
    if requested.is_none() {
        wald.std_errors = StdErrors::Observed;
    }
    let (mut inference, mut parameters) = match &requested {
        Some(requested) => {
            let mut other = fit.estimate.clone();
            other.state.joint = Some(law::joint(model, fit, requested));
            let inference = inferred(&other, &fit.reductions, wald, progress);
            (inference, parameter_inferences(model, fit, requested))
        }
        None => {
            let inference = inferred(&estimate, &fit.reductions, wald, progress);
            (inference, parameter_inferences(model, fit, &observed))
        }
    };
    inference.sensitivities = constraints(&objective, fit, (&estimate, labels), choices, progress)?;
    inference.add_few_tests(small_sample(&objective, fit, (&estimate, &observed), (choices, progress)));
    let rows = tests.iter().map(PhasedTest::row_count).sum();
    let kind = choices.intervals.resolved(&estimate, fit.reductions.len(), rows);
    if kind == IntervalKind::Profile && fit.stop == Stop::Certified {
        let from_errors = (inference.intervals.clone(), parameters.clone());
        let goes_on = |runs| progress.goes_on(runs);
        let objective = objective.while_waited_for(BeforeRuns(&goes_on));
        let worth = (&mut inference, &mut parameters[..]);
        let found = profiles((&objective, fit), (&estimate, &observed), worth, (labels, progress));
        if progress.stops() {
            (inference.intervals, parameters) = from_errors;
        } else {
            found?;
        }
    }
    Ok((inference, parameters))
}

/// The laws of few tests at a fit; `estimate` and `observed` are of [`estimate_with_law`].
fn small_sample(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    (estimate, observed): (&Estimate, &ValueCovariances),
    (choices, progress): (Choices, &SharedProgress<'_>),
) -> Option<Result<SmallSample, NoDf>> {
    if choices.df == DfChoice::None || estimate.criterion == Criterion::Ml {
        return None;
    }
    let errors: Vec<Option<f64>> = observed.alpha.iter().map(|variance| variance.map(f64::sqrt)).collect();
    let noise = || slopes(objective, fit, &errors, progress);
    SmallSample::with_parameters(estimate, &fit.reductions, choices.df, &noise)
}

/// Replaces intervals from standard errors by profile intervals.
fn profiles(
    (objective, fit): (&ProfileLikelihood<'_>, &DynamicFit),
    (estimate, observed): (&Estimate, &ValueCovariances),
    (inference, parameters): (&mut Inference, &mut [ParameterInference]),
    (labels, progress): (&Labels, &SharedProgress<'_>),
) -> Result<(), DynamicError> {
    let wald_count = interval::profiles(objective, fit, observed, parameters, (labels, progress))?;
    if fit.estimate.stop == Stop::Certified {
        profile::profiles((objective, fit), estimate, observed, (inference, parameters), progress);
    }
    inference.intervals.unprofiled += wald_count;
    Ok(())
}

/// The estimate with the law of (α, μ, Σ) from the observed information, and the covariances of this law.
pub(super) fn estimate_with_law(objective: &ProfileLikelihood<'_>, fit: &DynamicFit) -> (Estimate, ValueCovariances) {
    let observed = spread(objective, fit, fit.joint.covariances_with(&flat::examined_eigenvalues(objective, fit)));
    let mut estimate = fit.estimate.clone();
    estimate.state.joint = Some(law::joint(objective.model, fit, &observed));
    (estimate, observed)
}

/// Score tests of the constraints on (μ, Σ), with α adapting, and likelihood ratios of those that they reject.
fn constraints(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    (estimate, labels): (&Estimate, &Labels),
    choices: Choices,
    progress: &SharedProgress<'_>,
) -> Result<Vec<Sensitivity>, DynamicError> {
    if !holds_any(&estimate.state) {
        return Ok(Vec::new());
    }
    let mut estimate = estimate.clone();
    if let Some(joint) = &mut estimate.state.joint {
        joint.mixed = mixed(objective, fit, progress)?;
    }
    let mut found = sensitivities(&estimate);
    if fit.stop == Stop::Certified && freed::is_possible(&fit.estimate, &fit.reductions) {
        let maximum = |freed: &Freed, level: f64, one_sided: bool| match progress.stops() {
            true => None,
            false => freed_maximum(objective, fit, labels, (freed, level, one_sided)),
        };
        let f_test = |freed: &Freed| match progress.stops() {
            true => None,
            false => f_test(objective, fit, labels, (freed, choices), progress),
        };
        freed::add_refits(&fit.estimate, &mut found, &Refits { maximum: &maximum, f_test: &f_test });
    }
    Ok(found)
}

/// ℓ_max with a constraint freed. Where the fit at the α of the constrained maximum decides at `level`, α stays there,
/// and the likelihood ratio is a lower bound.
fn freed_maximum(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    labels: &Labels,
    (freed, level, one_sided): (&Freed, f64, bool),
) -> Option<f64> {
    let at_alpha = freed::freed_maximum(&fit.estimate, &fit.reductions, freed);
    let ratio = |maximum: f64| (2.0 * (maximum - fit.estimate.log_likelihood)).max(0.0);
    if at_alpha.is_some_and(|maximum| p_value(ratio(maximum), one_sided) < level) {
        return at_alpha;
    }
    let found = freed_fit(objective, fit, labels, freed).map(|(_, found)| found.estimate.log_likelihood);
    [found, at_alpha].into_iter().flatten().reduce(f64::max).filter(|_| found.is_some())
}

/// The F test of a fixed mean by the laws of few tests, from a fit with it freed.
fn f_test(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    labels: &Labels,
    (freed, choices): (&Freed, Choices),
    progress: &SharedProgress<'_>,
) -> Option<JointTest> {
    let (model, wide) = freed_fit(objective, fit, labels, freed)?;
    let objective = ProfileLikelihood::new(&model, objective.tests, &wide.slots, &wide.settings);
    let (estimate, observed) = estimate_with_law(&objective, &wide);
    let law = small_sample(&objective, &wide, (&estimate, &observed), (choices, progress))?.ok()?;
    law.f_test(&wide.estimate, &fit.estimate).ok()
}

/// The model with a constraint freed, and its fit; `None` without a certified maximum.
fn freed_fit(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    labels: &Labels,
    freed: &Freed,
) -> Option<(PhasedModel, DynamicFit)> {
    let mut model = started(objective.model, (objective.model, fit));
    match freed.part.checked_sub(model.phases.len()) {
        None => {
            let own = &mut model.phases[freed.part].model;
            (own.mean, own.covariance) = (freed.mean.clone(), freed.covariance.clone());
        }
        // the structure has the innermost level first
        Some(level) => {
            let place = model.levels.len() - 1 - level;
            model.levels[place].covariance = freed.covariance.clone();
        }
    }
    let found = kalfit_search::fit(&model, labels, objective.tests, &fit.settings, &mut Silent).ok();
    let certified = |found: &DynamicFit| found.stop == Stop::Certified && found.estimate.stop == Stop::Certified;
    found.filter(certified).map(|found| (model, found))
}

/// Converts the variances of noise covariances in `covariances`, which are variances of the sought values.
fn spread(objective: &ProfileLikelihood<'_>, fit: &DynamicFit, mut covariances: ValueCovariances) -> ValueCovariances {
    let known = (&fit.slots, &objective.coordinates[..]);
    objective.edges.spread((&fit.sought, &fit.alpha), known, &fit.values, &mut covariances);
    covariances
}

/// Covariances from the expected information, or an error where the expected information is not available; `None` once
/// `progress` stops.
fn expected_covariances(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    progress: &SharedProgress<'_>,
) -> Result<Option<ValueCovariances>, DynamicError> {
    let found = if expected::is_possible(objective) { expected::expected(objective, fit, progress)? } else { None };
    if found.is_none() && !progress.stops() {
        let parameter = fit.slots.slots().first().map_or(0, |slot| slot.parameter);
        return Err(DynamicError::Expected { parameter: objective.model.shared().parameters[parameter].name.clone() });
    }
    Ok(found)
}

/// Standard errors by the delta method; Wald intervals in the coordinate, so that the interval of a positive value is
/// positive.
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
