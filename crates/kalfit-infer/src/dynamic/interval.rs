//! Profile-likelihood intervals of α, with ends where ℓ_max with one value held is half the 95 % quantile of χ²₁ below
//! the maximum.
//!
//! ℓ_max is taken on the highest branch: searches from other ends, and around an end, come before a value counts as
//! unlikely.

use crate::dynamic::branches::{END_TOLERANCE, highest, others, others_of_value};
use crate::{Held, Holds, Profile, QUANTILE, SharedProgress};
use kalfit_model::Labels;
use kalfit_model::Population;
use kalfit_search::ValueCovariances;
use kalfit_search::alike;
use kalfit_search::explore;
use kalfit_search::slot_name;
use kalfit_search::{DynamicError, DynamicFit, ParameterInference, Standing};
use kalfit_search::{ProfileLikelihood, ProfilePoint};
use kalfit_search::{SearchEnd, SearchState};

/// Distance of a logarithm from the maximum at which an interval is open.
const OPEN_DISTANCE: f64 = 25.0;
/// Value, as a fraction of the size that the data suggest, that replaces a value at zero.
const SMALLEST_START: f64 = 1e-6;
/// Longest first step of a logarithm.
const MAX_FIRST_STEP: f64 = 3.0;

/// Largest number of free values whose intervals are profiled; with more values all intervals are Wald intervals.
pub const MOST_PROFILED: usize = 40;

/// Replaces Wald intervals by profile intervals for the values that the data determine and the values on a bound.
/// Returns the number of these values that keep Wald intervals: covariances of noises, which move with the variances of
/// the noises, or all for more than [`MOST_PROFILED`] values.
pub(crate) fn profiles(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    covariances: &ValueCovariances,
    parameters: &mut [ParameterInference],
    (labels, progress): (&Labels, &SharedProgress<'_>),
) -> Result<usize, DynamicError> {
    let is_open = |parameter: &ParameterInference| {
        matches!(parameter.standing, Standing::Inside | Standing::Lower | Standing::Upper)
    };
    if fit.values.len() > MOST_PROFILED {
        return Ok(parameters.iter().filter(|parameter| is_open(parameter)).count());
    }
    let mut wald_count = 0;
    let near = Population::from(&fit.estimate);
    let best = objective.solve(&fit.sought, Some(&near))?;
    let others = others(objective, fit);
    for (slot, parameter) in parameters.iter_mut().enumerate() {
        if is_open(parameter) && objective.edges.has(slot) {
            wald_count += 1;
        } else if is_open(parameter) {
            let error = covariances.alpha[slot].map(f64::sqrt);
            let others = others_of_value(objective, (&best.values, &others), slot);
            let name = slot_name(objective.model.shared(), labels, objective.slots, slot);
            parameter.interval = Some(HeldValue::new((objective, &best), slot, progress).ends(name, others, error));
        }
    }
    Ok(wald_count)
}

/// The value in a slot, held at a distance, in the coordinate of the slot, from the value at the maximum of ℓ. If the
/// value at the maximum is zero and the coordinate a logarithm, distances start at a value too small to affect ℓ.
struct HeldValue<'b, 'a, 'p> {
    objective: &'b ProfileLikelihood<'a>,
    best: &'b ProfilePoint,
    slot: usize,
    /// Value from which distances of the held value are measured.
    from: f64,
    progress: &'b SharedProgress<'p>,
}

/// The best point with the value held, and points on other branches.
#[derive(Clone)]
struct Branch {
    iterate: ProfilePoint,
    others: Vec<Vec<f64>>,
    /// The branch was not known before.
    is_new: bool,
}

impl Holds for HeldValue<'_, '_, '_> {
    const PRECISION: f64 = 1e-4;
    const ATTAINS_LIMITS: bool = true;
    type What = ();
    type Near = Branch;

    fn held(&self, (): (), way: f64, near: &Branch) -> Option<Held<Branch>> {
        let found = self.highest(near, self.objective.coordinates[self.slot].moved(self.from, way));
        // where ℓ is not defined, the value is rejected: ℓ counts as -∞
        let nowhere = || Held { value: f64::NEG_INFINITY, slope: 0.0, near: near.clone() };
        let held = |found: Branch| Held {
            value: found.iterate.value(),
            slope: found.iterate.gradient[self.slot],
            near: found,
        };
        Some(found.map_or_else(nowhere, held))
    }

    fn is_on_new_branch(near: &Branch) -> bool {
        near.is_new
    }
}

impl<'b, 'a, 'p> HeldValue<'b, 'a, 'p> {
    fn new(
        (objective, best): (&'b ProfileLikelihood<'a>, &'b ProfilePoint),
        slot: usize,
        progress: &'b SharedProgress<'p>,
    ) -> HeldValue<'b, 'a, 'p> {
        let value = best.values[slot];
        let from = if objective.coordinates[slot].log && value == 0.0 {
            SMALLEST_START * objective.units()[slot]
        } else {
            value
        };
        HeldValue { objective, best, slot, from, progress }
    }

