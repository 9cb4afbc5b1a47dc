//! The objective of a finished search under reductions at another α, in the same coordinates: what mixed second derivatives
//! of α, μ and Σ are made of; and the law of ξ_j at a point, as posteriors want it.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::estimate::class::Class;
use crate::estimate::classes::Classes;
use crate::estimate::covariance::{CovarianceMap, Form};
use crate::estimate::newton::{self, Place};
use crate::estimate::order::Order;
use crate::estimate::point::Point;
use crate::estimate::problem::Problem;
use crate::estimate::sums::Sums;
use crate::estimate::{State, Structure};
use crate::linalg::symmetric;
use crate::model::{Alpha, StructureError};
use crate::reduce::{ReductionRef, Reductions};

/// The objective at one point under some reductions.
#[derive(Debug)]
pub(crate) struct Elsewhere {
    pub(crate) problem: Problem,
    pub(crate) point: Point,
    pub(crate) sums: Sums,
}

/// ξ_j ~ N(μ_j, FF') in the user's units; regression columns multiply their coefficients.
#[derive(Debug, Clone)]
pub(crate) struct InitialLaw {
    mean: DVector<f64>,
    /// (element, coefficient).
    regression: Vec<(usize, f64)>,
    pub(crate) root: DMatrix<f64>,
    /// Root of the covariance of (μ, coefficients) at a known Σ, under the restricted likelihood.
    mean_half: Option<DMatrix<f64>>,
}

impl InitialLaw {
    #[cfg(test)]
    pub(crate) fn known(mean: DVector<f64>, root: DMatrix<f64>) -> InitialLaw {
        InitialLaw { mean, regression: Vec::new(), root, mean_half: None }
    }

    fn of(problem: &Problem, point: &Point, mean_covariance: Option<&DMatrix<f64>>) -> InitialLaw {
        let frame = &problem.classes.frame;
        let p = frame.scale.len();
        let unit = |k: usize| if k < p { frame.scale[k] } else { problem.mean.coefficient_scale[k - p].recip() };
        let coefficients = point.coefficients.iter().zip(&problem.mean.coefficient_scale).map(|(c, s)| c / s);
        InitialLaw {
            mean: DVector::from_vec(frame.mean_out(&point.mean)),
            regression: problem.mean.regressors.iter().copied().zip(coefficients).collect(),
            root: DMatrix::from_fn(p, point.root.ncols(), |i, c| frame.scale[i] * point.root[(i, c)]),
            mean_half: mean_covariance.map(|covariance| {
                let half = problem.mean.jacobian() * symmetric::square_root(covariance);
                DMatrix::from_fn(half.nrows(), half.ncols(), |k, c| unit(k) * half[(k, c)])
            }),
        }
    }

    /// μ_j of a test with these covariates.
    pub(crate) fn mean_of(&self, covariates: &[f64]) -> DVector<f64> {
        let mut mean = self.mean.clone();
        for (&(element, coefficient), x) in self.regression.iter().zip(covariates) {
            mean[element] += coefficient * x;
        }
        mean
    }

    /// μ_j has a covariance of its own: the likelihood is the restricted one.
    pub(crate) fn is_restricted(&self) -> bool {
        self.mean_half.is_some()
    }

    /// Root of the covariance of μ_j at a known Σ, under the restricted likelihood.
    pub(crate) fn mean_root_of(&self, covariates: &[f64]) -> Option<DMatrix<f64>> {
        let half = self.mean_half.as_ref()?;
        let mut root = half.rows(0, self.mean.len()).into_owned();
        for (c, (&(element, _), x)) in self.regression.iter().zip(covariates).enumerate() {
            let row = root.row(element) + half.row(self.mean.len() + c) * *x;
            root.set_row(element, &row);
        }
        Some(root)
    }
}

impl State {
    /// The law of ξ_j where the search ended.
    pub(crate) fn law(&self) -> InitialLaw {
        InitialLaw::of(&self.problem, &self.place.point, self.place.near())
    }

    /// The same at a place of its own.
    pub(crate) fn law_at(&self, place: &Place) -> InitialLaw {
        InitialLaw::of(&self.problem, &place.point, place.near())
    }

    /// What is left of ∂ℓ/∂Σ at a place once constraints have taken their share, in the user's units.
    pub(crate) fn residual_score_at(&self, place: &Place) -> DMatrix<f64> {
        out(&self.problem, &place.tangent.residual_score)
    }

    /// ∂ℓ/∂Σ in the user's units: the objective changes by tr(G dΣ).
    pub(crate) fn covariance_score(&self) -> DMatrix<f64> {
        out(&self.problem, &self.sums.score())
    }

    /// The objective at this point under other reductions of the same tests; `None` where it is not defined.
    pub(crate) fn elsewhere(
        &self,
        reductions: &Reductions,
        alpha: &Alpha,
    ) -> Result<Option<Elsewhere>, StructureError> {
        let structure = self.assumed.at(alpha);
        let problem = Problem::within(&self.evidence(reductions), &structure, &self.problem)?;
        let root = carried(&self.problem.covariance, &problem.covariance, &self.place.point.root);
        let point = Point { root, ..self.place.point.clone() };
        let sums = problem.sums(&point, Order::First, self.place.near());
        Ok(sums.map(|sums| Elsewhere { problem, point, sums }))
    }

