//! Branches of a profile: ℓ_max with one value held is the highest of several local maxima, and the highest branch
//! changes with the held value.

use kalfit_search::DynamicFit;
use kalfit_search::ProfileLikelihood;
use kalfit_search::alike;
use kalfit_search::{ExchangeablePair, ordered};

/// Loss of ℓ beyond which an end of a search is outside every interval: half the 95 % quantile of χ²₁.
pub(super) const INTERVAL_LOSS: f64 = 1.9208;
/// Most ends of searches, besides the best end, that are used as starts.
const MAX_OTHERS: usize = 6;
/// Relative difference of values up to which two ends count as equal.
pub(super) const END_TOLERANCE: f64 = 1e-3;

/// Sought values at the other ends of the searches, from the highest end on: from such an end a profile may be higher
/// than from the best end.
pub(super) fn others(objective: &ProfileLikelihood<'_>, fit: &DynamicFit) -> Vec<Vec<f64>> {
    let least = fit.estimate.log_likelihood - INTERVAL_LOSS;
    let mut kept = vec![fit.sought.clone()];
    for end in fit.others.iter().filter(|end| end.log_likelihood >= least) {
        let sought = objective.sought(&end.values);
        if kept.len() <= MAX_OTHERS && !kept.iter().any(|other| alike(other, &sought, END_TOLERANCE)) {
            kept.push(sought);
        }
    }
    kept.split_off(1)
}

/// Starts on other branches for the value in a slot: the other ends, and all ends with the process of the value
/// exchanged with each exchangeable process. Exchanges that do not move the value are omitted, since such an exchange
/// leads to an equal profile.
pub(super) fn others_of_value(
    objective: &ProfileLikelihood<'_>,
    (best, others): (&[f64], &[Vec<f64>]),
    slot: usize,
) -> Vec<Vec<f64>> {
    let moves_value = |pair: &ExchangeablePair| pair.pairs.iter().any(|&(s, t)| s == slot || t == slot);
    let (own, rest): (Vec<ExchangeablePair>, Vec<_>) = objective.twins.iter().cloned().partition(moves_value);
    let place = |values: &[f64]| {
        let mut place = ordered(&rest, values);
        place[slot] = 0.0; // the value in `slot` is held, and so not compared
        place
    };
    let ends = std::iter::once(best).chain(others.iter().map(Vec::as_slice));
    let orders = ends.flat_map(|end| std::iter::once(end.to_vec()).chain(own.iter().map(|pair| pair.exchanged(end))));
    let (mut kept, mut seen) = (Vec::new(), vec![place(best)]);
    for values in orders {
        let place = place(&values);
        if kept.len() < MAX_OTHERS && !seen.iter().any(|other| alike(other, &place, END_TOLERANCE)) {
            kept.push(values);
            seen.push(place);
        }
    }
    kept
}

/// The highest of `nearby` and of the maxima that searches from the points `others` reach; no search follows once a
/// maximum is above `enough`.
pub(super) fn highest<T>(
    nearby: Option<T>,
    others: &[Vec<f64>],
    (value, enough): (impl Fn(&T) -> f64, f64),
    from: impl Fn(&[f64]) -> Option<T>,
) -> Option<T> {
    let height = |found: &Option<T>| found.as_ref().map_or(f64::NEG_INFINITY, &value);
    let mut best = nearby;
    for other in others {
        if height(&best) > enough {
            break;
        }
        let found = from(other);
        best = if height(&found) > height(&best) { found } else { best };
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::build::{constant, free, gauss_markov, measurement, name};
    use kalfit_model::{PhasedModel, Slots};
    use kalfit_search::Settings;

    #[test]
    fn each_process_comes_in_the_place_of_the_one_whose_value_is_held() {
        let model = kalfit_model::Model::builder("")
            .time("t")
            .state(constant("bias"))
            .state(gauss_markov("one", "tau1", "sigma1"))
            .state(gauss_markov("two", "tau2", "sigma2"))
            .state(gauss_markov("three", "tau3", "sigma3"))
            .measurement(measurement("y", name("bias") + name("one") + name("two") + name("three"), "noise"));
        let names = ["tau1", "sigma1", "tau2", "sigma2", "tau3", "sigma3", "noise"];
        let model: PhasedModel =
            names.into_iter().fold(model, |model, name| model.parameter(free(name))).build().unwrap();
        let (slots, settings) =
            (Slots::new(model.shared(), &kalfit_model::Labels::default(), &[]), Settings::default());
        let objective = ProfileLikelihood::new(&model, &[], &slots, &settings);
        let best = [1.0, 0.1, 2.0, 0.2, 3.0, 0.3, 0.9];
        let of = |others: &[Vec<f64>], slot: usize| others_of_value(&objective, (&best, others), slot);
        let (second, third) = (vec![2.0, 0.2, 1.0, 0.1, 3.0, 0.3, 0.9], vec![3.0, 0.3, 2.0, 0.2, 1.0, 0.1, 0.9]);
        assert_eq!(of(&[], 0), [second.clone(), third.clone()], "of the five other orders");
        assert_eq!(of(&[], 1), [second, third]);
        assert_eq!(of(&[], 6), Vec::<Vec<f64>>::new(), "an exchange leaves the noise where it is");
        // an end that differs only in the held value, or in the order of the rest, begins no other branch
        assert_eq!(of(&[vec![7.0, 0.1, 2.0, 0.2, 3.0, 0.3, 0.9]], 0).len(), 4, "it does in another place");
        assert_eq!(of(&[vec![1.0, 0.1, 3.0, 0.3, 2.0, 0.2, 0.9]], 0), of(&[], 0));
        let many: Vec<Vec<f64>> = (2..9).map(|k| best.iter().map(|x| f64::from(k) * x).collect()).collect();
        let kept = of(&many, 0);
        assert_eq!((kept.len(), &kept[2]), (MAX_OTHERS, &many[0]), "the highest first");
    }
}
