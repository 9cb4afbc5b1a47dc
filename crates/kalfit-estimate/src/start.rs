//! Start values: from the model file where given, else from the data.

use nalgebra::{DMatrix, DVector};

use crate::covariance::{CovarianceMap, PhaseForm, submatrix};
use crate::point::Point;
use crate::problem::{Problem, scaled_solve};
use crate::{Classes, FitError, Structure, linear, pilot};
use kalfit_algebra::symmetric;
use kalfit_model::{Population, StructureError};

/// Smallest start variance of a state in η, where an average test has unit information on the state.
const MIN_START_VARIANCE: f64 = 0.05;

/// The point where the search begins.
pub(crate) fn start(problem: &Problem, structure: &Structure<'_>) -> Result<Point, FitError> {
    let map = &problem.covariance;
    let (mean, coefficients) = mean(problem, structure);
    let from_data = match map.parts.iter().all(|part| part.start.is_some()) {
        true => DMatrix::zeros(map.p, map.p),
        false => {
            // with very many tests a subset is enough
            let pilot = pilot::problem(problem, structure)?;
            let classes = pilot.as_ref().map_or(&problem.classes, |pilot| &pilot.classes);
            DMatrix::from_diagonal(&variances(classes, &mean))
        }
    };
    let of = |part: &PhaseForm| {
        let sigma = part.start.clone().unwrap_or_else(|| part.of(&from_data));
        part_root(&map.of_part(part), part.linear, &sigma)
    };
    let parts: Vec<DMatrix<f64>> = map.parts.iter().map(of).collect::<Result<_, FitError>>()?;
    Ok(Point { mean: mean.as_slice().to_vec(), coefficients, root: map.block_diagonal(parts) })
}

/// A root for one phase, with FF' near the given Σ.
fn part_root(map: &CovarianceMap, linear: bool, sigma: &DMatrix<f64>) -> Result<DMatrix<f64>, FitError> {
    if map.constraints.is_empty() {
        return Ok(map.root_of(&map.mask(sigma)));
    }
    if linear {
        let root = map.root_of(&linear::member(map, &map.mask(sigma)));
        return Ok(map.on_constraints(&root).ok_or(StructureError::NoMember)?);
    }
    feasible(map, sigma)
}

/// A root of the highest rank that the structure allows, without data.
pub fn generic_root(problem: &Problem) -> DMatrix<f64> {
    let map = &problem.covariance;
    let of = |part: &PhaseForm| {
        let own = map.of_part(part);
        let sigma = DMatrix::identity(own.p, own.p);
        if own.constraints.is_empty() {
            return own.root_of(&own.mask(&sigma));
        }
        feasible(&own, &sigma).unwrap_or_else(|_| own.root_of(&own.mask(&sigma)))
    };
    map.block_diagonal(map.parts.iter().map(of))
}

/// [`near`] treats Σ as singular when a scaled eigenvalue is below this.
const SINGULAR_EIGENVALUE: f64 = 1e-6;

/// The point of the structure near given values. A singular Σ is made regular: in its null space, ℓ would look flat to
/// a search that begins there.
pub(crate) fn near(problem: &Problem, values: &Population) -> Result<Point, FitError> {
    let (map, mean, frame) = (&problem.covariance, &problem.mean, &problem.classes.frame);
    let (wanted, coefficients) = mean.in_eta(frame, &values.mean, &values.coefficients);
    let b = mean.basis.transpose() * (DVector::from_vec(wanted) - &mean.offset);
    let sigma = map.mask(&frame.covariance_in(&values.covariance));
    let of = |part: &PhaseForm| {
        let (own, mut sigma) = (map.of_part(part), part.of(&sigma));
        if symmetric::scaled_range(&submatrix(&sigma, &own.random)).0 < SINGULAR_EIGENVALUE {
            own.random.iter().for_each(|&i| sigma[(i, i)] += MIN_START_VARIANCE.max(0.01 * sigma[(i, i)]));
        }
        if own.constraints.is_empty() { Ok(own.root_of(&sigma)) } else { feasible(&own, &sigma) }
    };
    let parts: Vec<DMatrix<f64>> = map.parts.iter().map(of).collect::<Result<_, FitError>>()?;
    let root = map.block_diagonal(parts);
    Ok(Point { mean: (&mean.offset + &mean.basis * b).as_slice().to_vec(), coefficients, root })
}

