//! Newton's method in (μ, ψ) with the exact Hessian (theory §3).
//!
//! Eigenvalues of the Hessian enter by absolute value, steps have Levenberg damping, and every accepted step raises the
//! value. The search stops on the Newton decrement, never on a small change of the value.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::chart::Chart;
use crate::covariance::CovarianceMap;
use crate::curvature::Curvature;
use crate::local::{Local, Objective, Tangent};
use crate::point::Point;
use kalfit_algebra::folded::Folded;
use kalfit_algebra::symmetric;

/// A point with the value and the derivatives of the objective there.
#[derive(Debug, Clone)]
pub struct NewtonIterate {
    /// The point, in η.
    pub point: Point,
    /// Value and derivatives by the mean coordinates and the elements of Σ.
    pub local: Local,
    /// Derivatives in free coordinates, along the tangent space of the constraints.
    pub tangent: Tangent,
    pub(crate) curvature: Curvature,
}

impl NewtonIterate {
    /// The iterate at a point, from one evaluation of the objective (one pass); `None` as for [`NewtonIterate::at`].
    pub fn new(
        objective: &dyn Objective,
        map: &CovarianceMap,
        point: Point,
        near: Option<&DMatrix<f64>>,
    ) -> Option<NewtonIterate> {
        NewtonIterate::at(objective.local(&point, near)?, objective.mean_jacobian(), map, point)
    }

    /// The iterate from value and derivatives at a point; `None` where the value is not finite or the derivatives
    /// overflow.
    pub fn at(
        local: Local,
        mean_jacobian: &DMatrix<f64>,
        map: &CovarianceMap,
        mut point: Point,
    ) -> Option<NewtonIterate> {
        if !local.value.is_finite() {
            return None;
        }
        let tangent = Tangent::new(&local, mean_jacobian, map, &point.root);
        point.root = tangent.chart.root.clone();
        let curvature = Curvature::new(&tangent);
        let iterate = NewtonIterate { point, local, tangent, curvature };
        iterate.decrement().is_finite().then_some(iterate)
    }

    /// The covariance of the free mean coordinates, if known: evaluations at nearby points may reuse that matrix.
    pub fn near(&self) -> Option<&DMatrix<f64>> {
        self.local.mean_covariance.as_ref()
    }

    pub(crate) fn decrement(&self) -> f64 {
        self.curvature.decrement()
    }

    /// The successor of this iterate, if `make` returns one. While `make` runs, large matrices of this iterate need
    /// less memory: `local.information` is folded to half the size and `tangent.information` is dropped. Both are
    /// restored if `make` returns `None`; after a success this iterate must not be used any more.
    pub(crate) fn try_successor(
        &mut self,
        objective: &dyn Objective,
        make: impl FnOnce(&NewtonIterate) -> Option<NewtonIterate>,
    ) -> Option<NewtonIterate> {
        self.drop_information();
        let own = Arc::get_mut(&mut self.local.information).filter(|own| own.nrows() >= LARGE_ROWS);
        let folded = own.map(|own| Folded::of(std::mem::replace(own, DMatrix::zeros(0, 0))));
        let next = make(self);
        if next.is_none() {
            if let Some(folded) = folded {
                self.local.information = Arc::new(folded.unfolded());
            }
            self.recompute_information(objective);
        }
        next
    }

    /// Drops the information along the tangent basis if large; `recompute_information` restores the matrix.
    pub(crate) fn drop_information(&mut self) {
        if self.tangent.information.nrows() >= LARGE_ROWS {
            self.tangent.information = DMatrix::zeros(0, 0);
        }
    }

    /// Computes the information along the tangent basis again if it was dropped.
    pub(crate) fn recompute_information(&mut self, objective: &dyn Objective) {
        if self.tangent.information.is_empty() {
            self.tangent.set_information(&self.local, objective.mean_jacobian());
        }
    }
}

/// Number of rows from which on a matrix counts as large.
const LARGE_ROWS: usize = 500;

/// The outcome of an attempted step.
pub(crate) enum Attempt {
    /// A better iterate was found.
    Better(Box<NewtonIterate>),
    /// The step failed with every damping tried.
    Failed,
    /// The step promised less than the rounding errors of the value, and the value fell: the value cannot distinguish
    /// steps any more.
    BelowRounding,
}

/// Levenberg damping, carried over from step to step.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Damping(f64);

/// Maximum number of tries of one step, each with more damping, before the safeguard takes over.
const MAX_ATTEMPTS: usize = 6;

