//! The objective of a finished search under reductions at another α, in the coordinates of that search, for mixed
//! second derivatives by α, μ and Σ; and the distribution of ξ_j at a point, for posteriors.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::class::Class;
use crate::classes::Classes;
use crate::covariance::{CoordinateForm, CovarianceMap};
use crate::initial_law;
use crate::levels;
use crate::local::Objective;
use crate::newton;
use crate::newton::NewtonIterate;
use crate::order::Order;
use crate::order::SumsWanted;
use crate::point::Point;
use crate::problem::Problem;
use crate::structure::OwnedStructure;
use crate::sums::Sums;
use crate::{Criterion, FinalState, Structure};
use kalfit_algebra::symmetric;
use kalfit_filter::reduce::{ReductionRef, Reductions};
use kalfit_filter::score::InitialLaw;
use kalfit_model::remote::Question;
use kalfit_model::{Alpha, StructureError};

/// The objective, evaluated at one point under given reductions.
#[derive(Debug)]
pub struct Reevaluation {
    pub(crate) problem: Problem,
    pub(crate) point: Point,
    pub(crate) sums: Sums,
}

/// The point that a search over remote tests is about to reach.
pub struct UpcomingPoint {
    problem: Problem,
    point: Point,
    assumed: OwnedStructure,
}

impl FinalState {
    /// The distribution of ξ_j where the search ended.
    pub fn law(&self) -> InitialLaw {
        initial_law::law_with(&self.problem, &self.newton_iterate.point, self.newton_iterate.near())
    }

    /// The distribution of ξ_j at another iterate.
    pub fn law_at(&self, place: &NewtonIterate) -> InitialLaw {
        initial_law::law_with(&self.problem, &place.point, place.near())
    }

    /// ∂ℓ/∂Σ in the user's units: the objective changes by tr(G dΣ).
    pub fn covariance_score(&self) -> DMatrix<f64> {
        self.problem.score_in_user_units(&self.sums.score())
    }

    /// The objective at the point of this state under other reductions of the tests; `None` where the objective is not
    /// defined.
    pub fn at_other_alpha(
        &self,
        reductions: &Reductions,
        alpha: &Alpha,
    ) -> Result<Option<Reevaluation>, StructureError> {
        let origin = (&*self.problem, &self.newton_iterate.point, self.newton_iterate.near());
        Reevaluation::of(origin, &self.evidence(reductions), &self.assumed.at(alpha))
    }

    /// The point after a step along the tangent basis of this state, under other reductions of the tests: sums of
    /// remote tests at that point can be requested in advance.
    pub fn upcoming_point(&self, reductions: &Reductions, alpha: &Alpha, step: &DVector<f64>) -> Option<UpcomingPoint> {
        let point = newton::moved(&*self.problem, &self.problem.covariance, &self.newton_iterate, step)?;
        let (problem, point) = self.converted_to(reductions, &self.assumed.at(alpha), point).ok()?;
        let point = in_chart(&problem, &point);
        Some(UpcomingPoint { problem, point, assumed: self.assumed.clone() })
    }

    /// (problem of other reductions of the tests, a point of this problem converted to that problem).
    fn converted_to(
        &self,
        reductions: &Reductions,
        structure: &Structure<'_>,
        point: Point,
    ) -> Result<(Problem, Point), StructureError> {
        let problem = Problem::within(&self.evidence(reductions), structure, &self.problem)?;
        let root = converted_root(&self.problem.covariance, &problem.covariance, &point.root);
        Ok((problem, Point { root, ..point }))
    }

    /// The state after a step along the tangent basis of this state, under other reductions of the tests; `None` where
    /// the objective is not defined.
    pub fn moved(&self, reductions: &Reductions, alpha: &Alpha, step: &DVector<f64>) -> Option<FinalState> {
        self.at(reductions, alpha, newton::moved(&*self.problem, &self.problem.covariance, &self.newton_iterate, step)?)
    }

