//! Profile of ℓ over α with one quantity held.
//!
//! ```text
//! ℓ(x) = max over α of ℓ(α, x),   ℓ(α, x) = max over (μ, Σ) with the quantity held at x, on the reductions at α
//! dℓ(α, x)/dα = ∂ℓ/∂α - λ ∂q/∂α there       dℓ(x)/dx = λ, the Lagrange multiplier there
//! ```
//!
//! The inner maximum is the one of profiles at a known α; q is the quantity, which depends on α too if q is a predicted
//! mean. The maximisation over α begins where the joint law of α and the quantity predicts the maximum, with the
//! inverse covariance of α given the quantity as the curvature of -ℓ: one or two runs of the filters are enough. Where
//! ℓ(x) from this start is too low, further maximisations begin at other ends of the searches for α; ℓ(x) is the
//! highest maximum.

use nalgebra::{DMatrix, DVector};

use crate::dynamic::branches::{INTERVAL_LOSS, highest, others};
use crate::{AsymptoticLaw, Held, HeldMaximum, Holdable, Holder, Holds, value};
use kalfit_estimate::{Estimate, FinalState, NewtonIterate, Point};
use kalfit_model::{Alpha, Population};
use kalfit_search::ProfileLikelihood;
use kalfit_search::ValueCovariances;
use kalfit_search::matrix_gradient;
use kalfit_search::{DynamicFit, Standing};
use kalfit_search::{Iterate, ProfileInformation, Quadratic};

/// Tolerance t of α, in standard errors: the error of ℓ is then ½t².
const TOLERANCE: f64 = 1e-3;
/// Distance of α from the maximum, in standard errors, that is accepted where no step raises ℓ.
const ACCEPTED_DISTANCE: f64 = 2e-2;
/// Maximal number of steps of α.
const MAX_STEPS: usize = 25;
/// Most lengths tried for one step, each shorter than the previous length.
const MAX_TRIALS: usize = 8;
/// Longest step of a logarithm.
const MAX_LOG_STEP: f64 = 2.0;
/// Standard error assumed for a coordinate that is released from its bound.
const RELEASED_ERROR: f64 = 0.3;

