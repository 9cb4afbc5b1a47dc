//! A step on the quadratic model of ℓ in (mean, Σ) itself, over the cone that Σ must stay in.
//!
//! Newton's method in (mean, ψ), Σ = FF', has a quadratic model in ψ. Where a column of F goes to zero while the score
//! along it vanishes too, ℓ is of fourth order in that column, and each such step only shrinks it by a third. In Σ
//! there is no such degeneracy: maximising the quadratic model in (mean, Σ) over Σ = FF' costs no pass, and gives a
//! step that reaches the boundary at once.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::climb::{ClimbLimits, climb};
use crate::covariance::{CoordinateForm, CovarianceMap};
use crate::local::{Local, Objective};
use crate::newton::NewtonIterate;
use crate::point::Point;
use kalfit_algebra::elements::Elements;

/// Maximum number of Newton steps on the model.
const STEPS: usize = 25;
/// Columns of F (in η) below this are tried at zero.
const SMALL: f64 = 0.1;
/// A step may raise a variance v (in η) to at most this many times 1 + v.
const REACH: f64 = 4.0;
/// Rounding error of a value of ℓ, relative to its size.
const NOISE: f64 = 1e-13;
/// Smallest fraction of the promised gain at which a step is accepted.
const ENOUGH: f64 = 0.05;

/// The iterate at the model's maximum, for one pass; `None` where it gains too little of what the model promised.
pub(crate) fn step(
    objective: &dyn Objective,
    map: &CovarianceMap,
    tests: f64,
    place: &mut NewtonIterate,
) -> Option<NewtonIterate> {
    place.slim();
    let Some((point, promised)) = aim(objective, map, tests, place) else {
        place.restore(objective);
        return None;
    };
    let noise = noise(place);
    place.surpassed(objective, |place| {
        let next = NewtonIterate::new(objective, map, point, place.near())?;
        let gain = next.local.value - place.local.value;
        // where rounding hides the gain, the decrement decides
        let closer = gain >= -noise && next.decrement() < 0.5 * place.decrement();
        (if promised > noise { gain >= ENOUGH * promised } else { closer }).then_some(next)
    })
}

/// Rounding error of a value of ℓ near an iterate.
fn noise(place: &NewtonIterate) -> f64 {
    NOISE * place.local.value.abs().max(1.0)
}

/// The model's maximum, and the gain that it promises; `None` where the maximum is too far off.
fn aim(objective: &dyn Objective, map: &CovarianceMap, tests: f64, place: &NewtonIterate) -> Option<(Point, f64)> {
    let model = LocalQuadratic::new(objective, place, &map.elements);
    let start = NewtonIterate::new(&model, map, place.point.clone(), None)?;
    let limits = ClimbLimits { tolerance: 1e-4 * place.decrement().min(1.0), steps: STEPS };
    let (end, _) = climb(&model, map, tests, start, limits);
    let end = flattened(&model, map, (tests, noise(place)), end, limits);
    let promised = end.local.value - place.local.value;
    (!promised.is_nan() && is_near(&end.point, &place.point)).then_some((end.point, promised))
}

/// The end of a climb with columns of F set to zero, the smallest first, while the model's value does not fall: a climb
/// approaches the boundary slowly.
fn flattened(
    model: &LocalQuadratic<'_>,
    map: &CovarianceMap,
    (tests, noise): (f64, f64),
    mut end: NewtonIterate,
    limits: ClimbLimits,
) -> NewtonIterate {
    for _ in 0..end.point.root.ncols() {
        let root = without_least_column(map, &end.point.root).and_then(|root| map.onto(&root));
        let Some(root) = root else { break };
        let next = end.surpassed(model, |end| {
            let next = NewtonIterate::new(model, map, Point { root, ..end.point.clone() }, None)?;
            (next.local.value >= end.local.value - noise).then_some(next)
        });
        let Some(next) = next else { break };
        end = climb(model, map, tests, next, limits).0;
    }
    end
}

/// F with its smallest column set to zero, of those that are small but not zero.
fn without_least_column(map: &CovarianceMap, root: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let is_factor = |c: &usize| matches!(map.form_of(*c), CoordinateForm::Factor(_));
    let small = |c: &usize| (0.0..SMALL).contains(&root.column(*c).amax()) && root.column(*c).amax() > 0.0;
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
    place: &'a NewtonIterate,
    elements: &'a Elements,
    sigma: DMatrix<f64>,
    /// Gradient in mean coordinates, then elements of Σ.
    gradient: DVector<f64>,
}

impl<'a> LocalQuadratic<'a> {
    fn new(objective: &'a dyn Objective, place: &'a NewtonIterate, elements: &'a Elements) -> LocalQuadratic<'a> {
        let local = &place.local;
        let (m, s) = (local.mean_score.len(), local.information.nrows());
        let mut gradient = DVector::zeros(m + s);
        gradient.rows_mut(0, m).copy_from(&local.mean_score);
        gradient.rows_mut(m, s).copy_from(&elements.pack_score(&local.score));
        LocalQuadratic { objective, elements, sigma: place.point.covariance(), place, gradient }
    }

    /// The information in mean coordinates and elements of Σ, times a vector.
    fn pull(&self, away: &DVector<f64>) -> DVector<f64> {
        let local = &self.place.local;
        let (m, s) = local.cross.shape();
        let (mean, sigma) = (away.rows(0, m), away.rows(m, s));
        let mut pull = DVector::zeros(m + s);
        let mut of_mean = pull.rows_mut(0, m);
        of_mean.gemv(1.0, &local.mean_information, &mean, 0.0);
        of_mean.gemv(1.0, &local.cross, &sigma, 1.0);
        let mut of_sigma = pull.rows_mut(m, s);
        of_sigma.gemv(1.0, &local.cross.transpose(), &mean, 0.0);
        of_sigma.gemv(1.0, &*local.information, &sigma, 1.0);
        pull
    }

    fn away(&self, point: &Point) -> DVector<f64> {
        let at = &self.place.point;
        let (p, m) = (at.mean.len(), self.place.local.mean_score.len());
        let moved = point.covariance() - &self.sigma;
        let mut away = DVector::zeros(m + self.elements.count());
        for i in 0..p {
            away[i] = point.mean[i] - at.mean[i];
        }
        self.elements.all().enumerate().for_each(|(k, at)| away[m + k] = moved[at]);
        for (c, (now, then)) in point.coefficients.iter().zip(&at.coefficients).enumerate() {
            away[p + c] = now - then;
        }
        away
    }
}

/// Whether the variances in Σ have not grown too much: beyond that a model of second order is unreliable.
fn is_near(point: &Point, from: &Point) -> bool {
    let spread = |point: &Point, i: usize| point.root.row(i).norm_squared();
    (0..point.mean.len()).all(|i| spread(point, i) <= REACH * (1.0 + spread(from, i)))
}

impl Objective for LocalQuadratic<'_> {
    fn local(&self, point: &Point, _: Option<&DMatrix<f64>>) -> Option<Local> {
        let (p, m) = (point.mean.len(), self.place.local.mean_score.len());
        let away = self.away(point);
        let pull = self.pull(&away);
        let gradient = &self.gradient - &pull;
        let packed = |i: usize, j: usize| self.elements.get(i, j).map_or(0.0, |k| gradient[m + k]);
        let score = |i: usize, j: usize| packed(i, j) * if i == j { 1.0 } else { 0.5 };
        let local = &self.place.local;
        Some(Local {
            value: local.value + away.dot(&(&self.gradient - pull * 0.5)),
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