    /// The state at another point of this problem, under other reductions of the tests; `None` where the objective is
    /// not defined.
    pub fn at(&self, reductions: &Reductions, alpha: &Alpha, point: Point) -> Option<FinalState> {
        let structure = self.assumed.at(alpha);
        let (problem, point) = self.converted_to(reductions, &structure, point).ok()?;
        let in_chart = in_chart(&problem, &point);
        problem.set_near_end(true); // no further point is evaluated
        let place = problem.with_score(&in_chart, || {
            NewtonIterate::new(&problem, &problem.covariance, point, self.newton_iterate.near())
        })?;
        // the restricted likelihood's second derivatives need the covariance of the mean at the point itself
        let place = match place.near().cloned() {
            Some(own) => NewtonIterate::new(&problem, &problem.covariance, place.point, Some(&own))?,
            None => place,
        };
        problem.set_near_end(false);
        let sums = match problem.criterion() {
            Criterion::Ml => problem.at_end(&place)?,
            Criterion::Reml => problem.sums(&place.point, Order::Expected, place.near())?,
        };
        let assumed = (&structure).into();
        let settings = self.settings.clone();
        Some(FinalState { problem: Arc::new(problem), newton_iterate: place, sums, assumed, settings, joint: None })
    }

    /// Gradient of ℓ_j of one test along the tangent basis of this state, under another reduction of the test.
    pub fn gradient_of(&self, reduction: ReductionRef<'_>) -> DVector<f64> {
        let class = self.class_of(reduction);
        let sums = self.problem.of_class(&class, &self.newton_iterate.point, Order::First);
        self.along(&sums, &self.problem, &self.newton_iterate.point)
    }

    /// Calls `of` for each unit, or for each test where there are no groups: with the indices in `evidence` of the
    /// tests of that part, and the sums of first order over these tests at this state. The order of the calls depends
    /// on the ids alone.
    pub fn each_independent(&self, evidence: &Reductions, of: &mut dyn FnMut(&[usize], &Sums)) {
        let classes = self.problem.classes.of(evidence);
        let (point, regressors) = (&self.newton_iterate.point, &self.problem.mean.regressors[..]);
        if let Some(units) = &classes.units {
            let elements = &classes.elements;
            let wanted = SumsWanted { elements, regressors, order: Order::First, flat: None };
            return levels::each_unit(units, point, wanted, of);
        }
        let mut order: Vec<usize> = (0..evidence.len()).collect();
        order.sort_by(|&a, &b| evidence.id(a).cmp(evidence.id(b)));
        for j in order {
            of(&[j], &self.problem.of_class(&classes.single(evidence, j), point, Order::First));
        }
    }

    /// The gradient along the tangent basis of this state, from sums at this state.
    pub fn gradient_along(&self, sums: &Sums) -> DVector<f64> {
        self.along(sums, &self.problem, &self.newton_iterate.point)
    }

    /// The class that holds one test alone, in the coordinates of this problem.
    fn class_of(&self, reduction: ReductionRef<'_>) -> Class {
        let alone = std::iter::once(reduction).collect();
        self.problem.classes.single(&self.evidence(&alone), 0)
    }

    /// The gradient along the tangent basis of this state, from sums at a point of a problem.
    fn along(&self, sums: &Sums, problem: &Problem, point: &Point) -> DVector<f64> {
        let chart = problem.covariance.chart(&point.root);
        let score = self.problem.covariance.elements.pack_score(&sums.score());
        let of_psi = chart.jacobian_at(&chart.root).transposed_times(&score);
        self.newton_iterate.tangent.pulled_back(problem.mean_jacobian(), &sums.mean_score, &of_psi)
    }
}

impl UpcomingPoint {
    /// Requests in advance the sums of remote tests that [`FinalState::at_other_alpha`] needs at this point.
    pub fn ask(&self, reductions: &Reductions, alpha: &Alpha) {
        _ = Reevaluation::of((&self.problem, &self.point, None), reductions, &self.assumed.at(alpha));
    }

    /// Requests the number of remote tests and, for each state, the number of tests that inform the state: a fit
    /// reports both.
    pub fn request_counts(&self) {
        _ = self.problem.remote_counts();
        self.problem.classes.remote.iter().for_each(|remote| _ = remote.ask(Question::Survey));
    }
}

impl Reevaluation {
    fn of(
        (problem, point, near): (&Problem, &Point, Option<&DMatrix<f64>>),
        reductions: &Reductions,
        structure: &Structure<'_>,
    ) -> Result<Option<Reevaluation>, StructureError> {
        let own = Problem::within(reductions, structure, problem)?;
        let root = converted_root(&problem.covariance, &own.covariance, &point.root);
        let point = Point { root, ..point.clone() };
        let sums = own.with_score(&point, || own.sums(&point, Order::First, near));
        Ok(sums.map(|sums| Reevaluation { problem: own, point, sums }))
    }

