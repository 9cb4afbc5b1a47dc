//! Checks whether one structure lies within another.

use nalgebra::{DMatrix, DVector};

use kalfit_algebra::symmetric;
use kalfit_estimate::{Criterion, Estimate, Problem, Structure};

/// Largest relative difference that counts as rounding.
const RELATIVE_TOLERANCE: f64 = 1e-8;

/// Why a hypothesis cannot be tested within a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NotNested {
    /// Hypothesis and model have different states or data.
    #[error("the hypothesis and the model are not about the same states and tests")]
    Different,
    /// Some mean that the hypothesis allows is not allowed by the model.
    #[error("the hypothesis allows means that the model does not")]
    Mean,
    /// Some covariance that the hypothesis allows is not allowed by the model.
    #[error("the hypothesis allows covariances that the model does not")]
    Covariance,
    /// The restricted likelihoods have different means integrated out.
    #[error("restricted likelihoods of different means cannot be compared")]
    Restricted,
    /// Each phase was fitted separately.
    #[error("no likelihood was maximised: `marginal` fits each phase separately")]
    Marginal,
    /// The hypothesis restricts nothing.
    #[error("the hypothesis restricts nothing that the model leaves free")]
    Same,
}

/// Rejects a hypothesis that is not within the model.
pub(super) fn check(null: &Estimate, alternative: &Estimate) -> Result<(), NotNested> {
    if null.state.is_marginal() || alternative.state.is_marginal() {
        return Err(NotNested::Marginal);
    }
    let (inner, outer) = (&*null.state.problem, &*alternative.state.problem);
    let (a, b) = (&inner.classes.frame, &outer.classes.frame);
    // the order of the tests depends on their covariates, so a hypothesis with fewer covariates may differ by rounding
    let same = |x: &[f64], y: &[f64]| {
        x.len() == y.len() && x.iter().zip(y).all(|(x, y)| (x - y).abs() <= 1e-9 * x.abs().max(y.abs()))
    };
    if !same(&a.centre, &b.centre) || !same(&a.scale, &b.scale) || inner.classes.tests != outer.classes.tests {
        return Err(NotNested::Different);
    }
    regressions(&null.state.structure(), &alternative.state.structure()).ok_or(NotNested::Mean)?;
    mean(inner, outer)?;
    let same_mean = inner.mean.basis.ncols() == outer.mean.basis.ncols()
        && inner.mean.regressors.len() == outer.mean.regressors.len();
    if alternative.criterion != null.criterion || (null.criterion == Criterion::Reml && !same_mean) {
        return Err(NotNested::Restricted);
    }
    covariance(null, inner, outer)?;
    let free = |e: &Estimate| e.state.problem.mean.jacobian().ncols() + e.declared_covariance();
    if free(null) >= free(alternative) { Err(NotNested::Same) } else { Ok(()) }
}

/// Index of each regression of `inner` among the regressions of `outer`; `None` when `outer` lacks a regression of
/// `inner`.
pub(crate) fn regressions(inner: &Structure<'_>, outer: &Structure<'_>) -> Option<Vec<usize>> {
    let outer = outer.regressions();
    inner.regressions().iter().map(|r| outer.iter().position(|o| o == r)).collect()
}

/// Checks that `outer` allows every mean m0 + Bβ of `inner`.
fn mean(inner: &Problem, outer: &Problem) -> Result<(), NotNested> {
    let q = &outer.mean.basis;
    let outside = |v: &DVector<f64>| (v - q * (q.transpose() * v)).amax();
    let offset = &inner.mean.offset - &outer.mean.offset;
    let size = 1.0 + offset.amax();
    let columns = inner.mean.basis.column_iter().map(|c| outside(&c.into_owned()));
    let worst = columns.fold(outside(&offset) / size, f64::max);
    if worst > RELATIVE_TOLERANCE { Err(NotNested::Mean) } else { Ok(()) }
}

/// Checks that `outer` allows the estimated Σ of `inner`, and every Σ of `inner` near the estimate.
fn covariance(null: &Estimate, inner: &Problem, outer: &Problem) -> Result<(), NotNested> {
    let root = &null.state.newton_iterate.point.root;
    let sigma = root * root.transpose();
    let (map, size) = (&outer.covariance, symmetric::sizes(&sigma));
    let masked = map.mask(&sigma);
    let copy = map.root_of(&masked);
    let off = &copy * copy.transpose() - &sigma;
    let relative = DMatrix::from_fn(off.nrows(), off.ncols(), |i, j| off[(i, j)] / size[i] / size[j]);
    let residual = map.residual(&sigma);
    if relative.amax() > RELATIVE_TOLERANCE || map.relative_residual(&sigma, &residual) > RELATIVE_TOLERANCE {
        return Err(NotNested::Covariance);
    }
    let inner_directions = inner.covariance.free_directions(&inner.covariance.chart(root)).dense();
    let outer_directions = map.free_directions(&map.chart(&copy)).dense();
    let scaled = |m: DMatrix<f64>| {
        let units: Vec<f64> = map.elements.all().map(|(i, j)| size[i] * size[j]).collect();
        DMatrix::from_fn(m.nrows(), m.ncols(), |k, c| m[(k, c)] / units[k])
    };
    let (inner_directions, outer_directions) = (scaled(inner_directions), scaled(outer_directions));
    let outside = &inner_directions
        - &outer_directions
            * symmetric::pseudo_inverse(&(outer_directions.transpose() * &outer_directions))
            * outer_directions.transpose()
            * &inner_directions;
    let worst = (0..inner_directions.ncols())
        .map(|c| outside.column(c).norm() / inner_directions.column(c).norm().max(f64::MIN_POSITIVE));
    if worst.fold(0.0, f64::max) > 1e-6 { Err(NotNested::Covariance) } else { Ok(()) }
}
