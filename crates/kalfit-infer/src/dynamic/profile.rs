//! Profile-likelihood intervals of μ and Σ where α is free: ℓ with one quantity held, maximised over all other
//! quantities and α.
//!
//! ```text
//! ℓ(x) = max over α of ℓ(α, x),   ℓ(α, x) = max over (μ, Σ) with the quantity held at x, on the reductions at α
//! dℓ(α, x)/dα = ∂ℓ/∂α there       dℓ(x)/dx = the Lagrange multiplier there
//! ```

use std::collections::BTreeSet;

use crate::dynamic::held_profile::{HeldProfile, WarmStart};
use crate::interval::QUANTILE;
use crate::{Holdable, Inference, IntervalKind, SharedProgress, free, profiled, quantities};
use kalfit_estimate::{Criterion, Estimate};
use kalfit_model::{CovarianceKind, Expression};
use kalfit_search::ProfileLikelihood;
use kalfit_search::ValueCovariances;
use kalfit_search::matrix_derivatives;
use kalfit_search::{DynamicFit, ParameterInference};

/// Maximal number of quantities with profile intervals.
const MOST_PROFILED: usize = 60;
/// Number of free values above which no quantity has a profile interval.
const MOST_VALUES: usize = 24;

/// Replaces Wald intervals of μ and Σ by profile intervals, and counts the remaining Wald intervals.
pub(crate) fn profiles(
    (objective, fit): (&ProfileLikelihood<'_>, &DynamicFit),
    estimate: &Estimate,
    covariances: &ValueCovariances,
    (inference, parameters): (&mut Inference, &[ParameterInference]),
    progress: &SharedProgress<'_>,
) {
    let all = quantities(&estimate.state.problem.covariance.elements, estimate.coefficients.len());
    let moved = moved_elements(objective, fit);
    let mut wanted = profiled(estimate, &free(estimate, &inference.unidentified));
    wanted.retain(|what| !matches!(what, Holdable::Covariance(i, j) if moved.contains(&(*i, *j))));
    // covariances last: the correlations of the states are more informative
    wanted.sort_by_key(|what| matches!(what, Holdable::Covariance(..)));
    let has_profile = |what: &Holdable| {
        estimate.criterion == Criterion::Ml || !matches!(what, Holdable::Mean(_) | Holdable::Coefficient(_))
    };
    let intervals = &mut inference.intervals;
    let requested =
        |what: &&Holdable| has_profile(what) && (wanted.contains(what) || intervals.ends.of(**what).is_some());
    let requested: Vec<Holdable> = all.iter().filter(requested).copied().collect();
    wanted.truncate(if fit.values.len() <= MOST_VALUES { MOST_PROFILED } else { 0 });
    intervals.kind = IntervalKind::Profile;
    let entries = entries(objective, parameters);
    entries.iter().for_each(|(what, parameter)| intervals.set(*what, parameter.interval));
    let is_done = |what: &Holdable| wanted.contains(what) || entries.iter().any(|(entry, _)| entry == what);
    intervals.unprofiled = requested.iter().filter(|what| !is_done(what)).count();
    let outer = HeldProfile::new((objective, fit), estimate, covariances);
    let start = WarmStart::best(fit, estimate);
    let quantiles = vec![QUANTILE; wanted.len()];
    intervals.compute_profiles((estimate, &inference.uncertainty), (&wanted, &quantiles), (&outer, &start), progress);
}

/// Off-diagonal elements of Σ that depend on parameters in matrices of the covariance structure.
fn moved_elements(objective: &ProfileLikelihood<'_>, fit: &DynamicFit) -> BTreeSet<(usize, usize)> {
    let derivatives = matrix_derivatives(objective.model, &fit.alpha, objective.slots, &fit.estimate.covariance);
    let elements = &fit.estimate.state.problem.covariance.elements;
    let moves = |&(i, j): &(usize, usize)| i != j && derivatives.values().any(|d| d[(i, j)] != 0.0);
    elements.all().filter(moves).collect()
}

/// Correlations that are parameters of the model, each with the parameter, whose interval is the interval of the
/// correlation.
fn entries<'p>(
    objective: &ProfileLikelihood<'_>,
    parameters: &'p [ParameterInference],
) -> Vec<(Holdable, &'p ParameterInference)> {
    let mut found = Vec::new();
    for (phase, range) in objective.model.phases.iter().zip(objective.model.ranges()) {
        let CovarianceKind::Correlation(entries) = &phase.model.covariance.kind else { continue };
        for (i, row) in entries.iter().enumerate() {
            for (j, entry) in row.iter().enumerate().take(i) {
                let Expression::Parameter(parameter) = entry else { continue };
                let Some(slot) = objective.slots.find(*parameter, &[]) else { continue };
                found.push((Holdable::Correlation(range.start + i, range.start + j), &parameters[slot]));
            }
        }
    }
    found
}
