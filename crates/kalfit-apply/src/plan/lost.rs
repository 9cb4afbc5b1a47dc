//! Information that suboptimal filters lose: ratios of expected standard errors with and without the filters.

use nalgebra::DMatrix;

use crate::plan::Quantity;
use crate::plan::{PlanError, plan};
use kalfit_estimate::{FinalState, Structure, at_population};
use kalfit_filter::reduce::Reductions;
use kalfit_model::Population;

/// Squared pivot of the Cholesky factor of the scaled information below which the information counts as singular.
const LEAST_PIVOT: f64 = 1e-10;

/// Information that the estimates of suboptimal filters lose, compared with the measurements, at a population.
#[derive(Debug, Clone, PartialEq)]
pub struct InformationLost {
    /// Ratios of standard errors, for each quantity that both estimates and measurements inform of.
    pub std_errors: Vec<StdErrorRatio>,
    /// log |I| of the estimates less log |I| of the measurements, with I the expected information on all free values;
    /// at most 0, and independent of units. `None` where the estimates or the measurements do not identify all free
    /// values.
    pub log_determinant: Option<f64>,
}

/// Ratio of the standard errors of a quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StdErrorRatio {
    /// The quantity.
    pub quantity: Quantity,
    /// Expected standard error from the estimates over that from the measurements, 1 or more.
    pub ratio: f64,
}

/// Information that the estimates of suboptimal filters lose, compared with the measurements. `raw` and `suboptimal`
/// are reductions of the same tests at one α; only information and covariates count.
///
/// # Errors
/// The errors of [`plan`].
pub fn information_lost(
    raw: &Reductions,
    suboptimal: &Reductions,
    structure: &Structure<'_>,
    population: &Population,
) -> Result<InformationLost, PlanError> {
    let plan_for = |reductions: &Reductions| plan(reductions, structure, population, &[reductions.len().max(1)]);
    let (best, own) = (plan_for(raw)?, plan_for(suboptimal)?);
    let ratio = |(best, own): (&crate::plan::Planned, &crate::plan::Planned)| {
        let (Ok(best_error), Ok(own_error)) = (&best.std_errors, &own.std_errors) else { return None };
        Some(StdErrorRatio { quantity: best.quantity, ratio: own_error[0] / best_error[0] })
    };
    let std_errors = best.quantities.iter().zip(&own.quantities).filter_map(ratio).collect();
    let volume =
        |reductions: &Reductions| at_population(reductions, structure, population).map(|state| log_determinant(&state));
    let log_determinant = volume(raw)?.zip(volume(suboptimal)?).map(|(best, own)| own - best);
    Ok(InformationLost { std_errors, log_determinant })
}

/// log |I| on the free directions, with respect to a basis of the directions that is orthonormal in the user's units.
fn log_determinant(state: &FinalState) -> Option<f64> {
    let directions = state.user_jacobian();
    Some(log_volume(&state.newton_iterate.tangent.information)? - log_volume(&(directions.transpose() * &directions))?)
}

/// log |A| of a positive definite matrix; `None` for any other matrix.
fn log_volume(a: &DMatrix<f64>) -> Option<f64> {
    let size: Vec<f64> = a.diagonal().iter().map(|x| x.sqrt()).collect();
    let scaled = DMatrix::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)] / size[i] / size[j]);
    let root = scaled.cholesky()?;
    let diagonal = root.l_dirty().diagonal();
    let is_informed = diagonal.iter().all(|l| l * l > LEAST_PIVOT);
    is_informed.then(|| 2.0 * diagonal.iter().zip(&size).map(|(l, s)| l.ln() + s.ln()).sum::<f64>())
}