impl Damping {
    /// Steps from an iterate, with more damping until the value rises. After a better iterate is returned, the old one
    /// must not be used any more.
    pub(crate) fn attempt(
        &mut self,
        objective: &dyn Objective,
        map: &CovarianceMap,
        iterate: &mut NewtonIterate,
    ) -> Attempt {
        let slack = 1e-13 * iterate.local.value.abs().max(1.0);
        self.0 = self.0.max(iterate.curvature.nonconcave_damping());
        for _ in 0..MAX_ATTEMPTS {
            let (step, promised) = iterate.curvature.step(&iterate.tangent.information, self.0);
            let point = moved(objective, map, iterate, &step);
            let mut gain = None;
            let next = iterate.try_successor(objective, |iterate| {
                let next = NewtonIterate::new(objective, map, point?, iterate.near())?;
                let gain = *gain.insert(next.local.value - iterate.local.value);
                (gain >= -slack && (gain >= 0.05 * promised || promised <= slack)).then_some(next)
            });
            let gain = gain.unwrap_or(f64::NEG_INFINITY);
            if let Some(next) = next {
                self.adapt(gain / promised);
                return Attempt::Better(Box::new(next));
            }
            if gain > f64::NEG_INFINITY && promised <= slack {
                return Attempt::BelowRounding;
            }
            self.0 = iterate.curvature.damping_after_failure(&iterate.tangent.information, self.0, gain);
        }
        Attempt::Failed
    }
}

