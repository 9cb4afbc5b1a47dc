//! The sandwich where α is free: H⁻¹ (Σ_j s_j s_j') H⁻¹ with the scores s_j of the tests in α, μ and Σ together.
//!
//! A value of a single test has, at the maximum, a score of zero in this test and in every other test; so the value
//! adds nothing to the sum, and the variance of the value comes from the observed information.

use nalgebra::{DMatrix, DVector};

use kalfit_estimate::Sums;
use kalfit_search::ProfileLikelihood;
use kalfit_search::ValueCovariances;
use kalfit_search::matrix_gradient;
use kalfit_search::{DynamicError, DynamicFit};

/// The sandwich H⁻¹ (Σ_j s_j s_j') H⁻¹, with H⁻¹ from `observed`.
pub(crate) fn sandwich(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    observed: &ValueCovariances,
) -> Result<ValueCovariances, DynamicError> {
    let reduced = objective.reduce(&fit.sought)?;
    let scores = objective.scores(&fit.sought, &reduced, &fit.estimate.state.law())?;
    let n = observed.whole.nrows();
    let mut sum = DMatrix::zeros(n, n);
    let state = &fit.estimate.state;
    state.each_independent(&state.evidence(&reduced.reductions), &mut |tests, own| {
        let test_scores = tests.iter().flat_map(|&j| scores[j].iter().copied());
        let score = score(objective, fit, &observed.shared, (own, test_scores));
        sum.ger(1.0, &score, &score, 1.0);
    });
    let whole = &observed.whole * sum * &observed.whole;
    let mut alpha = observed.alpha.clone();
    for (place, &s) in observed.shared.iter().enumerate() {
        alpha[s] = alpha[s].map(|_| whole[(place, place)]).filter(|v| *v > 0.0);
    }
    Ok(ValueCovariances { alpha, whole, ..observed.clone() })
}

/// The score of a test, or of all tests of a unit, in the coordinates of the shared values, then along the tangent
/// basis.
fn score(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    shared: &[usize],
    (own, test_scores): (&Sums, impl Iterator<Item = (usize, f64)>),
) -> DVector<f64> {
    let state = &fit.estimate.state;
    let of_sigma = state.problem.score_in_user_units(&own.score());
    let matrix = matrix_gradient(objective.model, &fit.alpha, objective.slots, &fit.estimate.covariance, &of_sigma);
    let inner = state.gradient_along(own);
    let mut score = DVector::zeros(shared.len() + inner.len());
    for (slot, bar) in test_scores.chain(matrix) {
        if let Some(place) = shared.iter().position(|s| *s == slot) {
            score[place] += bar * objective.coordinates[slot].slope(fit.sought[slot]);
        }
    }
    score.rows_mut(shared.len(), inner.len()).copy_from(&inner);
    score
}
