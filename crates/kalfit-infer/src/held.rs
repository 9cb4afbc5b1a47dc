//! The maximum of ℓ with one quantity held at a value: a point of a profile likelihood.

use nalgebra::{DMatrix, DVector};

use crate::holdable::Holdable;
use crate::law::AsymptoticLaw;
use kalfit_algebra::symmetric;
use kalfit_estimate::{
    ClimbLimits, Constraint, CoordinateForm, CovarianceMap, FinalState, Local, NewtonIterate, Objective, Point,
    Problem, Stop, climb,
};

/// A maximum with one quantity held: a point of the profile.
pub(crate) struct Held<N> {
    /// Location of the maximum: the start of a search for the maximum with a nearby value held.
    pub(crate) near: N,
    /// ℓ_max with the quantity held.
    pub(crate) value: f64,
    /// dℓ_max / d(value held): the Lagrange multiplier.
    pub(crate) slope: f64,
}

/// A held maximum with the full iterate of the search.
pub(crate) type HeldMaximum = Held<NewtonIterate>;

impl HeldMaximum {
    /// This maximum without the iterate, only with the point.
    pub(super) fn point(self) -> Held<Point> {
        Held { near: self.near.point, value: self.value, slope: self.slope }
    }
}

/// Precision t of a held maximum, in standard errors: the error of ℓ is then ½t².
const TOLERANCE: f64 = 1e-7;
/// Most Newton steps of one climb.
const MAX_CLIMB_STEPS: usize = 40;
/// Most fixed-point iterations for a held correlation, each with a linear constraint.
const MAX_CORRELATION_ITERATIONS: usize = 30;

/// ℓ with the free mean coordinates restricted to the span of `directions`.
struct RestrictedMean<'a> {
    problem: &'a Problem,
    directions: DMatrix<f64>,
    jacobian: DMatrix<f64>,
}

impl Objective for RestrictedMean<'_> {
    fn local(&self, point: &Point, near: Option<&DMatrix<f64>>) -> Option<Local> {
        self.problem.local(point, near)
    }

    fn mean_jacobian(&self) -> &DMatrix<f64> {
        &self.jacobian
    }

    fn move_mean(&self, point: &Point, step: &[f64]) -> Point {
        let free = &self.directions * DVector::from_column_slice(&step[..self.directions.ncols()]);
        self.problem.move_mean(point, free.as_slice())
    }
}

/// Maximises ℓ near an estimate with one quantity held.
pub(crate) struct Holder<'a> {
    state: &'a FinalState,
    law: AsymptoticLaw<'a>,
    limits: ClimbLimits,
}

