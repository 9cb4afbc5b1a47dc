//! The problem that a search solves: classes of tests, the structure of μ and Σ, and a count of the passes.

use std::borrow::Cow;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use nalgebra::{DMatrix, DVector};

use crate::centring::is_centred;
use crate::class::Class;
use crate::classes::Classes;
use crate::covariance::CovarianceMap;
use crate::local::{Local, Objective};
use crate::mean::MeanMap;
use crate::newton::NewtonIterate;
use crate::order::FlatMean;
use crate::order::Order;
use crate::pass::{of_class, pass};
use crate::point::Point;
use crate::reml::Restriction;
use crate::sums::Sums;
use crate::{Combination, Criterion, Structure};
use kalfit_algebra::symmetric;
use kalfit_filter::reduce::Reductions;
use kalfit_model::{LevelSlots, Population, StructureError};

/// The problem to maximise ℓ(μ, Σ) of the reductions under a structure, or the restricted likelihood.
#[derive(Debug)]
pub struct Problem {
    /// The reductions, gathered in classes.
    pub classes: Classes,
    /// Free coordinates of the mean.
    pub mean: MeanMap,
    /// The structure of Σ, in η.
    pub covariance: CovarianceMap,
    mean_jacobian: DMatrix<f64>,
    restriction: Option<Restriction>,
    passes: AtomicUsize,
    /// Whether the search is near its end, so that the next point evaluated may be the last.
    near_end: AtomicBool,
    /// Whether the search is far from its end, and takes the average information where the exact one costs much more.
    far: AtomicBool,
    /// The last point evaluated near the end of the search, with its sums.
    last: Mutex<Option<(Point, Sums)>>,
}

impl Problem {
    /// The problem for reductions under a structure, with a criterion and a way to combine phases.
    pub fn new(
        reductions: &Reductions,
        structure: &Structure<'_>,
        (criterion, combination): (Criterion, Combination),
    ) -> Result<Problem, StructureError> {
        let chained = combination != Combination::Stacked;
        let classes = Classes::new(reductions, structure.ranges(), &is_centred(structure), chained);
        let classes = match &structure.grouping {
            Some(grouping) => classes.in_groups(reductions, grouping),
            None => classes,
        };
        Problem::of(classes, structure, criterion)
    }

    /// The problem of given classes.
    pub(crate) fn of(
        classes: Classes,
        structure: &Structure<'_>,
        criterion: Criterion,
    ) -> Result<Problem, StructureError> {
        let mean = MeanMap::new(structure, &classes.frame);
        let covariance = CovarianceMap::new(structure, &classes.frame)?;
        let mean_jacobian = mean.jacobian();
        let restriction = (criterion == Criterion::Reml).then(|| {
            let at_zero = classes.mean_information(&mean.regressors);
            Restriction::new(
                &(mean_jacobian.transpose() * at_zero * &mean_jacobian),
                &mean.by_user(structure, &classes.frame),
            )
        });
        Ok(Problem {
            classes,
            mean,
            covariance,
            mean_jacobian,
            restriction,
            passes: AtomicUsize::new(0),
            near_end: AtomicBool::new(false),
            far: AtomicBool::new(false),
            last: Mutex::new(None),
        })
    }

    /// How the effects of each level enter a test.
    pub(crate) fn slots(&self) -> LevelSlots {
        self.classes.units.as_ref().map_or_else(LevelSlots::default, |units| units.grouping.slots())
    }

