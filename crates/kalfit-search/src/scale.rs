//! A parameter θ that scales all noise: the noise level of a regression with random coefficients, say.
//!
//! Where every variance is proportional to θ^k, the variances of the filter are proportional to λ = (θ/θ_0)^k, and
//! gains and sensitivities do not depend on θ. With n measurements and the residual sum of squares r at θ_0,
//!
//! ```text
//! R(θ) = R/√λ      d(θ) = d/√λ      constant(θ) = constant - ½ n log λ - ½ r (1/λ - 1)
//! ∂ℓ_j/∂log λ = ½ (r/λ + E‖d(θ) - R(θ)ξ‖² - n)      given z_j, under the law of ξ
//! ```
//!
//! so that θ moves and ∂ℓ/∂θ is known without the filters: the filters run at θ_0, and again only far from θ_0. Nor are
//! reductions at θ needed to find (μ, Σ): the classes gathered at θ_0 serve for every θ near θ_0 ([`ScalableNoise`]).

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use rayon::prelude::*;

use crate::{Coordinate, DynamicError, matrices};
use kalfit_estimate::{Estimate, NoiseInformation, Residual, ScalableNoise, Settings, Structure};
use kalfit_filter::reduce::{ReductionRef, Reductions};
use kalfit_filter::score::InitialLaw;
use kalfit_filter::score::{Gradient, expected_square};
use kalfit_model::{Evidence, PhasedTest};
use kalfit_model::{PhasedModel, Population, Slots};

/// Ratio λ of variances, up or down, beyond which the filters run again where no digit may be lost: at large λ
/// constants are small differences of large numbers, at small λ the rounding errors of sums of squares are magnified.
pub(crate) const MAX_EXACT_RATIO: f64 = 1e4;
/// Ratio λ beyond which the filters run again where ℓ is only compared with values of ℓ far away.
pub(crate) const MAX_ROUGH_RATIO: f64 = 1e8;

/// The only free value, which scales all noise.
#[derive(Debug)]
pub struct Scale {
    /// The exponent k.
    power: f64,
    /// The ensemble at θ_0, where the filters ran last.
    reference: Mutex<Option<Arc<Reference>>>,
}

/// The ensemble at θ_0.
#[derive(Debug)]
struct Reference {
    value: f64,
    /// Reductions at θ_0; r of each test is known.
    reductions: Reductions,
    noisy: OnceLock<ScalableNoise>,
}

/// ℓ at a θ and the best (μ, Σ).
#[derive(Debug)]
pub(crate) struct AtScale {
    pub(crate) estimate: Estimate,
    /// dℓ/dcoordinate of θ.
    pub(crate) gradient: f64,
    /// Information on the coordinate of θ.
    pub(crate) information: NoiseInformation,
}

/// Runs the filters at a value of θ.
type FilterRun<'a> = &'a dyn Fn(f64) -> Result<Reductions, DynamicError>;

impl Scale {
    /// The only value of α as a scale of all noise; `None` where α has other values or scales not all noise, with
    /// several phases, and where some test is not given as rows.
    pub fn of(model: &PhasedModel, tests: &[PhasedTest], slots: &Slots) -> Option<Scale> {
        let ([slot], [phase]) = (slots.slots(), &model.phases[..]) else { return None };
        let rows = |test: &PhasedTest| matches!(test.phases[..], [Evidence::Rows(_)]);
        let is_unsuitable = slot.level.is_some() || phase.filter.is_some() || !matrices::slots(model, slots).is_empty();
        if is_unsuitable || !tests.iter().all(rows) {
            return None;
        }
        let power = phase.model.noise_power(slot.parameter)?;
        Some(Scale { power, reference: Mutex::new(None) })
    }

    /// The ensemble at a θ_0 near θ, and λ, which is within the factor `far` of 1; `None` where results at other values
    /// cannot be computed from results at θ.
    fn reference(
        &self,
        value: f64,
        far: f64,
        run: FilterRun<'_>,
    ) -> Result<Option<(Arc<Reference>, f64)>, DynamicError> {
        if !(value > 0.0 && value.is_finite()) {
            return Ok(None);
        }
        let near = |reference: &Arc<Reference>| (far.recip()..=far).contains(&self.variance(reference, value));
        let reference = match self.last().filter(near) {
            Some(reference) => reference,
            None => {
                let reductions = run(value)?;
                let unknown = |number: usize| reductions.residual(number).0.is_none();
                if reductions.has_exact() || (0..reductions.len()).any(unknown) {
                    return Ok(None);
                }
                let reference = Arc::new(Reference { value, reductions, noisy: OnceLock::new() });
                *self.reference.lock().unwrap_or_else(PoisonError::into_inner) = Some(reference.clone());
                reference
            }
        };
        let variance = self.variance(&reference, value);
        Ok((variance.is_normal() && variance.sqrt().recip().is_normal()).then_some((reference, variance)))
    }

