//! Profile-likelihood limits of predicted means where α is free: a predicted mean is linear in (μ, γ), with weights
//! that depend on α.

use nalgebra::DVector;
use rayon::prelude::*;

use crate::dynamic::held_profile::{HeldProfile, HeldQuantity, WarmStart};
use crate::dynamic::inference::estimate_with_law;
use crate::{AsymptoticLaw, Held, HeldMaximum, Holder, Holds, MeanCombination, Profile, SharedProgress};
use kalfit_estimate::{Estimate, Point, Progress};
use kalfit_model::PhasedTest;
use kalfit_model::{Alpha, PhasedModel, Population};
use kalfit_search::BeforeRuns;
use kalfit_search::DynamicFit;
use kalfit_search::ProfileLikelihood;

/// Step of a coordinate for derivatives of weights.
const STEP: f64 = 1e-4;
/// Largest relative change of a mean at which the mean counts as known: no estimated quantity moves such a mean.
const MIN_SENSITIVITY: f64 = 1e-12;

/// All predicted means at an α, in a fixed order; `None` where the means are not defined.
pub type MeansAt<'a> = &'a (dyn Fn(&Alpha) -> Option<Vec<MeanCombination>> + Sync);

/// Likelihood-ratio limits of each predicted mean: the values of the mean with ℓ_max, over α, μ and Σ, at most ½
/// `quantile`² below the maximum. Both limits are the estimate where no estimated quantity moves the mean; `None` where
/// a limit is not found, or once `progress` stops.
pub fn mean_limits(
    (model, tests): (&PhasedModel, &[PhasedTest]),
    fit: &DynamicFit,
    (means, quantile): (MeansAt<'_>, f64),
    progress: &mut dyn Progress,
) -> Vec<Option<[f64; 2]>> {
    let progress = &SharedProgress::new(progress, Some(model));
    let objective = ProfileLikelihood::new(model, tests, &fit.slots, &fit.settings);
    let (estimate, covariances) = estimate_with_law(&objective, fit);
    let goes_on = |runs| progress.goes_on(runs);
    let objective = objective.while_waited_for(BeforeRuns(&goes_on));
    let Some(home) = means(&fit.alpha) else { return Vec::new() };
    let outer = HeldProfile::new((&objective, fit), &estimate, &covariances);
    let population = Population::from(&estimate);
    let means = Means { outer: &outer, means, fit };
    let limits = |number: usize| {
        let centre = home[number].value(&population);
        let mean = LimitedMean { means: &means, number };
        let moved = home[number].weights.amax().max(mean.slopes(&outer).amax());
        if moved <= MIN_SENSITIVITY * centre.abs() {
            return Some([centre; 2]);
        }
        let step = quantile * outer.error(mean)?;
        let maximum = estimate.state.newton_iterate.local.value;
        let (name, limits) = (format!("predicted mean {}", number + 1), [None; 2]);
        let profile = Profile { holder: &means, what: number, name, centre, maximum, quantile, limits, progress };
        profile.ends(&WarmStart::best(fit, &estimate), step)
    };
    (0..home.len()).into_par_iter().map(limits).collect()
}

/// Predicted means as functions of α.
struct Means<'o, 'b, 'a> {
    outer: &'o HeldProfile<'b, 'a>,
    means: MeansAt<'o>,
    fit: &'o DynamicFit,
}

impl Holds for Means<'_, '_, '_> {
    const PRECISION: f64 = 1e-4;
    /// Index of the mean.
    type What = usize;
    type Near = WarmStart;

    fn held(&self, what: usize, x: f64, near: &WarmStart) -> Option<Held<WarmStart>> {
        self.outer.highest(LimitedMean { means: self, number: what }, x, near)
    }
}

/// One of the predicted means.
#[derive(Clone, Copy)]
struct LimitedMean<'m, 'o, 'b, 'a> {
    means: &'m Means<'o, 'b, 'a>,
    number: usize,
}

impl LimitedMean<'_, '_, '_, '_> {
    fn at(self, alpha: &Alpha) -> Option<MeanCombination> {
        (self.means.means)(alpha)?.into_iter().nth(self.number)
    }
}

impl HeldQuantity for LimitedMean<'_, '_, '_, '_> {
    fn maximum(self, (holder, alpha): (&Holder<'_>, &Alpha), x: f64, near: &Point) -> Option<HeldMaximum> {
        let MeanCombination { weights, constant } = self.at(alpha)?;
        holder.combination(&weights, x - constant, near)
    }

    fn value(self, outer: &HeldProfile<'_, '_>) -> Option<f64> {
        Some(self.at(&self.means.fit.alpha)?.value(&Population::from(outer.estimate)))
    }

    fn along(self, law: &AsymptoticLaw<'_>, _: &Estimate) -> DVector<f64> {
        let weights = self.at(&self.means.fit.alpha).map_or_else(|| DVector::zeros(0), |own| own.weights);
        law.derivative_of_means(&weights)
    }

    fn slopes(self, outer: &HeldProfile<'_, '_>) -> DVector<f64> {
        let here = self.slopes_at(outer, &self.means.fit.sought, &Population::from(outer.estimate));
        here.unwrap_or_else(|| DVector::zeros(outer.slots.len()))
    }

    fn slopes_at(self, outer: &HeldProfile<'_, '_>, values: &[f64], there: &Population) -> Option<DVector<f64>> {
        let slope = |&s: &usize| {
            let coordinate = &outer.objective.coordinates[s];
            let step = coordinate.step(values[s], STEP);
            let side = |sign: f64| {
                let mut values = values.to_vec();
                values[s] = coordinate.moved(values[s], sign * step);
                Some((coordinate.of_value(values[s]), self.at(&outer.objective.alpha(&values))?.value(there)))
            };
            let ((below, low), (above, high)) = (side(-1.0)?, side(1.0)?);
            Some(if above > below { (high - low) / (above - below) } else { 0.0 })
        };
        let all: Vec<f64> = outer.slots.iter().map(slope).collect::<Option<_>>()?;
        Some(DVector::from_vec(all))
    }
}
