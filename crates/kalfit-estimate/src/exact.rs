//! M-steps without a closed form: Newton's method of the search maximises -½n (log|Σ| + tr(Σ⁻¹M̄)) under
//! constraints.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::covariance::{CovarianceMap, place, submatrix};
use crate::local::{Local, Objective};
use crate::newton::{Attempt, Damping, NewtonIterate};
use crate::point::Point;
use kalfit_algebra::elements::Elements;

/// n tests whose ξ is known exactly, with second moment M̄ about the mean.
struct ExactTests<'a> {
    second: &'a DMatrix<f64>,
    n: f64,
    random: &'a [usize],
    elements: &'a Elements,
    jacobian: DMatrix<f64>,
}

impl Objective for ExactTests<'_> {
    fn local(&self, point: &Point, _: Option<&DMatrix<f64>>) -> Option<Local> {
        let p = self.second.nrows();
        let factor = submatrix(&point.covariance(), self.random).cholesky()?;
        let inverse = factor.inverse();
        let moment = submatrix(self.second, self.random);
        let log_det = 2.0 * factor.l().diagonal().map(f64::ln).sum();
        let value = -0.5 * self.n * (log_det + (&inverse * &moment).trace());
        let mut weight = DMatrix::zeros(p, p);
        place(&mut weight, self.random, &inverse);
        let mut outer = DMatrix::zeros(p, p);
        place(&mut outer, self.random, &(&inverse * moment * &inverse));
        let score = (&outer - &weight) * (0.5 * self.n);
        let inner = (outer - &weight * 0.5) * self.n;
        Some(Local {
            value,
            mean_score: DVector::zeros(0),
            mean_information: DMatrix::zeros(0, 0),
            score,
            cross: DMatrix::zeros(0, self.elements.count()),
            information: Arc::new(self.elements.over(|k, l, a, b| weight[(l, a)] * inner[(b, k)])),
            weight: weight * self.n,
            mean_covariance: None,
        })
    }

    fn mean_jacobian(&self) -> &DMatrix<f64> {
        &self.jacobian
    }

    fn move_mean(&self, point: &Point, _: &[f64]) -> Point {
        point.clone()
    }
}

/// A root of the constrained maximum, by Newton steps from `root`. Every step raises the objective, so an early stop is
/// still a GEM step.
pub(crate) fn maximise_exact(map: &CovarianceMap, second: &DMatrix<f64>, root: DMatrix<f64>, n: f64) -> DMatrix<f64> {
    let objective =
        ExactTests { second, n, random: &map.random, elements: &map.elements, jacobian: DMatrix::zeros(0, 0) };
    let point = Point { mean: vec![0.0; map.p], coefficients: Vec::new(), root: root.clone() };
    let Some(mut place) = NewtonIterate::new(&objective, map, point, None) else { return root };
    let mut damping = Damping::default();
    for _ in 0..50 {
        if place.decrement() < 1e-10 * n.sqrt() {
            break;
        }
        match damping.attempt(&objective, map, &mut place) {
            Attempt::Better(next) => place = *next,
            Attempt::Failed | Attempt::BelowRounding => break,
        }
    }
    place.point.root
}
