//! The objective of a finished search under reductions at another α, in the same coordinates: what mixed second derivatives
//! of α, μ and Σ are made of; and the law of ξ_j at a point, as posteriors want it.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::ensemble::Grouping;
use crate::estimate::class::Class;
use crate::estimate::classes::Classes;
use crate::estimate::covariance::{CoordinateForm, CovarianceMap};
use crate::estimate::frame::Frame;
use crate::estimate::levels::{self, TestPosterior, Units};
use crate::estimate::local::Objective;
use crate::estimate::newton::{self, NewtonIterate};
use crate::estimate::order::{Order, SumsWanted};
use crate::estimate::point::{Point, Regressors};
use crate::estimate::problem::Problem;
use crate::estimate::remote::{list, matrix};
use crate::estimate::structure::Assumed;
use crate::estimate::sums::Sums;
use crate::estimate::{Criterion, FinalState, Structure};
use crate::linalg::symmetric;
use crate::model::{Alpha, StructureError};
use crate::reduce::{ReductionRef, Reductions};
use crate::remote::{InGroups, Law, Question};
use rayon::prelude::*;

/// The objective at one point under some reductions.
#[derive(Debug)]
pub(crate) struct Reevaluation {
    pub(crate) problem: Problem,
    pub(crate) point: Point,
    pub(crate) sums: Sums,
}

/// A place that a search of tests that are elsewhere is about to reach.
pub(crate) struct UpcomingPoint {
    problem: Problem,
    point: Point,
    assumed: Assumed,
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
    /// Where tests stand in groups: ξ of each given all tests of its unit.
    given: Option<Arc<JointPosteriors>>,
}

/// The posterior of ξ of every test, which depends on other tests too.
#[derive(Debug)]
enum JointPosteriors {
    Here {
        grouping: Arc<Grouping>,
        /// x̂ and a root of V of each test, by its number in the grouping; under the restricted likelihood with what the mean adds to V.
        tests: Vec<(DVector<f64>, DMatrix<f64>)>,
    },
    /// The tests are elsewhere: this is what it follows from.
    Elsewhere(InGroups),
}

impl InitialLaw {
    #[cfg(test)]
    pub(crate) fn known(mean: DVector<f64>, root: DMatrix<f64>) -> InitialLaw {
        InitialLaw { mean, regression: Vec::new(), root, mean_half: None, given: None }
    }

    /// That of a point whose values are known.
    pub(crate) fn at(problem: &Problem, point: &Point) -> InitialLaw {
        InitialLaw::of(problem, point, None)
    }

    fn of(problem: &Problem, point: &Point, mean_covariance: Option<&DMatrix<f64>>) -> InitialLaw {
        let frame = &problem.classes.frame;
        let (all, units) = (frame.scale.len(), problem.mean_units());
        let coefficients = point.coefficients.iter().zip(&problem.mean.coefficient_scale).map(|(c, s)| c / s);
        // of a test in groups ξ is the sum over the levels
        let levels = problem.classes.units.as_ref().map_or(1, |units| units.levels());
        let p = all / levels;
        let mean = frame.mean_out(&point.mean);
        let half = mean_covariance.map(|covariance| {
            let half = problem.mean.jacobian() * symmetric::square_root(covariance);
            let sum = |k: usize, c: usize| (0..levels).map(|l| half[(l * p + k, c)]).sum::<f64>();
            let entry = |k: usize, c: usize| if k < p { sum(k, c) } else { half[(k - p + all, c)] };
            DMatrix::from_fn(half.nrows() - all + p, half.ncols(), entry)
        });
        let in_units = |half: &DMatrix<f64>| {
            DMatrix::from_fn(half.nrows(), half.ncols(), |k, c| {
                units[if k < p { k } else { k - p + all }] * half[(k, c)]
            })
        };
        let given = |units: &Arc<Units>| match problem.classes.remote {
            Some(_) => JointPosteriors::Elsewhere(InGroups { frame: frame.clone(), place: point.told() }),
            None => JointPosteriors::here((units, frame), (point, &problem.mean.regressors), half.as_ref()),
        };
        InitialLaw {
            mean: DVector::from_fn(p, |i, _| (0..levels).map(|l| mean[l * p + i]).sum()),
            regression: problem.mean.regressors.iter().copied().zip(coefficients).collect(),
            root: DMatrix::from_fn(p, levels * point.root.ncols(), |i, c| {
                let (l, c) = (c / point.root.ncols(), c % point.root.ncols());
                frame.scale[l * p + i] * point.root[(l * p + i, c)]
            }),
            mean_half: half.as_ref().map(in_units),
            given: problem.classes.units.as_ref().map(given).map(Arc::new),
        }
    }

