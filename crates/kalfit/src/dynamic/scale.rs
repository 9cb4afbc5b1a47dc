//! A parameter θ that scales all noise: the noise level of a regression with random coefficients, say.
//!
//! Where every variance is proportional to θ^k, those of the filter go as λ = (θ/θ_0)^k, and its gains and sensitivities not at
//! all. With n measurements and the residual sum of squares r at θ_0,
//!
//! ```text
//! R(θ) = R/√λ      d(θ) = d/√λ      constant(θ) = constant - ½ n log λ - ½ r (1/λ - 1)
//! ∂ℓ_j/∂log λ = ½ (r/λ + E‖d(θ) - R(θ)ξ‖² - n)      given z_j, under the law of ξ
//! ```
//!
//! so that θ moves, and its score is known, without the filters: they run at one value of θ. Nor are reductions needed
//! where (μ, Σ) is sought: the classes gathered once serve for every θ ([`Noisy`]).

use std::sync::OnceLock;

use rayon::prelude::*;

use crate::dynamic::bench::Solved;
use crate::dynamic::{Coordinate, DynamicError, matrices};
use crate::estimate::{Estimate, InitialLaw, NoiseInformation, Noisy, Settings, Structure};
use crate::model::{PhasedModel, Population};
use crate::reduce::{Evidence, PhasedTest, Reduction};
use crate::score::{Gradient, Slots, expected_square};

/// The only free value scales all noise.
#[derive(Debug)]
pub(crate) struct Scale {
    /// k.
    power: f64,
    home: OnceLock<Home>,
}

/// The ensemble at θ_0.
#[derive(Debug)]
struct Home {
    value: f64,
    reductions: Vec<Reduction>,
    /// r of each test.
    residuals: Vec<f64>,
    noisy: OnceLock<Noisy>,
}

/// Runs the filters at a value of θ.
type Run<'a> = &'a dyn Fn(f64) -> Result<Vec<Reduction>, DynamicError>;

impl Scale {
    /// `None` where α is not of this kind, where there are several phases, and where something is known otherwise than by rows.
    pub(crate) fn of(model: &PhasedModel, tests: &[PhasedTest], slots: &Slots) -> Option<Scale> {
        let ([slot], [phase]) = (slots.slots(), &model.phases[..]) else { return None };
        let rows = |test: &PhasedTest| matches!(test.phases[..], [Evidence::Rows(_)]);
        let more = slot.level.is_some() || phase.filter.is_some() || !matrices::slots(model, slots).is_empty();
        if more || !tests.iter().all(rows) {
            return None;
        }
        let power = phase.model.noise_power(slot.parameter)?;
        Some(Scale { power, home: OnceLock::new() })
    }

    /// The ensemble at θ_0 and λ; `None` where θ is not one that others can be had from.
    fn home(&self, value: f64, run: Run<'_>) -> Result<Option<(&Home, f64)>, DynamicError> {
        if !(value > 0.0 && value.is_finite()) {
            return Ok(None);
        }
        if self.home.get().is_none() {
            let reductions = run(value)?;
            let Some(residuals) = reductions.iter().map(|reduction| reduction.residual).collect() else {
                return Ok(None);
            };
            // not within the lock: threads that run the filters may take up other work meanwhile
            let _ = self.home.set(Home { value, reductions, residuals, noisy: OnceLock::new() });
        }
        let home = self.home.get().expect("it was set");
        let variance = self.variance(home, value);
        Ok((variance.is_normal() && variance.sqrt().recip().is_normal()).then_some((home, variance)))
    }

    /// λ.
    fn variance(&self, home: &Home, value: f64) -> f64 {
        (value / home.value).powf(self.power)
    }

    /// The reductions at θ. `None` where θ is not one that others can be had from.
    pub(crate) fn reductions(&self, value: f64, run: Run<'_>) -> Result<Option<Vec<Reduction>>, DynamicError> {
        let Some((home, variance)) = self.home(value, run)? else { return Ok(None) };
        let unit = variance.sqrt().recip();
        let one = |(at, residual): (&Reduction, &f64)| scaled(at, *residual, (variance, unit));
        let all: Vec<Reduction> = home.reductions.par_iter().zip(&home.residuals).map(one).collect();
        Ok(all.par_iter().all(is_finite).then_some(all))
    }

    /// dℓ_j/dθ of each test at θ and this law; `None` where the reductions are not from here.
    pub(crate) fn scores(&self, value: f64, reductions: &[Reduction], law: &InitialLaw) -> Option<Vec<Gradient>> {
        let home = self.home.get().filter(|_| value > 0.0)?;
        let variance = self.variance(home, value);
        let one = |(at, residual): (&Reduction, &f64)| {
            let expected = expected_square(at, law);
            let slope = 0.5 * (residual / variance + expected - at.observations as f64);
            vec![(0, self.power * slope / value)]
        };
        let all: Vec<Gradient> = reductions.par_iter().zip(&home.residuals).map(one).collect();
        all.iter().all(|score| score[0].1.is_finite()).then_some(all)
    }

    /// The best (μ, Σ) at θ and dℓ/dθ there. `None` where θ is not one that others can be had from.
    pub(crate) fn fit(
        &self,
        value: f64,
        run: Run<'_>,
        (structure, near, settings): (&Structure<'_>, Option<&Population>, &Settings),
    ) -> Result<Option<(Estimate, f64)>, DynamicError> {
        let Some((home, variance)) = self.home(value, run)? else { return Ok(None) };
        if home.noisy.get().is_none() {
            let _ = home.noisy.set(Noisy::new(&home.reductions, &home.residuals, structure, settings)?);
        }
        let noisy = home.noisy.get().expect("it was set");
        let estimate = noisy.fit(variance, structure, near, settings)?;
        let slope = noisy.slope(variance, &estimate.state) * self.power / value;
        Ok(Some((estimate, slope)))
    }

    /// The information in a coordinate of θ at a solved θ: its own, and with (μ, Σ) along the tangent basis. `None` where it was not
    /// solved here.
    pub(crate) fn information(&self, solved: &Solved, coordinate: Coordinate) -> Option<NoiseInformation> {
        let (value, home) = (solved.values[0], self.home.get()?);
        let at = home.noisy.get()?.information(self.variance(home, value), &solved.estimate.state);
        // u = log λ = k log θ, and of a value itself ∂²u/∂θ² = -k/θ²
        let slope = self.power * coordinate.slope(value) / value;
        let bend = if coordinate.log { 0.0 } else { solved.gradient[0] / value };
        Some(NoiseInformation { own: slope * slope * at.own + bend, cross: at.cross * slope })
    }
}

/// The reduction where variances are so many times as large, and √ of the inverse of that.
fn scaled(at: &Reduction, residual: f64, (variance, unit): (f64, f64)) -> Reduction {
    let mut to = Reduction { residual: Some(residual / variance), ..at.clone() };
    to.constant -= 0.5 * (at.observations as f64 * variance.ln() + residual * (variance.recip() - 1.0));
    let shrink = |numbers: &mut [f64]| numbers.iter_mut().for_each(|x| *x *= unit);
    shrink(&mut to.data);
    shrink(&mut to.factor);
    to
}

fn is_finite(reduction: &Reduction) -> bool {
    let all = |numbers: &[f64]| numbers.iter().all(|x| x.is_finite());
    reduction.constant.is_finite() && all(&reduction.data) && all(&reduction.factor)
}