    fn last(&self) -> Option<Arc<Reference>> {
        self.reference.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The ratio of variances λ = (θ/θ_0)^k.
    fn variance(&self, reference: &Reference, value: f64) -> f64 {
        (value / reference.value).powf(self.power)
    }

    /// A bound that ℓ(θ) does not exceed, whatever (μ, Σ): the sum of the constants, as what a test says of ξ adds
    /// -½ log|I + RΣR'| and a square. `None` where the reductions at θ cannot be scaled.
    pub(crate) fn bound(&self, value: f64, run: FilterRun<'_>) -> Result<Option<f64>, DynamicError> {
        // a bound needs few digits: no reference is too far for it
        let Some((reference, _)) = self.reference(self.last().map_or(value, |last| last.value), 1.0, run)? else {
            return Ok(None);
        };
        let (all, variance) = (&reference.reductions, self.variance(&reference, value));
        let of_test = |number: usize| all.constant(number) + Residual::of(all, number).change(variance);
        Ok(Some((0..all.len()).map(of_test).sum()))
    }

    /// The reductions at θ; `None` where the reductions at θ_0 cannot be scaled.
    pub(crate) fn reductions(&self, value: f64, run: FilterRun<'_>) -> Result<Option<Reductions>, DynamicError> {
        let Some((reference, variance)) = self.reference(value, MAX_EXACT_RATIO, run)? else { return Ok(None) };
        Ok(scaled(reference.reductions.clone(), variance))
    }

    /// The reductions at θ at the end of a search, scaled from the stored reductions at θ_0, which are given up.
    pub(crate) fn last_reductions(&self, value: f64, run: FilterRun<'_>) -> Result<Option<Reductions>, DynamicError> {
        let Some((reference, variance)) = self.reference(value, MAX_EXACT_RATIO, run)? else { return Ok(None) };
        *self.reference.lock().unwrap_or_else(PoisonError::into_inner) = None;
        let reductions = Arc::try_unwrap(reference)
            .map_or_else(|reference| reference.reductions.clone(), |reference| reference.reductions);
        Ok(scaled(reductions, variance))
    }

    /// The reductions at θ scaled from θ_0 = `origin`, whatever was requested before.
    pub fn reductions_from(
        &self,
        origin: f64,
        value: f64,
        run: FilterRun<'_>,
    ) -> Result<Option<Reductions>, DynamicError> {
        match self.reference(origin, 1.0, run)? {
            Some(_) => self.reductions(value, run),
            None => Ok(None),
        }
    }

    /// dℓ_j/dθ of each test at θ and a given law of ξ; `None` where there are no reductions at a θ_0.
    pub fn scores(&self, value: f64, reductions: &Reductions, law: &InitialLaw) -> Option<Vec<Gradient>> {
        let reference = self.last().filter(|_| value > 0.0)?;
        let variance = self.variance(&reference, value);
        let one = |(at, there): (ReductionRef<'_>, usize)| {
            let residual = Residual::of(&reference.reductions, there);
            let expected = expected_square(at, law);
            let slope = 0.5 * (residual.squares / variance + expected - residual.measurements);
            vec![(0, self.power * slope / value)]
        };
        let all: Vec<Gradient> = reductions.par_iter().zip(0..reference.reductions.len()).map(one).collect();
        all.iter().all(|score| score[0].1.is_finite()).then_some(all)
    }

    /// The best (μ, Σ) at θ, with slope and information in the coordinate of θ; `far`: [`MAX_EXACT_RATIO`] or [`MAX_ROUGH_RATIO`]. `None`
    /// where the reductions at θ cannot be scaled.
    pub(crate) fn fit(
        &self,
        (value, coordinate): (f64, Coordinate),
        (far, run): (f64, FilterRun<'_>),
        (structure, near, settings): (&Structure<'_>, Option<&Population>, &Settings),
    ) -> Result<Option<AtScale>, DynamicError> {
        let Some((reference, variance)) = self.reference(value, far, run)? else { return Ok(None) };
        if reference.noisy.get().is_none() {
            let _ = reference.noisy.set(ScalableNoise::new(&reference.reductions, structure, settings)?);
        }
        let noisy = reference.noisy.get().expect("it was set");
        let estimate = noisy.fit(variance, structure, near, settings)?;
        // u = log λ = k log θ, and of a value itself ∂²u/∂θ² = -k/θ²
        let du = self.power * coordinate.slope(value) / value;
        let slope = noisy.slope(variance, &estimate.state);
        let gradient = slope * du;
        let bend = if coordinate.log { 0.0 } else { gradient / value };
        let NoiseInformation { own, cross } = noisy.information(slope, &estimate.state);
        let information = NoiseInformation { own: du * du * own + bend, cross: cross * du };
        Ok(Some(AtScale { estimate, gradient, information }))
    }
}

/// The reductions with all variances multiplied by `variance`; `None` where some number is then not finite.
fn scaled(mut all: Reductions, variance: f64) -> Option<Reductions> {
    let unit = variance.sqrt().recip();
    let mut finite = true;
    for number in 0..all.len() {
        let residual = Residual::of(&all, number);
        let test = all.get_mut(number);
        *test.residual = Some(residual.squares / variance);
        *test.constant += residual.change(variance);
        finite &= test.constant.is_finite();
        for x in test.data.iter_mut().chain(test.factor) {
            *x *= unit;
            finite &= x.is_finite();
        }
    }
    finite.then_some(all)
}