impl<'a> Holder<'a> {
    pub(crate) fn new(state: &'a FinalState) -> Holder<'a> {
        let tolerance = state.settings.tolerance.max(TOLERANCE);
        Holder { state, law: AsymptoticLaw::new(state), limits: ClimbLimits { tolerance, steps: MAX_CLIMB_STEPS } }
    }

    /// The maximum with `what` held at `value`, from a point nearby. `None` where no certified maximum is found.
    pub(crate) fn maximum(&self, what: Holdable, value: f64, near: &Point) -> Option<HeldMaximum> {
        let frame = &self.state.problem.classes.frame;
        match what {
            Holdable::Mean(i) => {
                let now = self.state.problem.values_of(near).mean[i];
                self.mean(&self.coordinate(i), frame.scale[i], (value - now) / frame.scale[i], near)
            }
            Holdable::Coefficient(c) => {
                let map = &self.state.problem.mean;
                let (row, unit) = (self.coordinate(frame.scale.len() + c), map.coefficient_scale[c]);
                self.mean(&row, unit.recip(), value * unit - near.coefficients[c], near)
            }
            Holdable::StdDev(i) => {
                let unit = frame.scale[i];
                let found = self.covariance(vec![(i, i, 1.0)], (value / unit).powi(2), near)?;
                let slope = found.slope * 2.0 * value / unit.powi(2);
                Some(Held { slope, ..found })
            }
            Holdable::Covariance(i, j) => {
                let unit = frame.scale[i] * frame.scale[j];
                let found = self.covariance(vec![(i.max(j), i.min(j), 1.0)], value / unit, near)?;
                Some(Held { slope: found.slope / unit, ..found })
            }
            Holdable::Correlation(i, j) => self.correlation((i.max(j), i.min(j)), value, near),
        }
    }

    /// The maximum with weights'(μ, γ) held at `value`, in the user's units. `None` where no certified maximum is
    /// found.
    pub(crate) fn combination(&self, weights: &DVector<f64>, value: f64, near: &Point) -> Option<HeldMaximum> {
        let problem = &self.state.problem;
        let row = problem.mean.jacobian().transpose() * self.scaled(weights);
        let now = problem.values_of(near);
        let now = now.mean.iter().chain(&now.coefficients).zip(weights.iter()).map(|(x, w)| x * w).sum::<f64>();
        self.mean(&row, 1.0, value - now, near)
    }

    /// Weights on (μ, γ) in the user's units, converted to η.
    fn scaled(&self, weights: &DVector<f64>) -> DVector<f64> {
        let problem = &self.state.problem;
        let mut scaled = weights.component_mul(&DVector::from_vec(problem.mean_units()));
        problem.mean.centring.weights(scaled.as_mut_slice());
        scaled
    }

    /// Derivatives of a mean coordinate (μ in η, then γ), with covariates that are not centred, by (b, γ).
    fn coordinate(&self, row: usize) -> DVector<f64> {
        let map = &self.state.problem.mean;
        let jacobian = map.jacobian();
        let mut weights = DVector::zeros(jacobian.nrows());
        weights[row] = 1.0;
        map.centring.weights(weights.as_mut_slice());
        jacobian.transpose() * weights
    }

    /// The maximum with row'(b, γ) held at the value at `near` plus `shift`; `unit` is one unit of row'(b, γ) in the
    /// user's units.
    fn mean(&self, row: &DVector<f64>, unit: f64, shift: f64, near: &Point) -> Option<HeldMaximum> {
        let (problem, n) = (&*self.state.problem, row.len());
        let size = row.norm_squared();
        if size == 0.0 {
            return None;
        }
        let (values, vectors) = symmetric::eigen(&(DMatrix::identity(n, n) - row * row.transpose() / size));
        let complement: Vec<usize> = (0..n).filter(|&k| values[k] > 0.5).collect();
        let directions = vectors.select_columns(&complement);
        let jacobian = problem.mean.jacobian() * &directions;
        let along = self.law.coordinates().view((0, 0), (n, n)) * row;
        let along = if row.dot(&along) > 0.0 { along } else { row.clone() };
        let moved = problem.move_mean(near, (&along * (shift / row.dot(&along))).as_slice());
        let objective = RestrictedMean { problem, directions, jacobian };
        let iterate = self.climb(&objective, &problem.covariance, moved)?;
        let score = problem.mean.jacobian().transpose() * &iterate.local.mean_score;
        let slope = score.dot(row) / size / unit;
        Some(Held { value: iterate.local.value, slope, near: iterate })
    }

    /// The maximum with Σ weight σ_pair over `terms` held at a value, in η.
    fn covariance(&self, terms: Vec<(usize, usize, f64)>, value: f64, near: &Point) -> Option<HeldMaximum> {
        let problem = &*self.state.problem;
        let mut map = problem.covariance.clone();
        map.constraints.push(Constraint { terms, value });
        let root = map.on_constraints(&start_root(&problem.covariance, &map.constraints, near))?;
        let iterate = self.climb(problem, &map, Point { root, ..near.clone() })?;
        let slope = *iterate.tangent.multipliers.last().expect("the constraint has a multiplier");
        Some(Held { value: iterate.local.value, slope, near: iterate })
    }

    /// Holds σ_ij = ρ√(σ_ii σ_jj) through 2σ_ij = ρ(tσ_ii + σ_jj/t) with t² = σ_jj/σ_ii: at that t the two constraints
    /// have equal values and equal gradients, so a fixed point in t is the maximum on the curved constraint.
    fn correlation(&self, (i, j): (usize, usize), rho: f64, near: &Point) -> Option<HeldMaximum> {
        let mut near = near.clone();
        let ratio = |point: &Point| {
            let sigma = point.covariance();
            let t = (sigma[(j, j)] / sigma[(i, i)]).sqrt();
            (t.is_finite() && t > 0.0).then_some(t)
        };
        let mut t = ratio(&near)?;
        for _ in 0..MAX_CORRELATION_ITERATIONS {
            let terms = vec![(i, j, 2.0), (i, i, -rho * t), (j, j, -rho / t)];
            let found = self.covariance(terms, 0.0, &near)?;
            let next = ratio(&found.near.point)?;
            if (next / t).ln().abs() < 1e-7 {
                let sigma = found.near.point.covariance();
                return Some(Held { slope: found.slope * (t * sigma[(i, i)] + sigma[(j, j)] / t), ..found });
            }
            (t, near) = (next, found.near.point);
        }
        None
    }

    fn climb(&self, objective: &dyn Objective, map: &CovarianceMap, start: Point) -> Option<NewtonIterate> {
        let start = NewtonIterate::new(objective, map, start, self.state.newton_iterate.near())?;
        let tests = self.state.problem.classes.tests as f64;
        let (iterate, stop) = climb(objective, map, tests, start, self.limits);
        (stop == Stop::Certified).then_some(iterate)
    }
}

/// A root F that nearly meets the last constraint: where the constraint holds a variance, the row and column of Σ are
/// scaled so that the variance has the value, which keeps the correlations. A variance of zero is set to the value,
/// since no step along F moves a variance from zero.
fn start_root(map: &CovarianceMap, constraints: &[Constraint], near: &Point) -> DMatrix<f64> {
    let Some(Constraint { terms, value }) = constraints.last() else { return near.root.clone() };
    let &[(i, k, _)] = &terms[..] else { return near.root.clone() };
    if i != k || !matches!(map.form_of(i), CoordinateForm::Factor(_)) {
        return near.root.clone();
    }
    let mut sigma = near.covariance();
    if sigma[(i, i)] > 1e-12 * value {
        let stretch = (value / sigma[(i, i)]).sqrt();
        sigma.row_mut(i).scale_mut(stretch);
        sigma.column_mut(i).scale_mut(stretch);
    } else {
        sigma[(i, i)] = *value;
    }
    map.root_of(&sigma)
}
