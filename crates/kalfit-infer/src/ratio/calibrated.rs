//! The quantiles of likelihood ratios of single quantities, from ensembles drawn from an estimate: profile intervals
//! with these quantiles hold with few tests too (theory §14).

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::held::Holder;
use crate::holdable::Holdable;
use crate::interval::{QUANTILE, value};
use crate::progress::SharedProgress;
use crate::ratio::bootstrap::{Draw, certified, replicates};
use kalfit_estimate::Estimate;
use kalfit_filter::reduce::Reductions;
use kalfit_model::Population;

/// Number of ensembles; the quantile of 95 % is then the 190th of 199 statistics.
const REPLICATES: usize = 199;
/// Seed of ChaCha8; ensemble b is drawn from stream b.
const SEED: u64 = 1;
/// Fewest ensembles with a statistic from which a quantile is taken.
const LEAST_FOUND: usize = 100;

/// For each quantity the root of the 95 % quantile of its likelihood ratio at the estimate; that of many
/// tests where too few ensembles have such a ratio. `None` once `progress` stops.
pub(crate) fn quantiles(
    estimate: &Estimate,
    reductions: &Reductions,
    wanted: &[Holdable],
    progress: &SharedProgress<'_>,
) -> Option<Vec<f64>> {
    let all: Vec<usize> = (0..estimate.coefficients.len()).collect();
    let draw = Draw::new(estimate, reductions, &all);
    let truth = Population::from(estimate);
    let ratios = |b: usize| -> Vec<Option<f64>> {
        let mut random = ChaCha8Rng::seed_from_u64(SEED);
        random.set_stream(b as u64);
        let drawn = certified(&estimate.state, &draw.ensemble(&mut random), &truth);
        wanted.iter().map(|&what| ratio(drawn.as_ref()?, what, value(estimate, what)?)).collect()
    };
    let found = replicates(REPLICATES, ratios, &mut |_| !progress.stops())?;
    let quantile = |k: usize| {
        let mut own: Vec<f64> = found.iter().filter_map(|ratios| ratios[k]).collect();
        own.sort_by(f64::total_cmp);
        let place = (0.95 * (own.len() + 1) as f64).ceil() as usize;
        let at = own.get(place.saturating_sub(1)).filter(|_| own.len() >= LEAST_FOUND);
        at.map_or(QUANTILE, |ratio| ratio.sqrt())
    };
    Some((0..wanted.len()).map(quantile).collect())
}

/// 2(ℓ_max - ℓ_max(x)) of one ensemble, with `what` held at x.
fn ratio(drawn: &Estimate, what: Holdable, x: f64) -> Option<f64> {
    let state = &drawn.state;
    let held = Holder::new(state).maximum(what, x, &state.newton_iterate.point)?;
    let found = 2.0 * (state.newton_iterate.local.value - held.value);
    found.is_finite().then(|| found.max(0.0))
}