    /// The state after a step along the tangent basis of this place, under other reductions of the same tests; `None` where it
    /// is not defined.
    pub(crate) fn moved(&self, reductions: &Reductions, alpha: &Alpha, step: &DVector<f64>) -> Option<State> {
        self.at(reductions, alpha, newton::moved(&*self.problem, &self.problem.covariance, &self.place, step)?)
    }

    /// The state at another point of this problem, under other reductions of the same tests; `None` where it is not defined.
    pub(crate) fn at(&self, reductions: &Reductions, alpha: &Alpha, point: Point) -> Option<State> {
        let structure = self.assumed.at(alpha);
        let problem = Problem::within(&self.evidence(reductions), &structure, &self.problem).ok()?;
        let root = carried(&self.problem.covariance, &problem.covariance, &point.root);
        let point = Point { root, ..point };
        let place = Place::new(&problem, &problem.covariance, point, self.place.near())?;
        // the restricted likelihood's second derivatives want the covariance of the mean at the place itself
        let place = match place.near().cloned() {
            Some(own) => Place::new(&problem, &problem.covariance, place.point, Some(&own))?,
            None => place,
        };
        let sums = problem.sums(&place.point, Order::Expected, place.near())?;
        let assumed = (&structure).into();
        Some(State { problem: Arc::new(problem), place, sums, assumed, joint: None, ..self.clone() })
    }

    /// Gradient of one test's ℓ_j along the tangent basis of this place, under another reduction of it.
    pub(crate) fn gradient_of(&self, reduction: ReductionRef<'_>) -> DVector<f64> {
        let class = self.class_of(reduction);
        let sums = self.problem.of_class(&class, &self.place.point, Order::First);
        self.along(&sums, &self.problem, &self.place.point)
    }

    /// ∂ℓ_j/∂Σ of one test at this place, in the user's units.
    pub(crate) fn covariance_score_of(&self, reduction: ReductionRef<'_>) -> DMatrix<f64> {
        let class = self.class_of(reduction);
        out(&self.problem, &self.problem.of_class(&class, &self.place.point, Order::First).score())
    }

    /// One test as a class of its own.
    fn class_of(&self, reduction: ReductionRef<'_>) -> Class {
        let alone = std::iter::once(reduction).collect();
        self.problem.classes.single(&self.evidence(&alone), 0)
    }

    /// A gradient in mean coordinates and Σ along the tangent basis.
    fn along(&self, sums: &Sums, problem: &Problem, point: &Point) -> DVector<f64> {
        let tangent = &self.place.tangent;
        let chart = problem.covariance.chart(&point.root);
        let mut gradient = DVector::zeros(tangent.basis.nrows());
        gradient.rows_mut(0, tangent.mean).copy_from(&(problem.mean.jacobian().transpose() * &sums.mean_score));
        let of_sigma =
            chart.jacobian_at(&chart.root).transpose() * self.problem.covariance.elements.pack_score(&sums.score());
        gradient.rows_mut(tangent.mean, of_sigma.len()).copy_from(&of_sigma);
        tangent.basis.transpose() * gradient
    }
}

impl Elsewhere {
    /// The gradient along the tangent basis of the place it was taken from.
    pub(crate) fn gradient(&self, home: &State) -> DVector<f64> {
        home.along(&self.sums, &self.problem, &self.point)
    }

    /// The law of ξ_j at the point.
    pub(crate) fn law(&self) -> InitialLaw {
        InitialLaw::of(&self.problem, &self.point, self.sums.near())
    }

    /// Σ in the user's units.
    pub(crate) fn covariance(&self) -> DMatrix<f64> {
        self.problem.classes.frame.covariance_out(&self.point.covariance())
    }

    /// ∂ℓ/∂Σ in the user's units.
    pub(crate) fn covariance_score(&self) -> DMatrix<f64> {
        out(&self.problem, &self.sums.score())
    }
}

fn out(problem: &Problem, score: &DMatrix<f64>) -> DMatrix<f64> {
    let scale = &problem.classes.frame.scale;
    DMatrix::from_fn(score.nrows(), score.ncols(), |i, j| score[(i, j)] / (scale[i] * scale[j]))
}

/// The root with the same coordinates ψ where matrices of the structure follow α.
fn carried(from: &CovarianceMap, to: &CovarianceMap, root: &DMatrix<f64>) -> DMatrix<f64> {
    let parts = from.parts.iter().zip(&to.parts);
    to.assembled(parts.map(|(old, new)| carried_part(&old.form, &new.form, old.of(root))))
}

fn carried_part(from: &Form, to: &Form, root: DMatrix<f64>) -> DMatrix<f64> {
    match (from, to) {
        (Form::Scale(old), Form::Scale(new)) => {
            let star = old.norm_squared();
            new * if star > 0.0 { (root.norm_squared() / star).sqrt() } else { 0.0 }
        }
        (Form::StdDevs(old, _), Form::StdDevs(new, _)) => {
            let size = |i: usize| {
                let unit = old.row(i).norm();
                if unit > 0.0 { root.row(i).norm() / unit } else { 0.0 }
            };
            DMatrix::from_fn(new.nrows(), new.ncols(), |i, c| size(i) * new[(i, c)])
        }
        (_, Form::Fixed(known)) => symmetric::square_root(known),
        _ => root,
    }
}

impl Problem {
    /// The problem of other reductions of the same tests, in the coordinates η and with the criterion of another.
    pub(crate) fn within(
        reductions: &Reductions,
        structure: &Structure<'_>,
        like: &Problem,
    ) -> Result<Problem, StructureError> {
        Problem::of(Classes::within(reductions, &like.classes), structure, like.criterion())
    }
}