    /// Both ends; `error`: standard error of the coordinate, if known. `None` on a side where no value is unlikely
    /// enough.
    fn ends(&self, name: String, others: Vec<Vec<f64>>, error: Option<f64>) -> [Option<f64>; 2] {
        let coordinate = self.objective.coordinates[self.slot];
        let (far, longest) =
            if coordinate.log { (OPEN_DISTANCE, MAX_FIRST_STEP) } else { (f64::INFINITY, f64::INFINITY) };
        let bounds = [coordinate.lower, coordinate.upper];
        let way = |bound: f64| (coordinate.of_value(bound) - coordinate.of_value(self.from)).clamp(-far, far);
        let limits = bounds.map(|bound| Some(way(bound)).filter(|limit| limit.is_finite()));
        let maximum = self.best.value();
        let (centre, quantile, progress) = (0.0, QUANTILE, self.progress);
        let profile = Profile { holder: self, what: (), name, centre, maximum, quantile, limits, progress };
        let start = Branch { iterate: self.best.clone(), others, is_new: false };
        let one = |(side, sign): (usize, f64)| {
            let bound = bounds[side];
            if self.best.values[self.slot] == bound {
                return Some(bound);
            }
            match profile.end(&start, sign * self.first_step(error).min(longest))? {
                // all values down to zero, or up to infinity, are likely enough
                end if limits[side] == Some(end) => Some(bound).filter(|bound| bound.is_finite()),
                end => Some(coordinate.moved(self.from, end)),
            }
        };
        [(0, -1.0), (1, 1.0)].map(one)
    }

    /// Approximate distance of an end: from the standard error, or at a bound from the slope of ℓ at the bound.
    fn first_step(&self, error: Option<f64>) -> f64 {
        let slope = self.best.gradient[self.slot].abs();
        match error {
            Some(error) => QUANTILE * error,
            None if !self.objective.coordinates[self.slot].log && slope > 0.0 => 0.5 * QUANTILE * QUANTILE / slope,
            None => 0.5 * QUANTILE,
        }
    }

    /// The best point with the value held at `tried`: by a search from nearby, from other ends where the maximum is too
    /// low, and around the maximum where ζ is close to the quantile.
    fn highest(&self, near: &Branch, held_value: f64) -> Option<Branch> {
        let from = |values: &[f64]| self.held_from(&near.iterate, values, held_value);
        let at = |root: f64| self.best.value() - 0.5 * root * root;
        let value = |end: &SearchEnd| end.iterate.value();
        let likely = at(QUANTILE - Self::PRECISION);
        let end = highest(from(&near.iterate.values), &near.others, (value, likely), from)?;
        let mut others = near.others.clone();
        if value(&end) > likely || value(&end) < at(QUANTILE + Self::PRECISION) {
            return Some(Branch { iterate: end.iterate, others, is_new: false });
        }
        let start_values = end.iterate.values.clone();
        let mut progress = self.progress;
        // close to the quantile, a higher maximum around the end would change the interval
        let iterate = explore::around(self.objective, end, self.slot, &mut progress).iterate;
        let is_new = !alike(&start_values, &iterate.values, END_TOLERANCE);
        if is_new {
            others.push(iterate.values.clone());
        }
        Some(Branch { iterate, others, is_new })
    }

    /// The end of a search with the value held at `tried`, from a start at `values`.
    fn held_from(&self, near: &ProfilePoint, values: &[f64], held_value: f64) -> Option<SearchEnd> {
        let mut values = values.to_vec();
        values[self.slot] = held_value;
        let population = Population::from(&near.estimate);
        let iterate = self.objective.solve(&values, Some(&population)).ok()?;
        let mut progress = self.progress;
        let mut search = SearchState::new(self.objective, &mut progress, iterate);
        search.hold(self.slot);
        let end = search.run().ok()?;
        debug_assert!(end.iterate.values[self.slot] == held_value, "a held value stays");
        Some(end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamic::branches::INTERVAL_LOSS;
    use kalfit_estimate::Silent;
    use kalfit_fixtures::bench::{twins, with_processes};
    use kalfit_model::Slots;
    use kalfit_search::{Settings, fit};

    #[test]
    fn exchangeable_values_have_one_profile() {
        let model = twins();
        let tests = with_processes(&[(1.0, 0.5), (30.0, 1.5)], 0.02, (16, 24));
        let labels = Labels::new(&model.shared().literals);
        let (settings, slots) = (Settings::default(), Slots::in_phases(&model, &labels, &tests));
        let fit = fit(&model, &labels, &tests, &settings, &mut Silent).expect("a fit");
        let objective = ProfileLikelihood::new(&model, &tests, &slots, &settings);
        let best = objective.solve(&fit.sought, None).expect("defined");
        let others = others(&objective, &fit);
        let mut silent = Silent;
        let progress = SharedProgress::new(&mut silent, None);
        let profile = |slot: usize, value: f64| {
            let others = others_of_value(&objective, (&best.values, &others), slot);
            let start = Branch { iterate: best.clone(), others, is_new: false };
            let found = HeldValue::new((&objective, &best), slot, &progress).highest(&start, value).expect("defined");
            best.value() - found.iterate.value()
        };
        let (mut likely, mut unlikely) = (0, 0);
        for (a, b) in [(0, 2), (1, 3)] {
            let between = |part: f64| fit.values[a] * (fit.values[b] / fit.values[a]).powf(part);
            for value in [-0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5].map(between) {
                let (one, other) = (profile(a, value), profile(b, value));
                // where ℓ is high enough, no other branches are tried
                let (least, most) = (one.min(other), one.max(other));
                let same = most - least < 1e-6;
                assert!(same || most < INTERVAL_LOSS, "{a} and {b} at {value}: ℓ falls by {one} and {other}");
                (likely, unlikely) = if most < INTERVAL_LOSS { (likely + 1, unlikely) } else { (likely, unlikely + 1) };
            }
        }
        assert!(likely >= 4 && unlikely >= 2, "{likely} and {unlikely}");
    }
}