/// A quantity that can be held at a value while α moves.
pub(super) trait HeldQuantity: Copy + Sync {
    /// The best (μ, Σ) at some α with the quantity held, from a point nearby.
    fn maximum(self, at: (&Holder<'_>, &Alpha), x: f64, near: &Point) -> Option<HeldMaximum>;
    /// Estimate of the quantity.
    fn value(self, outer: &HeldProfile<'_, '_>) -> Option<f64>;
    /// Derivative of the quantity along the tangent basis at the estimate.
    fn along(self, law: &AsymptoticLaw<'_>, estimate: &Estimate) -> DVector<f64>;
    /// Derivative of the quantity by the coordinates of the values in `outer.slots`, at the estimate.
    fn slopes(self, outer: &HeldProfile<'_, '_>) -> DVector<f64>;
    /// Derivative of the quantity by the coordinates of the values in `outer.slots`, at any values and any (μ, Σ).
    fn slopes_at(self, outer: &HeldProfile<'_, '_>, values: &[f64], there: &Population) -> Option<DVector<f64>>;
}

impl HeldQuantity for Holdable {
    fn maximum(self, (holder, _): (&Holder<'_>, &Alpha), x: f64, near: &Point) -> Option<HeldMaximum> {
        holder.maximum(self, x, near)
    }

    fn value(self, outer: &HeldProfile<'_, '_>) -> Option<f64> {
        value(outer.estimate, self)
    }

    fn along(self, law: &AsymptoticLaw<'_>, estimate: &Estimate) -> DVector<f64> {
        law.derivative(&estimate.covariance, self)
    }

    fn slopes(self, outer: &HeldProfile<'_, '_>) -> DVector<f64> {
        DVector::zeros(outer.slots.len())
    }

    fn slopes_at(self, outer: &HeldProfile<'_, '_>, _: &[f64], _: &Population) -> Option<DVector<f64>> {
        Some(self.slopes(outer))
    }
}

/// Profile of ℓ over α with a quantity held.
pub(super) struct HeldProfile<'b, 'a> {
    pub(super) objective: &'b ProfileLikelihood<'a>,
    pub(super) estimate: &'b Estimate,
    law: AsymptoticLaw<'b>,
    /// Slots of the values that may move.
    pub(super) slots: Vec<usize>,
    /// Covariance of the coordinates of the values in `slots`.
    alpha: DMatrix<f64>,
    /// Covariance of the coordinates of the values in `slots` with the coordinates along the tangent basis of (μ, Σ).
    cross: DMatrix<f64>,
    /// Covariance of (μ, Σ) along the tangent basis.
    inner: DMatrix<f64>,
    /// Values of α on other branches.
    others: Vec<Vec<f64>>,
}

/// A maximum with a quantity held, at which a search for a maximum nearby starts.
#[derive(Clone)]
pub(super) struct WarmStart {
    values: Vec<f64>,
    state: FinalState,
    /// The point in the coordinates of the state's problem; `None` for the point of the state.
    point: Option<Point>,
    /// Value at which the quantity is held; `None` at the unrestricted maximum.
    at: Option<f64>,
}

impl WarmStart {
    /// The unrestricted maximum.
    pub(super) fn best(fit: &DynamicFit, estimate: &Estimate) -> WarmStart {
        WarmStart { values: fit.sought.clone(), state: estimate.state.clone(), point: None, at: None }
    }
}

/// The best (μ, Σ) at some α with a quantity held.
struct HeldPoint {
    values: Vec<f64>,
    state: FinalState,
    place: NewtonIterate,
    slope: f64,
    /// dℓ/dcoordinate of all free values.
    gradient: Vec<f64>,
}

impl HeldPoint {
    fn value(&self) -> f64 {
        self.place.local.value
    }

    fn near(&self, at: f64) -> WarmStart {
        let (values, state) = (self.values.clone(), self.state.clone());
        WarmStart { values, state, point: Some(self.place.point.clone()), at: Some(at) }
    }
}

impl<'h> From<&'h HeldPoint> for Iterate<'h> {
    fn from(here: &'h HeldPoint) -> Iterate<'h> {
        Iterate { values: &here.values, gradient: &here.gradient }
    }
}

impl<'b, 'a> HeldProfile<'b, 'a> {
    pub(super) fn new(
        (objective, fit): (&'b ProfileLikelihood<'a>, &DynamicFit),
        estimate: &'b Estimate,
        covariances: &ValueCovariances,
    ) -> Self {
        let shared = &covariances.shared;
        let place = |s: usize| shared.iter().position(|&other| other == s).filter(|_| covariances.alpha[s].is_some());
        let at_bound = |s: usize| {
            let away_from_zero = fit.values[s] != 0.0 || !objective.coordinates[s].log;
            matches!(fit.standing[s], Standing::Lower | Standing::Upper) && away_from_zero
        };
        let slots: Vec<usize> = (0..fit.values.len()).filter(|&s| place(s).is_some() || at_bound(s)).collect();
        let places: Vec<Option<usize>> = slots.iter().map(|&s| place(s)).collect();
        let (whole, k, m) = (&covariances.whole, shared.len(), covariances.whole.nrows() - shared.len());
        let alpha = DMatrix::from_fn(slots.len(), slots.len(), |i, j| match (places[i], places[j]) {
            (Some(a), Some(b)) => whole[(a, b)],
            _ if i == j => RELEASED_ERROR * RELEASED_ERROR,
            _ => 0.0,
        });
        let cross = DMatrix::from_fn(slots.len(), m, |i, c| places[i].map_or(0.0, |a| whole[(a, k + c)]));
        let inner = whole.view((k, k), (m, m)).into_owned();
        HeldProfile {
            objective,
            estimate,
            law: AsymptoticLaw::new(&estimate.state),
            slots,
            alpha,
            cross,
            inner,
            others: others(objective, fit),
        }
    }

    /// Covariance of the values in `slots` with a quantity, and variance of the quantity.
    fn with(&self, what: impl HeldQuantity) -> (DVector<f64>, f64) {
        let (along, slopes) = (what.along(&self.law, self.estimate), what.slopes(self));
        let with = &self.cross * &along + &self.alpha * &slopes;
        let variance = along.dot(&(&self.inner * &along)) + slopes.dot(&(&with + &self.cross * &along));
        (with, variance)
    }

    /// Standard error of a quantity; `None` where the quantity has no standard error.
    pub(super) fn error(&self, what: impl HeldQuantity) -> Option<f64> {
        Some(self.with(what).1.sqrt()).filter(|error| error.is_finite() && *error > 0.0)
    }

    /// Covariance of the values in `slots` given a quantity, and regression coefficients of the values on the quantity.
    fn alpha_given(&self, what: impl HeldQuantity) -> (DMatrix<f64>, DVector<f64>) {
        let (with, variance) = self.with(what);
        if variance > 0.0 && variance.is_finite() {
            (&self.alpha - &with * with.transpose() / variance, with / variance)
        } else {
            (self.alpha.clone(), DVector::zeros(self.slots.len()))
        }
    }

    /// The values after a step in the coordinates of the values in `slots`.
    fn moved(&self, values: &[f64], step: &DVector<f64>) -> Vec<f64> {
        let mut moved = values.to_vec();
        for (&s, d) in self.slots.iter().zip(step.iter()) {
            let coordinate = &self.objective.coordinates[s];
            let d = if coordinate.log { d.clamp(-MAX_LOG_STEP, MAX_LOG_STEP) } else { *d };
            moved[s] = coordinate.moved(values[s], d);
        }
        moved
    }

    /// The best (μ, Σ) at `values` with the quantity held, and the gradient of ℓ at this (μ, Σ).
    fn at(&self, (what, x): (impl HeldQuantity, f64), values: Vec<f64>, near: &WarmStart) -> Option<HeldPoint> {
        let objective = self.objective;
        let reduced = objective.reduce(&values).ok()?;
        let alpha = objective.alpha(&values);
        let point = near.point.as_ref().unwrap_or(&near.state.newton_iterate.point);
        let state = near.state.at(&reduced.reductions, &alpha, point.clone())?;
        let found = what.maximum((&Holder::new(&state), &alpha), x, &state.newton_iterate.point)?;
        let scores = objective.scores(&values, &reduced, &state.law_at(&found.near)).ok()?;
        let there = state.problem.values_of(&found.near.point);
        let score = state.problem.score_in_user_units(&found.near.tangent.residual_score);
        let matrix = matrix_gradient(objective.model, &alpha, objective.slots, &there.covariance, &score);
        let mut gradient = objective.gradient(&values, &scores, &matrix);
        for (&s, own) in self.slots.iter().zip(what.slopes_at(self, &values, &there)?.iter()) {
            gradient[s] -= found.slope * own;
        }
        let (place, slope) = (found.near, found.slope);
        gradient.iter().all(|g| g.is_finite()).then_some(HeldPoint { values, state, place, slope, gradient })
    }

    /// Newton's step of the values that are not at a bound beyond which ℓ rises, and the squared decrement of the step;
    /// `None` where ℓ does not curve downward.
    fn step(&self, quadratic: &Quadratic<'_>, here: &HeldPoint) -> Option<(DVector<f64>, f64)> {
        let is_held = |s: usize| self.objective.coordinates[s].is_held(here.values[s], here.gradient[s]);
        let gradient: Vec<f64> =
            here.gradient.iter().enumerate().map(|(s, g)| if is_held(s) { 0.0 } else { *g }).collect();
        let (mut step, decrement) = quadratic.step(Iterate { gradient: &gradient, ..here.into() })?;
        self.slots.iter().zip(step.iter_mut()).filter(|(s, _)| gradient[**s] == 0.0).for_each(|(_, d)| *d = 0.0);
        Some((step, decrement * decrement))
    }

    /// The next point, by a step shortened until ℓ rises; `None` where no step raises ℓ.
    fn next(
        &self,
        held: (impl HeldQuantity, f64),
        here: &HeldPoint,
        step: &DVector<f64>,
        predicted_rise: f64,
    ) -> Option<HeldPoint> {
        let slack = 1e-12 * here.value().abs().max(1.0);
        let near = here.near(held.1);
        let mut length = 1.0;
        for _ in 0..MAX_TRIALS {
            let values = self.moved(&here.values, &(step * length));
            let rises = |next: &HeldPoint| next.value() >= here.value() + 0.05 * length * predicted_rise - slack;
            if let Some(next) = self.at(held, values, &near).filter(rises) {
                return Some(next);
            }
            length *= 0.3;
        }
        None
    }
}

impl Holds for HeldProfile<'_, '_> {
    const PRECISION: f64 = 1e-4;
    type What = Holdable;
    type Near = WarmStart;

    fn held(&self, what: Holdable, x: f64, near: &WarmStart) -> Option<Held<WarmStart>> {
        self.highest(what, x, near)
    }
}

impl HeldProfile<'_, '_> {
    /// The highest maximum with a quantity held that a search from nearby finds or, where this maximum is too low,
    /// searches on other branches.
    pub(super) fn highest(&self, what: impl HeldQuantity, x: f64, near: &WarmStart) -> Option<Held<WarmStart>> {
        let from = |other: &[f64]| {
            let (values, state) = (other.to_vec(), self.estimate.state.clone());
            self.maximum_from(what, x, &WarmStart { values, state, point: None, at: Some(x) })
        };
        let likely = self.estimate.log_likelihood - INTERVAL_LOSS;
        let found = highest(self.maximum_from(what, x, near), &self.others, (HeldPoint::value, likely), from)?;
        Some(Held { near: found.near(x), value: found.value(), slope: found.slope })
    }

    /// The maximum that a search from nearby reaches.
    fn maximum_from(&self, what: impl HeldQuantity, x: f64, near: &WarmStart) -> Option<HeldPoint> {
        let (covariance, follows) = self.alpha_given(what);
        let from = near.at.or_else(|| what.value(self))?;
        let expected = self.moved(&near.values, &(follows * (x - from)));
        let mut here = self.at((what, x), expected, near).or_else(|| self.at((what, x), near.values.clone(), near))?;
        let information = ProfileInformation::of_covariance(&self.slots, &covariance);
        let mut quadratic = Quadratic::about(&self.objective.coordinates, information, &here.values);
        for _ in 0..MAX_STEPS {
            let (step, predicted_rise) = self.step(&quadratic, &here)?;
            if predicted_rise <= TOLERANCE * TOLERANCE {
                return Some(here);
            }
            let Some(next) = self.next((what, x), &here, &step, predicted_rise) else {
                return Some(here).filter(|_| predicted_rise <= ACCEPTED_DISTANCE * ACCEPTED_DISTANCE);
            };
            quadratic.update((&here).into(), (&next).into());
            here = next;
        }
        None
    }
}
