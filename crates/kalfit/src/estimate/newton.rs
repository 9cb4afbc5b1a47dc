//! Newton's method in (μ, ψ) with the exact Hessian (theory §3).
//!
//! Eigenvalues of the Hessian by absolute value, Levenberg damping, every accepted step raises the value. It stops on
//! the Newton decrement, never on a small change of the value.

use nalgebra::{DMatrix, DVector};

use crate::estimate::chart::Chart;
use crate::estimate::covariance::CovarianceMap;
use crate::estimate::curvature::Curvature;
use crate::estimate::local::{Local, Objective, Tangent};
use crate::estimate::point::Point;
use crate::linalg::folded::Folded;
use crate::linalg::symmetric;

/// A point with all that is known there.
#[derive(Debug, Clone)]
pub(crate) struct Place {
    pub(crate) point: Point,
    pub(crate) local: Local,
    pub(crate) tangent: Tangent,
    pub(crate) curvature: Curvature,
}

impl Place {
    /// Evaluates the objective: one pass.
    pub(crate) fn new(
        objective: &dyn Objective,
        map: &CovarianceMap,
        point: Point,
        near: Option<&DMatrix<f64>>,
    ) -> Option<Place> {
        Place::at(objective.local(&point, near)?, objective.mean_jacobian(), map, point)
    }

    /// The place where this is known; `None` where it is not finite, or so far out that its derivatives overflow.
    pub(crate) fn at(
        local: Local,
        mean_jacobian: &DMatrix<f64>,
        map: &CovarianceMap,
        mut point: Point,
    ) -> Option<Place> {
        if !local.value.is_finite() {
            return None;
        }
        let tangent = Tangent::new(&local, mean_jacobian, map, &point.root);
        point.root = tangent.chart.root.clone();
        let curvature = Curvature::new(&tangent);
        let place = Place { point, local, tangent, curvature };
        place.decrement().is_finite().then_some(place)
    }

    /// What places near by may take from this one.
    pub(crate) fn near(&self) -> Option<&DMatrix<f64>> {
        self.local.mean_covariance.as_ref()
    }

    pub(crate) fn decrement(&self) -> f64 {
        self.curvature.decrement()
    }

    /// Puts the large matrices aside, while another place is made.
    fn fold(&mut self) -> [Option<Folded>; 3] {
        self.large().map(Folded::of)
    }

    fn unfold(&mut self, folded: [Option<Folded>; 3]) {
        for (matrix, folded) in self.large().into_iter().zip(folded) {
            if let Some(folded) = folded {
                *matrix = folded.unfolded();
            }
        }
    }

    fn large(&mut self) -> [&mut DMatrix<f64>; 3] {
        [&mut self.local.information, &mut self.tangent.information, self.curvature.matrix_mut()]
    }
}

/// What became of one attempt to step.
pub(crate) enum Attempt {
    /// A better place.
    Better(Box<Place>),
    /// No damping helped.
    Failed,
    /// The step promised less than the rounding errors of the value, and the value fell: it cannot tell any step from another.
    Blind,
}

/// Damping that is remembered from step to step.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Damping(f64);

/// How often one step is tried with more damping before the safeguard takes over.
const TRIES: usize = 6;

impl Damping {
    /// Steps from `place`, with more damping until the value rises. Of the place nothing may be asked after a better one is found.
    pub(crate) fn attempt(&mut self, objective: &dyn Objective, map: &CovarianceMap, place: &mut Place) -> Attempt {
        let slack = 1e-13 * place.local.value.abs().max(1.0);
        self.0 = self.0.max(place.curvature.doubtful());
        for _ in 0..TRIES {
            let (step, promised) = place.curvature.step(self.0);
            let point = moved(objective, map, place, &step);
            let folded = place.fold();
            let next = point.and_then(|point| Place::new(objective, map, point, place.near()));
            let gain = next.as_ref().map(|next| next.local.value - place.local.value);
            let good = |gain: f64| gain >= -slack && (gain >= 0.05 * promised || promised <= slack);
            if let (Some(next), Some(gain)) = (next, gain.filter(|gain| good(*gain))) {
                self.judge(gain / promised);
                return Attempt::Better(Box::new(next));
            }
            place.unfold(folded);
            if gain.is_some() && promised <= slack {
                return Attempt::Blind;
            }
            self.0 = place.curvature.shorter(self.0, gain.unwrap_or(f64::NEG_INFINITY));
        }
        Attempt::Failed
    }
}

impl Damping {
    /// Less damping after a step that gave what it promised, more after one that did not.
    fn judge(&mut self, ratio: f64) {
        if ratio > 0.75 {
            self.0 *= 0.1;
        } else if ratio < 0.25 {
            self.0 *= 4.0;
        }
        if self.0 < 1e-6 {
            self.0 = 0.0;
        }
    }
}

/// The point after a step along the tangent basis, brought back onto the constraints.
pub(crate) fn moved(
    objective: &dyn Objective,
    map: &CovarianceMap,
    place: &Place,
    step: &DVector<f64>,
) -> Option<Point> {
    let free = place.tangent.basis.times(step);
    let q = place.tangent.mean;
    let mut point = objective.move_mean(&place.point, &free.as_slice()[..q]);
    let step = free.rows(q, free.len() - q).clone_owned();
    point.root = retract(map, &place.tangent.chart, step)?;
    Some(point)
}

/// F after a step ψ, with ψ corrected by Newton's method until Σ = FF' meets the constraints.
pub(crate) fn retract(map: &CovarianceMap, chart: &Chart, mut step: DVector<f64>) -> Option<DMatrix<f64>> {
    let mut root = chart.moved(step.as_slice());
    if map.constraints.is_empty() {
        return Some(root);
    }
    let normals = crate::estimate::local::normals(&map.constraints, &map.elements);
    let mut previous = f64::INFINITY;
    for _ in 0..60 {
        let sigma = &root * root.transpose();
        let residual = map.residual(&sigma);
        let size = map.relative_residual(&sigma, &residual);
        if size <= 1e-15 || (size <= 1e-12 && size >= 0.5 * previous) {
            return Some(root);
        }
        previous = size;
        let slope = chart.jacobian_at(&root).after(&normals);
        step -= slope.transpose() * symmetric::pseudo_solve(&(&slope * slope.transpose()), &residual);
        root = chart.moved(step.as_slice());
    }
    (previous <= 1e-10).then_some(root)
}
