//! A search in which coefficients are solved for, not searched.
//!
//! Coefficients (see [`CoefficientsAsStates`]) are means of states in an equivalent model. The search for all other
//! parameters runs on that model, where generalised least squares gives the coefficients at every α; one search of the
//! given model from the end found there certifies all parameters together. Under the restricted likelihood, which
//! integrates out means and not parameters, the end is a start nearby.

use crate::fit::{AllEnds, Ends, all_ends, best_end, raise_free_zeros};
use crate::profile_likelihood::ProfileLikelihood;
use crate::record::{SearchStage, Stages};
use crate::search_state::{SearchEnd, SearchState};
use crate::{DynamicError, Explored, Method, OtherEnd, exchangeable, unbounded};
use kalfit_estimate::{Criterion, Progress, Stop};
use kalfit_model::{CoefficientsAsStates, Evidence, Population, Slots};
use nalgebra::DMatrix;

/// Loss of ℓ, relative to ℓ, up to which the end of the certifying search is the end that was found.
const ROUNDING: f64 = 1e-9;

/// The coefficients of a model, and the free values that remain.
struct Coefficients {
    found: CoefficientsAsStates,
    slots: Slots,
}

impl Coefficients {
    fn of(objective: &ProfileLikelihood<'_>) -> Option<Coefficients> {
        let is_rows = |evidence: &Evidence| matches!(evidence, Evidence::Rows(_));
        let has_rows = objective.tests.iter().all(|test| test.phases.iter().all(is_rows));
        if objective.settings.method != Method::Hybrid || !has_rows {
            return None;
        }
        let found = objective.model.with_coefficients_as_states()?;
        let slots = objective.slots.without(&found.parameters);
        Some(Coefficients { found, slots })
    }

    /// The values of `objective` and (μ, Σ) at an end of the search without coefficients; `None` where a coefficient is
    /// beyond its bounds.
    fn at(
        &self,
        objective: &ProfileLikelihood<'_>,
        alone: &ProfileLikelihood<'_>,
        end: &SearchEnd,
    ) -> Option<(Vec<f64>, Population)> {
        let (values, population) = (alone.values(&end.iterate.values), Population::from(&end.iterate.estimate));
        let all = self.found.model.dimension();
        let p = all - self.found.parameters.len();
        let one = |(s, slot): (usize, &kalfit_model::Slot)| {
            if let Some(own) = self.slots.slots().iter().position(|other| other == slot) {
                return Some(values[own]);
            }
            let at = self.found.parameters.iter().position(|&parameter| parameter == slot.parameter)?;
            let value = population.mean[p + at];
            (objective.coordinates[s].within_bounds(value) == value).then_some(value)
        };
        let values: Vec<f64> = objective.slots.slots().iter().enumerate().map(one).collect::<Option<_>>()?;
        // of each level, the states without the coefficients
        let kept: Vec<usize> = (0..population.mean.len()).filter(|k| k % all < p).collect();
        let part = Population {
            mean: kept.iter().map(|&k| population.mean[k]).collect(),
            coefficients: population.coefficients.clone(),
            covariance: DMatrix::from_fn(kept.len(), kept.len(), |i, j| population.covariance[(kept[i], kept[j])]),
        };
        Some((objective.sought(&values), part))
    }
}

/// The ends of all searches with coefficients solved for, the best certified one first; `None` where the model has no
/// coefficients, or the given model must be searched after all.
pub(crate) fn ends(
    objective: &ProfileLikelihood<'_>,
    progress: &mut dyn Progress,
) -> Result<Option<Ends>, DynamicError> {
    let Some(coefficients) = Coefficients::of(objective) else { return Ok(None) };
    let alone =
        ProfileLikelihood::new(&coefficients.found.model, objective.tests, &coefficients.slots, objective.settings);
    let found = best_alone(&alone, progress);
    objective.add_counts(&alone);
    let Some(Alone { best, ends, explored, mut stages }) = found else { return Ok(None) };
    let Some((values, near)) = coefficients.at(objective, &alone, &best) else { return Ok(None) };
    let is_restricted = objective.settings.inner.criterion == Criterion::Reml;
    let certified = stages.run(objective, SearchStage::Certificate, || {
        let iterate = objective.solve(&values, Some(&near))?;
        let search = SearchState::new(objective, progress, iterate).with_origin(best.origin);
        if is_restricted { search.run() } else { search.near_its_end().run() }
    });
    let mut end = certified?;
    let slot = |s: &usize| objective.slots.slots().iter().position(|slot| *slot == coefficients.slots.slots()[*s]);
    end.returned.extend(best.returned.iter().filter_map(slot));
    end.returned.sort_unstable();
    end.returned.dedup();
    let least = best.iterate.value() - ROUNDING * best.iterate.value().abs().max(1.0);
    if end.stop != Stop::Certified || !(is_restricted || end.iterate.value() >= least) {
        return Ok(None);
    }
    let mapped = |other: SearchEnd| {
        let (values, _) = coefficients.at(objective, &alone, &other)?;
        Some(OtherEnd {
            log_likelihood: other.iterate.value(),
            values: objective.values(&exchangeable::aligned(&objective.twins, &values, &end.iterate.values)),
            stop: other.stop,
            given_up: other.given_up,
        })
    };
    let others = ends.into_iter().filter_map(mapped).collect();
    Ok(Some(Ends { best: end, others, explored, stages, unbounded: Vec::new() }))
}

/// The ends of the search of a model without coefficients.
struct Alone {
    /// The certified best end.
    best: SearchEnd,
    /// The other ends.
    ends: Vec<SearchEnd>,
    explored: Explored,
    stages: Stages,
}

/// The ends of the search of a model without coefficients; `None` where there is no certified end, or ℓ is unbounded.
fn best_alone(alone: &ProfileLikelihood<'_>, progress: &mut dyn Progress) -> Option<Alone> {
    let AllEnds { mut ends, explored, mut stages, .. } = all_ends(alone, progress).ok()?;
    let at = best_end(&ends)?;
    if ends[at].stop != Stop::Certified || unbounded::find(alone, &ends, at).is_some() {
        return None;
    }
    let best = ends.remove(at);
    let best = stages.run(alone, SearchStage::Certificate, || raise_free_zeros(alone, best, progress));
    Some(Alone { best, ends, explored, stages })
}