/// A pilot's end as a start for all tests; an end on the boundary is moved a little inside, where the best point of all
/// tests may be.
pub(crate) fn from_pilot(whole: &Problem, pilot: &Problem, end: &Point) -> Result<Point, FitError> {
    near(whole, &pilot.values_of(end))
}

/// The start of the mean: the model's start values where given, else pooled least squares on the structure.
fn mean(problem: &Problem, structure: &Structure<'_>) -> (DVector<f64>, Vec<f64>) {
    let (map, frame) = (&problem.mean, &problem.classes.frame);
    let start = structure.mean_start();
    let wanted: Vec<f64> = start.iter().zip(&frame.centre).map(|(given, pooled)| given.unwrap_or(*pooled)).collect();
    let wanted = DVector::from_vec(frame.mean_in(&wanted));
    let information = map.basis.transpose() * &problem.classes.information * &map.basis;
    let score = map.basis.transpose() * &problem.classes.information * (&wanted - &map.offset);
    let b = if start.iter().any(Option::is_some) {
        map.basis.transpose() * (&wanted - &map.offset)
    } else {
        scaled_solve(&information, &score)
    };
    (&map.offset + &map.basis * b, vec![0.0; map.regressors.len()])
}

/// A start variance of each state by moments, as if the states were uncorrelated: Σ_j (y - Jμ)_i² has the mean Σ_j (J +
/// JΣJ)_ii.
fn variances(classes: &Classes, mean: &DVector<f64>) -> DVector<f64> {
    let p = mean.len();
    let (excess, weight) = classes.excess(mean);
    if let Some(units) = &classes.units {
        let found: Vec<Option<f64>> = units.variances((&excess, &weight)).into_iter().flatten().collect();
        return DVector::from_fn(p, |k, _| found[k].map_or(1.0, |variance| variance.max(MIN_START_VARIANCE)));
    }
    DVector::from_fn(p, |i, _| if weight[i] > 0.0 { (excess[i] / weight[i]).max(MIN_START_VARIANCE) } else { 1.0 })
}

/// A root whose FF' meets the constraints, near Σ if possible.
fn feasible(map: &CovarianceMap, sigma: &DMatrix<f64>) -> Result<DMatrix<f64>, FitError> {
    let mut wanted = map.mask(sigma);
    let mut own = vec![true; map.p];
    for constraint in map.constraints.iter().filter(|c| c.terms.len() == 1) {
        let (i, j, _) = constraint.terms[0];
        wanted[(i, j)] = constraint.value;
        wanted[(j, i)] = constraint.value;
        own[i] &= i != j;
    }
    // The free variances grow until Σ is positive definite with the fixed covariances, and only while growth helps:
    // zero variances, and fixed elements that are singular among themselves, stay as they are.
    let least_eigenvalue = |sigma: &DMatrix<f64>| symmetric::scaled_range(&submatrix(sigma, &map.random)).0;
    for _ in 0..60 {
        let before = least_eigenvalue(&wanted);
        if before > 1e-3 {
            break;
        }
        let mut next = wanted.clone();
        (0..map.p).filter(|&i| own[i]).for_each(|i| next[(i, i)] *= 2.0);
        if least_eigenvalue(&next) <= before + 1e-9 {
            break;
        }
        wanted = next;
    }
    map.on_constraints(&map.root_of(&wanted)).ok_or(FitError::Structure(StructureError::Contradiction))
}
