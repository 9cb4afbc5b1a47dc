//! A step to the maximum of the quadratic model of ℓ in (mean, Σ), over the cone of positive semidefinite Σ.
//!
//! Newton's method in (mean, ψ), Σ = FF', has a quadratic model in ψ. Where a column of F goes to zero while the score
//! along it vanishes too, ℓ is of fourth order in that column, and each Newton step in ψ shrinks the column only by a
//! third. In Σ there is no such degeneracy: maximising the quadratic model in (mean, Σ) over Σ = FF' costs no pass, and
//! gives a step that reaches the boundary at once.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::climb::{ClimbLimits, climb};
use crate::covariance::{CoordinateForm, CovarianceMap};
use crate::local::{Local, Objective};
use crate::newton::NewtonIterate;
use crate::point::Point;
use kalfit_algebra::elements::Elements;

/// Maximum number of Newton steps on the model.
const MODEL_STEPS: usize = 25;
/// Columns of F (in η) below this are tried at zero.
const SMALL_COLUMN: f64 = 0.1;
/// A step may raise a variance v (in η) to at most this many times 1 + v.
const MAX_VARIANCE_RATIO: f64 = 4.0;
/// Rounding error of a value of ℓ, relative to its size.
const VALUE_ROUNDING: f64 = 1e-13;
/// Smallest fraction of the promised gain at which a step is accepted.
const MIN_GAIN_RATIO: f64 = 0.05;

/// The iterate at the maximum of the model, by one pass; `None` where ℓ gains too little of what the model promised.
pub(crate) fn step(
    objective: &dyn Objective,
    map: &CovarianceMap,
    tests: f64,
    iterate: &mut NewtonIterate,
) -> Option<NewtonIterate> {
    iterate.drop_information();
    let Some((point, promised)) = model_maximum(objective, map, tests, iterate) else {
        iterate.recompute_information(objective);
        return None;
    };
    let value_rounding = value_rounding(iterate);
    iterate.try_successor(objective, |iterate| {
        let next = NewtonIterate::new(objective, map, point, iterate.near())?;
        let gain = next.local.value - iterate.local.value;
        // where rounding hides the gain, the decrement decides
        let closer = gain >= -value_rounding && next.decrement() < 0.5 * iterate.decrement();
        (if promised > value_rounding { gain >= MIN_GAIN_RATIO * promised } else { closer }).then_some(next)
    })
}

/// Rounding error of a value of ℓ near an iterate.
fn value_rounding(iterate: &NewtonIterate) -> f64 {
    VALUE_ROUNDING * iterate.local.value.abs().max(1.0)
}

/// (maximum of the model, gain in ℓ that the model promises); `None` where the maximum is too far from the iterate.
fn model_maximum(
    objective: &dyn Objective,
    map: &CovarianceMap,
    tests: f64,
    iterate: &NewtonIterate,
) -> Option<(Point, f64)> {
    let model = LocalQuadratic::new(objective, iterate, &map.elements);
    let start = NewtonIterate::new(&model, map, iterate.point.clone(), None)?;
    let limits = ClimbLimits { tolerance: 1e-4 * iterate.decrement().min(1.0), steps: MODEL_STEPS };
    let (end, _) = climb(&model, map, tests, start, limits);
    let end = with_zero_columns(&model, map, (tests, value_rounding(iterate)), end, limits);
    let promised = end.local.value - iterate.local.value;
    (!promised.is_nan() && is_near(&end.point, &iterate.point)).then_some((end.point, promised))
}

/// The end of a climb with columns of F set to zero, the smallest first, while the model's value does not fall: a climb
/// approaches the boundary slowly.
fn with_zero_columns(
    model: &LocalQuadratic<'_>,
    map: &CovarianceMap,
    (tests, value_rounding): (f64, f64),
    mut end: NewtonIterate,
    limits: ClimbLimits,
) -> NewtonIterate {
    for _ in 0..end.point.root.ncols() {
        let root = without_least_column(map, &end.point.root).and_then(|root| map.on_constraints(&root));
        let Some(root) = root else { break };
        let next = end.try_successor(model, |end| {
            let next = NewtonIterate::new(model, map, Point { root, ..end.point.clone() }, None)?;
            (next.local.value >= end.local.value - value_rounding).then_some(next)
        });
        let Some(next) = next else { break };
        end = climb(model, map, tests, next, limits).0;
    }
    end
}