    /// The point at which a test by itself has its marginal law: where a test has several members of one factor, the sum
    /// of the covariances of all levels on its states; else `point`.
    pub fn marginal<'a>(&self, point: &'a Point) -> Cow<'a, Point> {
        let Some(units) = self.classes.units.as_ref().filter(|units| units.grouping.all_slots().next().is_some())
        else {
            return Cow::Borrowed(point);
        };
        let (p, slots) = (units.states, units.grouping.slots());
        let covariance = point.covariance();
        let block = |level: usize| covariance.view((level * p, level * p), (p, p)).into_owned();
        let all = (0..units.levels()).fold(DMatrix::zeros(p, p), |sum, l| sum + slots.spread(l, &block(l)));
        let mut root = DMatrix::zeros(point.root.nrows(), point.root.ncols());
        root.view_mut((0, 0), (p, p)).copy_from(&symmetric::square_root(&all));
        Cow::Owned(Point { root, ..point.clone() })
    }

    /// Whether level `level` of groups, the index of a block of Σ, has only one group.
    pub fn is_one_group(&self, level: usize) -> bool {
        level > 0 && self.classes.units.is_some() && self.classes.present[level] <= 1.0
    }

    /// (problem of the tests with the groups ignored, `point` in that problem, with the sum of the covariances of all
    /// levels as Σ).
    pub fn apart(&self, structure: &Structure<'_>, point: &Point, reductions: &Reductions) -> Option<(Problem, Point)> {
        let first = Structure { phases: structure.phases[..1].to_vec(), grouping: None, ..structure.clone() };
        let alone = match self.classes.remote {
            Some(_) => Problem::of(self.classes.apart(), &first, Criterion::Ml),
            None => Problem::new(reductions, &first, (Criterion::Ml, Combination::Stacked)),
        };
        let alone = alone.ok()?;
        let (p, frame) = (alone.classes.dimension(), &alone.classes.frame);
        let Population { mean, coefficients, covariance } = self.values_of(point).together(p, &self.slots());
        let root = symmetric::square_root(&frame.covariance_in(&covariance));
        let (mean, coefficients) = alone.mean.in_eta(frame, &mean, &coefficients);
        Some((alone, Point { mean, coefficients, root }))
    }

    /// The objective and its derivatives: one pass over the classes. The restricted likelihood's second derivatives
    /// contain the covariance C⁻¹ of the mean within the sum over classes, and C is a sum over classes too: `near`, C⁻¹
    /// at a nearby point, replaces C⁻¹ within the sum. The second derivatives are exact if the nearby point is `point`;
    /// nothing else depends on `near`. `None` where the restricted likelihood is not defined.
    pub(crate) fn sums(&self, point: &Point, order: Order, near: Option<&DMatrix<f64>>) -> Option<Sums> {
        let sums = self.unrestricted(point, order, near);
        if self.classes.remote.is_some() && sums.value.is_nan() {
            return None; // there is no answer
        }
        self.restricted(sums)
    }

    /// The sums without the term of the restricted likelihood: one pass.
    pub fn unrestricted(&self, point: &Point, order: Order, near: Option<&DMatrix<f64>>) -> Sums {
        self.count_pass();
        pass(&self.classes, &self.mean.regressors, point, order, self.flat(near).as_ref())
    }

    /// Adds the term of the restricted likelihood under that criterion; `None` where the term is not defined.
    fn restricted(&self, sums: Sums) -> Option<Sums> {
        let Some(restriction) = &self.restriction else { return Some(sums) };
        let information = self.mean_jacobian.transpose() * &sums.mean_information * &self.mean_jacobian;
        let restricted = restriction.at(&information, sums.spread(), &self.classes.elements)?;
        Some(sums.restrict(restricted))
    }

    /// Input of the restricted likelihood for every class; `None` under maximum likelihood.
    fn flat<'a>(&'a self, near: Option<&'a DMatrix<f64>>) -> Option<FlatMean<'a>> {
        self.restriction.as_ref().map(|_| FlatMean { jacobian: &self.mean_jacobian, covariance: near })
    }

    /// Whether the tests without one class inform every direction of the mean that all tests inform, from the
    /// [`unrestricted`](Problem::unrestricted) sums over all tests at a point; always true under maximum likelihood.
    pub fn informed_without(&self, all: &Sums, class: &Class, point: &Point) -> bool {
        let Some(restriction) = &self.restriction else { return true };
        let in_free_coordinates = |of: &DMatrix<f64>| self.mean_jacobian.transpose() * of * &self.mean_jacobian;
        let class_sums = self.of_class(class, point, Order::Mean);
        restriction.informs(
            &in_free_coordinates(&(&all.mean_information - &class_sums.mean_information)),
            &in_free_coordinates(&all.mean_information),
        )
    }

    /// The objective and its derivatives without one class of tests, from the [`unrestricted`](Problem::unrestricted)
    /// sums over all tests at `point` with this `near`. Up to a constant, the restricted likelihood is that of the
    /// tests of all other classes, provided that these tests inform every direction of the mean that all tests inform.
    pub fn without(&self, all: Sums, class: &Class, point: &Point, near: Option<&DMatrix<f64>>) -> Option<Sums> {
        let flat = self.flat(near);
        let class_sums = of_class(&self.classes, class, (&self.mean.regressors, flat.as_ref()), point, Order::Second);
        self.restricted(all.plus_times(-1.0, &class_sums))
    }

    /// Sets whether the next point may be the last: the expected information is needed at the last point, and one pass
    /// then computes it with the other sums.
    pub(crate) fn set_near_end(&self, soon: bool) {
        self.near_end.store(soon && self.restriction.is_none(), Ordering::Relaxed);
    }

    /// Sets whether the search is far from its end: the average information, which costs a fraction of the exact one
    /// where groups cross, is then enough. Nothing changes for other problems.
    pub(crate) fn set_far(&self, far: bool) {
        let crossed = self.classes.units.as_ref().is_some_and(|units| units.is_crossed());
        let here = self.classes.remote.is_none() && self.restriction.is_none();
        self.far.store(far && crossed && here, Ordering::Relaxed);
    }

    /// Whether points are evaluated with the average information.
    pub(crate) fn is_far(&self) -> bool {
        self.far.load(Ordering::Relaxed)
    }

    /// The sums at the iterate where the search ends: one pass, unless the search has computed them already.
    pub(crate) fn at_end(&self, iterate: &NewtonIterate) -> Option<Sums> {
        let last = self.last.lock().unwrap_or_else(PoisonError::into_inner).take();
        match last {
            Some((point, sums)) if point == iterate.point => Some(sums),
            other => {
                drop(other);
                self.sums(&iterate.point, Order::Expected, None).map(Sums::only_expected)
            }
        }
    }

    /// ℓ and its derivatives, whatever the criterion: one pass.
    pub fn likelihood(&self, point: &Point, order: Order) -> Sums {
        self.count_pass();
        pass(&self.classes, &self.mean.regressors, point, order, None)
    }

    /// Sums over one class.
    pub(crate) fn of_class(&self, class: &Class, point: &Point, order: Order) -> Sums {
        of_class(&self.classes, class, (&self.mean.regressors, None), point, order)
    }

    /// The criterion that is maximised.
    pub(crate) fn criterion(&self) -> Criterion {
        if self.restriction.is_some() { Criterion::Reml } else { Criterion::Ml }
    }

    /// Number of directions of the mean that the restricted likelihood has integrated out; zero under maximum
    /// likelihood.
    pub(crate) fn informed(&self) -> usize {
        self.restriction.as_ref().map_or(0, Restriction::rank)
    }

    /// Counts one pass over the classes.
    fn count_pass(&self) {
        self.passes.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of passes so far.
    pub(crate) fn passes(&self) -> usize {
        self.passes.load(Ordering::Relaxed)
    }

    /// A point in the user's units. Fixed elements get exactly their values.
    pub fn values_of(&self, point: &Point) -> Population {
        let frame = &self.classes.frame;
        let mut covariance = frame.covariance_out(&point.covariance());
        for constraint in self.covariance.constraints.iter().filter(|c| c.terms.len() == 1) {
            let (i, j, unit) = constraint.terms[0];
            let value = constraint.value / unit * frame.scale[i] * frame.scale[j];
            covariance[(i, j)] = value;
            covariance[(j, i)] = value;
        }
        let (mut mean, coefficients) = self.mean.in_user_units(frame, point);
        for (value, exact) in mean.iter_mut().zip(&self.mean.fixed) {
            *value = exact.unwrap_or(*value);
        }
        Population { mean, coefficients, covariance }
    }

    /// For each mean coordinate, the size of one unit of η in the user's units.
    pub fn mean_units(&self) -> Vec<f64> {
        let coefficients = self.mean.coefficient_scale.iter().map(|scale| scale.recip());
        self.classes.frame.scale.iter().copied().chain(coefficients).collect()
    }

    /// The point of values that meet the structure.
    pub fn point_of(&self, values: &Population) -> Point {
        let frame = &self.classes.frame;
        let (mean, coefficients) = self.mean.in_eta(frame, &values.mean, &values.coefficients);
        Point { mean, coefficients, root: self.covariance.root_of(&frame.covariance_in(&values.covariance)) }
    }

    /// The step in free mean coordinates that maximises ℓ at the Σ of these sums: generalised least squares (theory
    /// §3).
    pub(crate) fn least_squares_step(&self, sums: &Sums) -> DVector<f64> {
        let information = self.mean_jacobian.transpose() * &sums.mean_information * &self.mean_jacobian;
        let score = self.mean_jacobian.transpose() * &sums.mean_score;
        scaled_solve(&information, &score)
    }
}