    /// As others are told of it.
    pub(crate) fn told(&self) -> Law {
        Law {
            mean: self.mean.as_slice().to_vec(),
            regression: self.regression.clone(),
            root: list(&self.root),
            mean_half: self.mean_half.as_ref().map(list),
            given: match self.given.as_deref() {
                Some(JointPosteriors::Elsewhere(told)) => Some(told.clone()),
                _ => None,
            },
        }
    }

    /// As it is told of; `None` where it is not one of so many states and regressions.
    pub(crate) fn from_told(law: &Law, (p, regressions): (usize, usize)) -> Option<InitialLaw> {
        let fits = law.mean.len() == p && law.regression.len() == regressions;
        if !fits || law.regression.iter().any(|&(element, _)| element >= p) {
            return None;
        }
        let mean_half = match &law.mean_half {
            Some(half) => Some(matrix(p + regressions, half)?),
            None => None,
        };
        Some(InitialLaw {
            mean: DVector::from_column_slice(&law.mean),
            regression: law.regression.clone(),
            root: matrix(p, &law.root)?,
            mean_half,
            given: None,
        })
    }

    /// The same of the tests of these units, of each given all tests of its unit at a point.
    pub(super) fn within(
        self,
        (units, frame): (&Units, &Frame),
        (point, regressors): (&Point, &Regressors),
    ) -> InitialLaw {
        InitialLaw { given: Some(Arc::new(JointPosteriors::here((units, frame), (point, regressors), None))), ..self }
    }

    /// ξ given the data is known of each test, other tests of its unit among them.
    pub(crate) fn is_of_each(&self) -> bool {
        self.given.is_some()
    }

