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
//! so that θ moves, and its score is known, without the filters: they run at two values of θ, which tell r.

use std::sync::OnceLock;

use rayon::prelude::*;

use crate::estimate::InitialLaw;
use crate::model::PhasedModel;
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
}

impl Scale {
    /// `None` where α is not of this kind, where there are several phases, and where something is known otherwise than by rows.
    pub(crate) fn of(model: &PhasedModel, tests: &[PhasedTest], slots: &Slots) -> Option<Scale> {
        let ([slot], [phase]) = (slots.slots(), &model.phases[..]) else { return None };
        let rows = |test: &PhasedTest| matches!(test.phases[..], [Evidence::Rows(_)]);
        if slot.level.is_some() || phase.filter.is_some() || !tests.iter().all(rows) {
            return None;
        }
        let power = phase.model.noise_power(slot.parameter)?;
        Some(Scale { power, home: OnceLock::new() })
    }

    /// The reductions at θ; `run` filters at a value of θ. `None` where θ is not one that others can be had from.
    pub(crate) fn reductions<E>(
        &self,
        value: f64,
        run: impl Fn(f64) -> Result<Vec<Reduction>, E>,
    ) -> Result<Option<Vec<Reduction>>, E> {
        if !(value > 0.0 && value.is_finite()) {
            return Ok(None);
        }
        let home = match self.home.get() {
            Some(home) => home,
            None => {
                let reductions = run(value)?;
                let Ok(other) = run(value * (1.0 / self.power).exp()) else { return Ok(Some(reductions)) };
                let residual = |(at, other): (&Reduction, &Reduction)| residual(at, other);
                let residuals = reductions.iter().zip(&other).map(residual).collect();
                self.home.get_or_init(|| Home { value, reductions, residuals })
            }
        };
        let variance = (value / home.value).powf(self.power);
        let unit = variance.sqrt().recip();
        if !(variance.is_normal() && unit.is_normal()) {
            return Ok(None);
        }
        let one = |(at, residual): (&Reduction, &f64)| scaled(at, *residual, (variance, unit));
        let all: Vec<Reduction> = home.reductions.par_iter().zip(&home.residuals).map(one).collect();
        Ok(all.par_iter().all(is_finite).then_some(all))
    }

    /// dℓ_j/dθ of each test at θ and this law; `None` where the reductions are not from here.
    pub(crate) fn scores(&self, value: f64, reductions: &[Reduction], law: &InitialLaw) -> Option<Vec<Gradient>> {
        let home = self.home.get().filter(|_| value > 0.0)?;
        let variance = (value / home.value).powf(self.power);
        let one = |(at, residual): (&Reduction, &f64)| {
            let expected = expected_square(at, law);
            let slope = 0.5 * (residual / variance + expected - at.observations as f64);
            vec![(0, self.power * slope / value)]
        };
        let all: Vec<Gradient> = reductions.par_iter().zip(&home.residuals).map(one).collect();
        all.iter().all(|score| score[0].1.is_finite()).then_some(all)
    }
}

/// r, from the constants at λ = 1 and λ = e.
fn residual(at: &Reduction, other: &Reduction) -> f64 {
    let gained = other.constant - at.constant + 0.5 * at.observations as f64;
    (2.0 * gained / (1.0 - (-1.0_f64).exp())).max(0.0)
}

/// The reduction where variances are so many times as large, and √ of the inverse of that.
fn scaled(at: &Reduction, residual: f64, (variance, unit): (f64, f64)) -> Reduction {
    let mut to = at.clone();
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
