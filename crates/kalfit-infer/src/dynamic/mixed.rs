//! Change of the scores of all elements of (μ, Σ) with α, which the score test of a constraint needs where α is free.
//!
//! The information of (α, μ, Σ) is along the free directions of (μ, Σ). An element that a constraint holds is in no
//! free direction, so the mixed information of the element with α is computed separately, by differences of exact
//! scores at fixed (μ, Σ).

use nalgebra::{DMatrix, DVector};

use crate::holds_any;
use kalfit_estimate::Mixed;
use kalfit_search::DynamicFit;
use kalfit_search::ProfileLikelihood;
use kalfit_search::ValueCovariances;
use kalfit_search::two_sides;

/// Step of a difference: of a logarithm, or as a fraction of a standard error.
const STEP: f64 = 1e-4;
/// Largest step, as a fraction of a value's size.
const MAX_PART: f64 = 1e-2;
/// Largest number of values with mixed information; with more values, score tests treat α as known.
const MAX_VALUES: usize = 24;

/// Mixed information of the values that move at the end of a fit and the elements of (μ, Σ). `None` where no value
/// moves or no element is held, where more than [`MAX_VALUES`] values or values of single tests move, and where ℓ is
/// not defined close to the end.
pub(super) fn mixed(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    covariances: &ValueCovariances,
) -> Option<Mixed> {
    let shared = &covariances.shared;
    if shared.is_empty()
        || shared.len() > MAX_VALUES
        || !fit.joint.is_of_shared_values()
        || !holds_any(&fit.estimate.state)
    {
        return None;
    }
    let rows: Option<Vec<DVector<f64>>> = shared.iter().map(|&s| row(objective, fit, covariances, s)).collect();
    let rows = rows?;
    let width = rows.first().map_or(0, DVector::len);
    let (k, n) = (shared.len(), covariances.whole.nrows());
    let tangent_first: Vec<usize> = (k..n).chain(0..k).collect(); // the tangent basis first
    Some(Mixed {
        covariance: DMatrix::from_fn(n, n, |i, j| covariances.whole[(tangent_first[i], tangent_first[j])]),
        information: DMatrix::from_fn(k, width, |i, j| rows[i][j]),
    })
}

/// -∂²ℓ/∂α∂(every element) for one value, by a central difference, or by a one-sided difference at a bound.
fn row(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    covariances: &ValueCovariances,
    s: usize,
) -> Option<DVector<f64>> {
    let (coordinate, value) = (&objective.coordinates[s], fit.sought[s]);
    let error = covariances.alpha[s].map(f64::sqrt);
    let max_step = MAX_PART * value.abs().max(MAX_PART);
    let step = if coordinate.log { STEP } else { error.map_or(max_step, |error| (STEP * error).min(max_step)) };
    let at = |sign: f64| -> Option<(f64, DVector<f64>)> {
        let mut values = fit.sought.clone();
        values[s] = coordinate.moved(value, sign * step);
        let place = coordinate.of_value(values[s]);
        Some((place, scores(objective, fit, &values)?))
    };
    let [upper, lower] = two_sides(at(1.0), at(-1.0), || at(0.0))?;
    let width = upper.0 - lower.0;
    (width > 0.0).then(|| (lower.1 - upper.1) / width)
}

/// Scores of all elements at other values of α and the (μ, Σ) of the fit.
fn scores(objective: &ProfileLikelihood<'_>, fit: &DynamicFit, values: &[f64]) -> Option<DVector<f64>> {
    let reduced = objective.reduce(values).ok()?;
    let at = fit.estimate.state.at_other_alpha(&reduced.reductions, &objective.alpha(values)).ok()??;
    Some(at.scores())
}