/// Solves a x = b for positive semidefinite a after scaling to unit diagonal.
pub(crate) fn scaled_solve(a: &DMatrix<f64>, b: &DVector<f64>) -> DVector<f64> {
    let n = b.len();
    let unit = |i: usize| if a[(i, i)] > 0.0 { a[(i, i)].sqrt().recip() } else { 0.0 };
    let scale = DVector::from_fn(n, |i, _| unit(i));
    let scaled = DMatrix::from_fn(n, n, |i, j| scale[i] * a[(i, j)] * scale[j]);
    symmetric::pseudo_solve(&scaled, &b.component_mul(&scale)).component_mul(&scale)
}

impl Objective for Problem {
    fn local(&self, point: &Point, near: Option<&DMatrix<f64>>) -> Option<Local> {
        if self.is_far() {
            return Some(Local::of(&mut self.sums(point, Order::Average, near)?));
        }
        let near_end = self.near_end.load(Ordering::Relaxed);
        // a request to remote tests costs one round, however large the answer
        if !near_end && (self.classes.remote.is_none() || self.restriction.is_some()) {
            return Some(Local::of(&mut self.sums(point, Order::Second, near)?));
        }
        let last = || self.last.lock().unwrap_or_else(PoisonError::into_inner);
        *last() = None; // the memory of the last sums is needed
        let expected_sums = || self.sums(point, Order::Expected, near);
        let sums = if near_end { self.with_score(point, expected_sums) } else { expected_sums() }?;
        let mut sums = sums.with_folded_expected();
        let local = Local::of(&mut sums);
        *last() = Some((point.clone(), sums.only_expected()));
        Some(local)
    }

    fn mean_jacobian(&self) -> &DMatrix<f64> {
        &self.mean_jacobian
    }

    fn move_mean(&self, point: &Point, step: &[f64]) -> Point {
        let q = self.mean.basis.ncols();
        let moved = DVector::from_column_slice(&point.mean) + &self.mean.basis * DVector::from_column_slice(&step[..q]);
        let coefficients = point.coefficients.iter().zip(&step[q..]).map(|(c, s)| c + s).collect();
        Point { mean: moved.as_slice().to_vec(), coefficients, root: point.root.clone() }
    }
}