/// F with the smallest non-zero column set to zero; `None` where no such column is below `SMALL_COLUMN`.
fn without_least_column(map: &CovarianceMap, root: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let is_factor = |c: &usize| matches!(map.form_of(*c), CoordinateForm::Factor(_));
    let small = |c: &usize| (0.0..SMALL_COLUMN).contains(&root.column(*c).amax()) && root.column(*c).amax() > 0.0;
    let least = (0..root.ncols())
        .filter(is_factor)
        .filter(small)
        .min_by(|&a, &b| root.column(a).amax().total_cmp(&root.column(b).amax()))?;
    let mut root = root.clone();
    root.column_mut(least).fill(0.0);
    Some(root)
}

/// ℓ to second order about an iterate, as an objective.
struct LocalQuadratic<'a> {
    objective: &'a dyn Objective,
    iterate: &'a NewtonIterate,
    elements: &'a Elements,
    sigma: DMatrix<f64>,
    /// Gradient in mean coordinates, then elements of Σ.
    gradient: DVector<f64>,
}

impl<'a> LocalQuadratic<'a> {
    fn new(objective: &'a dyn Objective, iterate: &'a NewtonIterate, elements: &'a Elements) -> LocalQuadratic<'a> {
        let local = &iterate.local;
        let (m, s) = (local.mean_score.len(), local.information.nrows());
        let mut gradient = DVector::zeros(m + s);
        gradient.rows_mut(0, m).copy_from(&local.mean_score);
        gradient.rows_mut(m, s).copy_from(&elements.pack_score(&local.score));
        LocalQuadratic { objective, elements, sigma: iterate.point.covariance(), iterate, gradient }
    }

    /// The information in mean coordinates and elements of Σ, times a vector.
    fn gradient_change(&self, displacement: &DVector<f64>) -> DVector<f64> {
        let local = &self.iterate.local;
        let (m, s) = local.cross.shape();
        let (mean, sigma) = (displacement.rows(0, m), displacement.rows(m, s));
        let mut gradient_change = DVector::zeros(m + s);
        let mut of_mean = gradient_change.rows_mut(0, m);
        of_mean.gemv(1.0, &local.mean_information, &mean, 0.0);
        of_mean.gemv(1.0, &local.cross, &sigma, 1.0);
        let mut of_sigma = gradient_change.rows_mut(m, s);
        of_sigma.gemv(1.0, &local.cross.transpose(), &mean, 0.0);
        of_sigma.gemv(1.0, &*local.information, &sigma, 1.0);
        gradient_change
    }

    fn displacement(&self, point: &Point) -> DVector<f64> {
        let at = &self.iterate.point;
        let (p, m) = (at.mean.len(), self.iterate.local.mean_score.len());
        let moved = point.covariance() - &self.sigma;
        let mut displacement = DVector::zeros(m + self.elements.count());
        for i in 0..p {
            displacement[i] = point.mean[i] - at.mean[i];
        }
        self.elements.all().enumerate().for_each(|(k, at)| displacement[m + k] = moved[at]);
        for (c, (now, then)) in point.coefficients.iter().zip(&at.coefficients).enumerate() {
            displacement[p + c] = now - then;
        }
        displacement
    }
}

/// Whether every variance v of Σ at the old point is at most 4 (1 + v) at the new one: farther away, a model of second
/// order is unreliable.
fn is_near(point: &Point, reference: &Point) -> bool {
    let variance = |point: &Point, i: usize| point.root.row(i).norm_squared();
    (0..point.mean.len()).all(|i| variance(point, i) <= MAX_VARIANCE_RATIO * (1.0 + variance(reference, i)))
}

impl Objective for LocalQuadratic<'_> {
    fn local(&self, point: &Point, _: Option<&DMatrix<f64>>) -> Option<Local> {
        let (p, m) = (point.mean.len(), self.iterate.local.mean_score.len());
        let displacement = self.displacement(point);
        let gradient_change = self.gradient_change(&displacement);
        let gradient = &self.gradient - &gradient_change;
        let packed = |i: usize, j: usize| self.elements.get(i, j).map_or(0.0, |k| gradient[m + k]);
        let score = |i: usize, j: usize| packed(i, j) * if i == j { 1.0 } else { 0.5 };
        let local = &self.iterate.local;
        Some(Local {
            value: local.value + displacement.dot(&(&self.gradient - gradient_change * 0.5)),
            mean_score: gradient.rows(0, m).clone_owned(),
            mean_information: local.mean_information.clone(),
            score: DMatrix::from_fn(p, p, score),
            cross: local.cross.clone(),
            information: Arc::clone(&local.information),
            weight: local.weight.clone(),
            mean_covariance: None,
        })
    }

    fn mean_jacobian(&self) -> &DMatrix<f64> {
        self.objective.mean_jacobian()
    }

    fn move_mean(&self, point: &Point, step: &[f64]) -> Point {
        self.objective.move_mean(point, step)
    }
}
