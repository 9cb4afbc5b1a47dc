//! Limits by profile likelihood of what is linear in the means: of a predicted mean, say.

use nalgebra::DVector;
use rayon::prelude::*;

use crate::ends::{Holds, Profile};
use crate::held::{Held, HeldMaximum, Holder};
use crate::law::AsymptoticLaw;
use crate::progress::SharedProgress;
use kalfit_estimate::{Estimate, Point, Progress};
use kalfit_model::Population;

/// constant + weights'(μ, γ), in the user's units.
#[derive(Debug, Clone, PartialEq)]
pub struct MeanCombination {
    /// By μ (p), then by the regression coefficients.
    pub weights: DVector<f64>,
    /// The rest.
    pub constant: f64,
}

impl MeanCombination {
    /// Its value at a population.
    pub fn value(&self, population: &Population) -> f64 {
        let all = population.mean.iter().chain(&population.coefficients);
        self.constant + all.zip(self.weights.iter()).map(|(x, weight)| x * weight).sum::<f64>()
    }
}

/// Holds combinations near an estimate.
struct Combinations<'a> {
    holder: Holder<'a>,
    all: &'a [MeanCombination],
}

impl Holds for Combinations<'_> {
    const PRECISION: f64 = 1e-6;
    /// Its number.
    type What = usize;
    type Near = Point;

    fn held(&self, what: usize, value: f64, near: &Point) -> Option<Held<Point>> {
        let MeanCombination { weights, constant } = &self.all[what];
        self.holder.combination(weights, value - constant, near).map(HeldMaximum::point)
    }
}

/// Between which values the likelihood-ratio test keeps each combination, where the parameters are known: those whose ℓ_max is within
/// half the square of `quantile` of the maximum. Both are the estimate where nothing that was estimated moves it; `None` where an end
/// is not found, as is none once nobody waits any longer.
pub fn mean_limits(
    estimate: &Estimate,
    all: &[MeanCombination],
    quantile: f64,
    progress: &mut dyn Progress,
) -> Vec<Option<[f64; 2]>> {
    let progress = &SharedProgress::new(progress, None);
    let (law, population) = (AsymptoticLaw::new(&estimate.state), Population::from(estimate));
    let holder = Combinations { holder: Holder::new(&estimate.state), all };
    let limits = |(what, combination): (usize, &MeanCombination)| {
        let along = law.derivative_of_means(&combination.weights);
        let (centre, variance) = (combination.value(&population), along.dot(&(law.coordinates() * &along)));
        if along.amax() == 0.0 {
            return Some([centre; 2]);
        }
        let step = Some(quantile * variance.sqrt()).filter(|step| *step > 0.0 && step.is_finite())?;
        let maximum = estimate.state.newton_iterate.local.value;
        let name = format!("predicted mean {}", what + 1);
        let profile = Profile { holder: &holder, what, name, centre, maximum, quantile, limits: [None; 2], progress };
        profile.ends(&estimate.state.newton_iterate.point, step)
    };
    all.par_iter().enumerate().map(limits).collect()
}