    /// ∂ℓ/∂(μ, γ, σ) in η, with respect to every element, including elements that the structure fixes.
    pub fn scores(&self) -> DVector<f64> {
        let of_sigma = self.problem.covariance.elements.pack_score(&self.sums.score());
        DVector::from_iterator(
            self.sums.mean_score.len() + of_sigma.len(),
            self.sums.mean_score.iter().chain(of_sigma.iter()).copied(),
        )
    }

    /// The gradient along the tangent basis of `origin`, the state that the point was taken from.
    pub fn gradient(&self, origin: &FinalState) -> DVector<f64> {
        origin.along(&self.sums, &self.problem, &self.point)
    }

    /// The distribution of ξ_j at the point.
    pub fn law(&self) -> InitialLaw {
        initial_law::law_with(&self.problem, &self.point, self.sums.near())
    }

    /// Σ in the user's units.
    pub fn covariance(&self) -> DMatrix<f64> {
        self.problem.classes.frame.covariance_out(&self.point.covariance())
    }

    /// ∂ℓ/∂Σ in the user's units.
    pub fn covariance_score(&self) -> DMatrix<f64> {
        self.problem.score_in_user_units(&self.sums.score())
    }
}

/// The point with F rotated into the shape of a chart (FF' stays unchanged), as in a Newton iterate.
fn in_chart(problem: &Problem, point: &Point) -> Point {
    Point { root: problem.covariance.chart(&point.root).root, ..point.clone() }
}

/// The root in the new map with the coordinates ψ that `root` has in the old map: matrices of the structure may depend
/// on α.
fn converted_root(source_form: &CovarianceMap, target_form: &CovarianceMap, root: &DMatrix<f64>) -> DMatrix<f64> {
    let parts = source_form.parts.iter().zip(&target_form.parts);
    target_form.block_diagonal(parts.map(|(old, new)| converted_part(&old.form, &new.form, old.of(root))))
}

fn converted_part(source_form: &CoordinateForm, target_form: &CoordinateForm, root: DMatrix<f64>) -> DMatrix<f64> {
    match (source_form, target_form) {
        (CoordinateForm::Scale(old), CoordinateForm::Scale(new)) => {
            let star = old.norm_squared();
            new * if star > 0.0 { (root.norm_squared() / star).sqrt() } else { 0.0 }
        }
        (CoordinateForm::StdDevs(old, _), CoordinateForm::StdDevs(new, _)) => {
            let size = |i: usize| {
                let unit = old.row(i).norm();
                if unit > 0.0 { root.row(i).norm() / unit } else { 0.0 }
            };
            DMatrix::from_fn(new.nrows(), new.ncols(), |i, c| size(i) * new[(i, c)])
        }
        (_, CoordinateForm::Fixed(known)) => symmetric::square_root(known),
        _ => root,
    }
}

impl Problem {
    /// ∂ℓ/∂Σ in the user's units, from ∂ℓ/∂Σ in η; also for one term of ∂ℓ/∂Σ or for the leading block.
    pub fn score_in_user_units(&self, score: &DMatrix<f64>) -> DMatrix<f64> {
        let scale = &self.classes.frame.scale;
        DMatrix::from_fn(score.nrows(), score.ncols(), |i, j| score[(i, j)] / (scale[i] * scale[j]))
    }

    /// Calls `ask`, which requests sums of remote tests at a point, and requests in the same round the score in α at
    /// that point, which is needed next.
    pub(super) fn with_score<T>(&self, point: &Point, ask: impl FnOnce() -> T) -> T {
        let Some(remote) = &self.classes.remote else { return ask() };
        remote.answers.together(|| {
            if self.criterion() == Criterion::Ml && !remote.values.is_empty() {
                let _ = remote.ask(Question::Score { law: initial_law::law_at(self, point).message() });
            }
            ask()
        })
    }

    /// Answer of remote tests to [`Question::Observability`] as if there were no groups: for each state, how many tests
    /// inform the state and how many observe the state; `None` without an answer or without remote tests.
    pub fn remote_counts(&self) -> Option<Vec<f64>> {
        let remote = self.classes.remote.as_ref()?;
        remote.ask(Question::Observability { frame: self.classes.apart().frame })
    }

    /// The problem of given reductions with the coordinates η and the criterion of `like`, another problem of the
    /// tests.
    pub fn within(
        reductions: &Reductions,
        structure: &Structure<'_>,
        like: &Problem,
    ) -> Result<Problem, StructureError> {
        Problem::of(Classes::within(reductions, &like.classes), structure, like.criterion())
    }
}
