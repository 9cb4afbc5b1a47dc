//! Profile-likelihood limits of linear combinations of the means, such as a predicted mean.

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
    /// Weights of μ (p), then of the regression coefficients.
    pub weights: DVector<f64>,
    /// The constant term.
    pub constant: f64,
}

impl MeanCombination {
    /// Value of the combination at a population.
    pub fn value(&self, population: &Population) -> f64 {
        let all = population.mean.iter().chain(&population.coefficients);
        self.constant + all.zip(self.weights.iter()).map(|(x, weight)| x * weight).sum::<f64>()
    }
}

/// Maximises ℓ near an estimate with one combination held.
struct Combinations<'a> {
    holder: Holder<'a>,
    all: &'a [MeanCombination],
}

impl Holds for Combinations<'_> {
    const PRECISION: f64 = 1e-6;
    /// Index of the combination.
    type What = usize;
    type Near = Point;

    fn held(&self, what: usize, value: f64, near: &Point) -> Option<Held<Point>> {
        let MeanCombination { weights, constant } = &self.all[what];
        self.holder.combination(weights, value - constant, near).map(HeldMaximum::point)
    }
}

/// Limits of each combination by the likelihood-ratio test, where α is known: the values with ℓ_max at most ½
/// `quantile`² below the maximum. Both limits are the estimate where no estimated number moves the combination; `None`
/// where an end is not found, or once `progress` stops.
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