    /// x̂ and a root of V of a test, where they depend on other tests too.
    pub(crate) fn given(&self, test: &str) -> Option<(&DVector<f64>, &DMatrix<f64>)> {
        let JointPosteriors::Here { grouping, tests } = self.given.as_deref()? else { return None };
        let (mean, root) = &tests[grouping.number(test)?];
        Some((mean, root))
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

impl JointPosteriors {
    /// `half`: a root of the covariance of the mean coordinates of a test, under the restricted likelihood.
    fn here(
        (units, frame): (&Units, &Frame),
        (point, regressors): (&Point, &Regressors),
        half: Option<&DMatrix<f64>>,
    ) -> JointPosteriors {
        let p = units.states;
        let found = levels::posteriors(units, (point, regressors), None, half.is_some());
        let one = |test: &TestPosterior| {
            if test.mean.is_empty() {
                return (DVector::zeros(0), DMatrix::zeros(0, 0)); // a test that is not among the reductions
            }
            let own = symmetric::square_root(&DMatrix::from_row_slice(p, p, &test.covariance));
            let extra = half.map(|half| DMatrix::from_row_slice(p, half.nrows(), &test.moved) * half);
            let columns = p + extra.as_ref().map_or(0, DMatrix::ncols);
            let entry = |i: usize, c: usize| match (c.checked_sub(p), &extra) {
                (Some(c), Some(extra)) => extra[(i, c)],
                _ => own[(i, c)],
            };
            let mean = (0..p).map(|i| frame.centre[i] + frame.scale[i] * test.mean[i]);
            let root = DMatrix::from_fn(p, columns, |i, c| frame.scale[i] * entry(i, c));
            (DVector::from_iterator(p, mean), root)
        };
        JointPosteriors::Here { grouping: units.grouping.clone(), tests: found.tests.par_iter().map(one).collect() }
    }
}

impl FinalState {
    /// The law of ξ_j where the search ended.
    pub(crate) fn law(&self) -> InitialLaw {
        InitialLaw::of(&self.problem, &self.newton_iterate.point, self.newton_iterate.near())
    }

    /// The same at a place of its own.
    pub(crate) fn law_at(&self, place: &NewtonIterate) -> InitialLaw {
        InitialLaw::of(&self.problem, &place.point, place.near())
    }

    /// ∂ℓ/∂Σ in the user's units: the objective changes by tr(G dΣ).
    pub(crate) fn covariance_score(&self) -> DMatrix<f64> {
        self.problem.score_out(&self.sums.score())
    }

    /// The objective at this point under other reductions of the same tests; `None` where it is not defined.
    pub(crate) fn at_other_alpha(
        &self,
        reductions: &Reductions,
        alpha: &Alpha,
    ) -> Result<Option<Reevaluation>, StructureError> {
        let home = (&*self.problem, &self.newton_iterate.point, self.newton_iterate.near());
        Reevaluation::of(home, &self.evidence(reductions), &self.assumed.at(alpha))
    }

    /// Where a step along the tangent basis of this place leads, of tests that are elsewhere: nobody has answered yet what they say
    /// there.
    pub(crate) fn ahead(&self, reductions: &Reductions, alpha: &Alpha, step: &DVector<f64>) -> Option<UpcomingPoint> {
        let point = newton::moved(&*self.problem, &self.problem.covariance, &self.newton_iterate, step)?;
        let (problem, point) = self.carried_to(reductions, &self.assumed.at(alpha), point).ok()?;
        let point = charted(&problem, &point);
        Some(UpcomingPoint { problem, point, assumed: self.assumed.clone() })
    }

    /// A point of this problem in that of other reductions of the same tests.
    fn carried_to(
        &self,
        reductions: &Reductions,
        structure: &Structure<'_>,
        point: Point,
    ) -> Result<(Problem, Point), StructureError> {
        let problem = Problem::within(&self.evidence(reductions), structure, &self.problem)?;
        let root = carried(&self.problem.covariance, &problem.covariance, &point.root);
        Ok((problem, Point { root, ..point }))
    }

    /// The state after a step along the tangent basis of this place, under other reductions of the same tests; `None` where it
    /// is not defined.
    pub(crate) fn moved(&self, reductions: &Reductions, alpha: &Alpha, step: &DVector<f64>) -> Option<FinalState> {
        self.at(reductions, alpha, newton::moved(&*self.problem, &self.problem.covariance, &self.newton_iterate, step)?)
    }

    /// The state at another point of this problem, under other reductions of the same tests; `None` where it is not defined.
    pub(crate) fn at(&self, reductions: &Reductions, alpha: &Alpha, point: Point) -> Option<FinalState> {
        let structure = self.assumed.at(alpha);
        let (problem, point) = self.carried_to(reductions, &structure, point).ok()?;
        let charted = charted(&problem, &point);
        problem.ends_soon(true); // nothing more is asked of this place
        let place = problem.with_score(&charted, || {
            NewtonIterate::new(&problem, &problem.covariance, point, self.newton_iterate.near())
        })?;
        // the restricted likelihood's second derivatives want the covariance of the mean at the place itself
        let place = match place.near().cloned() {
            Some(own) => NewtonIterate::new(&problem, &problem.covariance, place.point, Some(&own))?,
            None => place,
        };
        problem.ends_soon(false);
        let sums = match problem.criterion() {
            Criterion::Ml => problem.at_end(&place)?,
            Criterion::Reml => problem.sums(&place.point, Order::Expected, place.near())?,
        };
        let assumed = (&structure).into();
        let settings = self.settings.clone();
        Some(FinalState { problem: Arc::new(problem), newton_iterate: place, sums, assumed, settings, joint: None })
    }

    /// Gradient of one test's ℓ_j along the tangent basis of this place, under another reduction of it.
    pub(crate) fn gradient_of(&self, reduction: ReductionRef<'_>) -> DVector<f64> {
        let class = self.class_of(reduction);
        let sums = self.problem.of_class(&class, &self.newton_iterate.point, Order::First);
        self.along(&sums, &self.problem, &self.newton_iterate.point)
    }

    /// Calls `of` with the numbers of the tests, and their sums of first order at this place, of each test, or of each unit where tests
    /// stand in groups: of what is independent of the others. The order depends on nothing but the ids.
    pub(crate) fn each_independent(&self, evidence: &Reductions, of: &mut dyn FnMut(&[usize], &Sums)) {
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

    /// A gradient at this place along its tangent basis.
    pub(crate) fn gradient_along(&self, sums: &Sums) -> DVector<f64> {
        self.along(sums, &self.problem, &self.newton_iterate.point)
    }

    /// One test as a class of its own.
    fn class_of(&self, reduction: ReductionRef<'_>) -> Class {
        let alone = std::iter::once(reduction).collect();
        self.problem.classes.single(&self.evidence(&alone), 0)
    }

    /// A gradient in mean coordinates and Σ along the tangent basis.
    fn along(&self, sums: &Sums, problem: &Problem, point: &Point) -> DVector<f64> {
        let chart = problem.covariance.chart(&point.root);
        let score = self.problem.covariance.elements.pack_score(&sums.score());
        let of_psi = chart.jacobian_at(&chart.root).transposed_times(&score);
        self.newton_iterate.tangent.pulled_back(problem.mean_jacobian(), &sums.mean_score, &of_psi)
    }
}

impl UpcomingPoint {
    /// Asks for what [`FinalState::at_other_alpha`] will ask for from there.
    pub(crate) fn ask(&self, reductions: &Reductions, alpha: &Alpha) {
        _ = Reevaluation::of((&self.problem, &self.point, None), reductions, &self.assumed.at(alpha));
    }

    /// Asks how many tests there are, and how many inform each state there: what a fit tells of its end.
    pub(crate) fn ask_counts(&self) {
        _ = self.problem.told_counts();
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
        let root = carried(&problem.covariance, &own.covariance, &point.root);
        let point = Point { root, ..point.clone() };
        let sums = own.with_score(&point, || own.sums(&point, Order::First, near));
        Ok(sums.map(|sums| Reevaluation { problem: own, point, sums }))
    }

    /// ∂ℓ/∂(μ in η, γ; σ pairs): of every element, whatever the structure holds.
    pub(crate) fn scores(&self) -> DVector<f64> {
        let of_sigma = self.problem.covariance.elements.pack_score(&self.sums.score());
        DVector::from_iterator(
            self.sums.mean_score.len() + of_sigma.len(),
            self.sums.mean_score.iter().chain(of_sigma.iter()).copied(),
        )
    }

    /// The gradient along the tangent basis of the place it was taken from.
    pub(crate) fn gradient(&self, home: &FinalState) -> DVector<f64> {
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
        self.problem.score_out(&self.sums.score())
    }
}

/// The point with its root in the chart that places have.
fn charted(problem: &Problem, point: &Point) -> Point {
    Point { root: problem.covariance.chart(&point.root).root, ..point.clone() }
}

/// The root with the same coordinates ψ where matrices of the structure follow α.
fn carried(from: &CovarianceMap, to: &CovarianceMap, root: &DMatrix<f64>) -> DMatrix<f64> {
    let parts = from.parts.iter().zip(&to.parts);
    to.assembled(parts.map(|(old, new)| carried_part(&old.form, &new.form, old.of(root))))
}

fn carried_part(from: &CoordinateForm, to: &CoordinateForm, root: DMatrix<f64>) -> DMatrix<f64> {
    match (from, to) {
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
    /// ∂ℓ/∂Σ, or a part of it, in the user's units.
    pub(crate) fn score_out(&self, score: &DMatrix<f64>) -> DMatrix<f64> {
        let scale = &self.classes.frame.scale;
        DMatrix::from_fn(score.nrows(), score.ncols(), |i, j| score[(i, j)] / (scale[i] * scale[j]))
    }

    /// Asks for a sum at a point of tests that are elsewhere together with what α's score is made of there, which is wanted next.
    pub(super) fn with_score<T>(&self, point: &Point, ask: impl FnOnce() -> T) -> T {
        let Some(remote) = &self.classes.remote else { return ask() };
        remote.answers.together(|| {
            if self.criterion() == Criterion::Ml && !remote.values.is_empty() {
                let _ = remote.ask(Question::Score { law: InitialLaw::at(self, point).told() });
            }
            ask()
        })
    }

    /// Numbers of the tests that are elsewhere that inform and observe each state, as if each stood alone; `None` where nobody has
    /// answered, or nobody is asked.
    pub(crate) fn told_counts(&self) -> Option<Vec<f64>> {
        let remote = self.classes.remote.as_ref()?;
        remote.ask(Question::Observability { frame: self.classes.apart().frame })
    }

    /// The problem of other reductions of the same tests, in the coordinates η and with the criterion of another.
    pub(crate) fn within(
        reductions: &Reductions,
        structure: &Structure<'_>,
        like: &Problem,
    ) -> Result<Problem, StructureError> {
        Problem::of(Classes::within(reductions, &like.classes), structure, like.criterion())
    }
}