impl Damping {
    /// Adapts the damping to `ratio`, the gain of a step over the promised gain: divided by 10 above ¾, multiplied by 4
    /// below ¼, and zero below 10⁻⁶.
    fn adapt(&mut self, ratio: f64) {
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
    iterate: &NewtonIterate,
    step: &DVector<f64>,
) -> Option<Point> {
    let free_step = iterate.tangent.basis.times(step);
    let q = iterate.tangent.mean;
    let mut point = objective.move_mean(&iterate.point, &free_step.as_slice()[..q]);
    let step = free_step.rows(q, free_step.len() - q).clone_owned();
    point.root = retract(map, &iterate.tangent.chart, step)?;
    Some(point)
}

impl CovarianceMap {
    /// A root F near `root` with FF' on the constraints; `None` where Newton's method finds no such root.
    pub fn on_constraints(&self, root: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let chart = self.chart(root);
        let no_step = DVector::zeros(chart.coordinates.len());
        retract(self, &chart, no_step)
    }
}

/// F after a step ψ, with ψ corrected by Newton's method until Σ = FF' meets the constraints.
fn retract(map: &CovarianceMap, chart: &Chart, mut step: DVector<f64>) -> Option<DMatrix<f64>> {
    let mut root = chart.moved(step.as_slice());
    if map.constraints.is_empty() {
        return Some(root);
    }
    let normals = crate::local::normals(&map.constraints, &map.elements);
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

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;
    use crate::covariance::{CoordinateForm, PhaseForm};
    use kalfit_algebra::elements::Elements;

    /// An objective of one mean coordinate whose model is everywhere slope x - ½ x², with a record of its evaluations.
    struct LineStep<F> {
        slope: f64,
        value: F,
        jacobian: DMatrix<f64>,
        evaluated: RefCell<Vec<f64>>,
    }

    impl<F: Fn(f64) -> Option<f64>> Objective for LineStep<F> {
        fn local(&self, point: &Point, _: Option<&DMatrix<f64>>) -> Option<Local> {
            self.evaluated.borrow_mut().push(point.mean[0]);
            let zero = || DMatrix::zeros(1, 1);
            Some(Local {
                value: (self.value)(point.mean[0])?,
                mean_score: DVector::from_element(1, self.slope),
                mean_information: DMatrix::identity(1, 1),
                score: zero(),
                cross: zero(),
                information: Arc::new(zero()),
                weight: zero(),
                mean_covariance: None,
            })
        }

        fn mean_jacobian(&self) -> &DMatrix<f64> {
            &self.jacobian
        }

        fn move_mean(&self, point: &Point, step: &[f64]) -> Point {
            Point { mean: vec![point.mean[0] + step[0]], ..point.clone() }
        }
    }

    /// One attempt from zero with the given damping: its outcome, the damping afterwards, and the points of evaluation.
    fn attempt(slope: f64, damping: f64, value: impl Fn(f64) -> Option<f64>) -> (Attempt, f64, Vec<f64>) {
        let objective = LineStep { slope, value, jacobian: DMatrix::identity(1, 1), evaluated: RefCell::default() };
        let fixed =
            PhaseForm { states: 0..1, form: CoordinateForm::Fixed(DMatrix::zeros(1, 1)), linear: false, start: None };
        let map = CovarianceMap {
            p: 1,
            parts: vec![fixed],
            constraints: Vec::new(),
            random: Vec::new(),
            regressors: Vec::new(),
            elements: Elements::single(1),
        };
        let point = Point { mean: vec![0.0], coefficients: Vec::new(), root: DMatrix::zeros(1, 1) };
        let mut iterate = NewtonIterate::new(&objective, &map, point, None).expect("a finite place");
        objective.evaluated.borrow_mut().clear();
        let mut damping = Damping(damping);
        let end = damping.attempt(&objective, &map, &mut iterate);
        (end, damping.0, objective.evaluated.into_inner())
    }

    fn better(end: &Attempt) -> f64 {
        match end {
            Attempt::Better(iterate) => iterate.point.mean[0],
            Attempt::Failed => panic!("no step was good"),
            Attempt::BelowRounding => panic!("no step was promising"),
        }
    }

    #[test]
    fn a_step_must_give_a_twentieth_of_what_it_promised() {
        // the whole step promises ½
        let far = |part: f64| move |x: f64| Some(if x > 0.9 { 0.5 * part } else { 0.4 * x });
        for (part, accepted) in [(0.051, true), (0.049, false), (-0.2, false), (0.9, true)] {
            let (end, _, evaluated) = attempt(1.0, 0.0, far(part));
            assert!((evaluated[0] - 1.0).abs() < 1e-12, "{evaluated:?}: the whole step first");
            assert_eq!(evaluated.len() == 1, accepted, "{part}: {evaluated:?}");
            assert_eq!((better(&end) - 1.0).abs() < 1e-12, accepted, "{part}: {}", better(&end));
        }
    }

    #[test]
    fn steps_grow_shorter_until_one_is_good() {
        let (end, damping, evaluated) = attempt(1.0, 0.0, |x| Some(if x > 0.1 { -1.0 } else { x }));
        assert!(better(&end) > 0.02 && better(&end) <= 0.1, "{}", better(&end));
        assert!(evaluated.windows(2).all(|two| two[1] < 0.51 * two[0] && two[1] > 0.24 * two[0]), "{evaluated:?}");
        assert!(damping > 1.0, "{damping}: what helped is remembered");
        // where there is no value at all, each step is a quarter of the one before
        let (_, _, evaluated) = attempt(1.0, 0.0, |x| (x < 0.1).then_some(x));
        assert!(evaluated.windows(2).all(|two| (two[1] / two[0] - 0.25).abs() < 1e-3), "{evaluated:?}");
        // no step is good
        let (end, _, evaluated) = attempt(1.0, 0.0, |x| Some(-x.abs()));
        assert!(matches!(end, Attempt::Failed), "all fall");
        assert_eq!(evaluated.len(), MAX_ATTEMPTS, "{evaluated:?}");
    }

    #[test]
    fn what_promises_less_than_rounding_is_blind() {
        // the promise ½ slope² is compared with 1e-13; the second try is a quarter as long and promises less than half
        // as much
        for (slope, blind, tries) in [(4e-7, true, 1), (5e-7, true, 2), (1e-3, false, MAX_ATTEMPTS)] {
            let (end, _, evaluated) = attempt(slope, 0.0, |x| Some(-x.abs()));
            assert_eq!(
                (matches!(end, Attempt::BelowRounding), evaluated.len()),
                (blind, tries),
                "{slope}: {evaluated:?}"
            );
        }
        // a step whose value falls by less than 1e-13 is not refused
        let (end, ..) = attempt(4e-7, 0.0, |x| Some(if x == 0.0 { 0.0 } else { -0.9e-13 }));
        assert!((better(&end) - 4e-7).abs() < 1e-18, "{}", better(&end));
    }

    #[test]
    fn damping_follows_what_steps_give() {
        for (before, part, after) in [
            (0.5, 0.76, 0.05),
            (0.5, 0.74, 0.5),
            (0.5, 0.26, 0.5),
            (0.5, 0.24, 2.0),
            (9e-6, 1.0, 0.0),
            (2e-5, 1.0, 2e-6),
            (2.5e-7, 0.24, 1e-6),
        ] {
            // a damped step promises ½ slope² / (1 + damping)² (1 + 2 damping)
            let promised = 0.5 * (1.0 + 2.0 * before) / f64::powi(1.0 + before, 2);
            let (end, damping, _) = attempt(1.0, before, |x| Some(if x == 0.0 { 0.0 } else { part * promised }));
            assert!((better(&end) - 1.0 / (1.0 + before)).abs() < 1e-12, "{}", better(&end));
            assert!((damping - after).abs() < 1e-12, "{before} after {part}: {damping}, not {after}");
        }
    }
}
