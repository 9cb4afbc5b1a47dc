//! Profile-likelihood intervals of α: where the best ℓ with one value held is χ²₁'s 95 % quantile, halved, below the maximum.
//!
//! The best ℓ is that of the highest branch: other ends of the searches, and what is found around an end, are tried before a value is
//! called unlikely.

use statrs::distribution::{ContinuousCDF, Normal};

use crate::dynamic::branches::{ALIKE, others};
use crate::dynamic::coordinates::alike;
use crate::dynamic::covariances::ValueCovariances;
use crate::dynamic::explore;
use crate::dynamic::profile_likelihood::{ProfileLikelihood, ProfilePoint};
use crate::dynamic::search_state::{SearchEnd, SearchState};
use crate::dynamic::{DynamicError, DynamicFit, ParameterInference, Standing};
use crate::estimate::Silent;
use crate::model::Population;

/// Tries to meet the quantile.
const TRIES: usize = 30;
/// The deviance's root is met to this.
const NEAR: f64 = 1e-4;
/// A logarithm this far away has no limit there.
const FAR: f64 = 25.0;
/// A value at zero is followed from this part of the largest value.
const TRACE: f64 = 1e-6;
/// Logarithms move no further than this at once.
const STRIDE: f64 = 3.0;

/// Intervals of up to so many values are profiled; Wald's stand for those of more.
pub(crate) const MOST_PROFILED: usize = 40;

/// Profile intervals in the place of Wald's, at values that the data determine and at those on a bound; how many of those keep Wald's:
/// covariances of noises, which move with the variances beside them, and all where there are very many.
pub(crate) fn profiles(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    covariances: &ValueCovariances,
    parameters: &mut [ParameterInference],
) -> Result<usize, DynamicError> {
    let is_open = |parameter: &ParameterInference| {
        matches!(parameter.standing, Standing::Inside | Standing::Lower | Standing::Upper)
    };
    if fit.values.len() > MOST_PROFILED {
        return Ok(parameters.iter().filter(|parameter| is_open(parameter)).count());
    }
    let mut kept = 0;
    let near = Population::from(&fit.estimate);
    let best = objective.solve(&fit.sought, Some(&near))?;
    let others = others(objective, fit);
    for (slot, parameter) in parameters.iter_mut().enumerate() {
        if is_open(parameter) && objective.edges.has(slot) {
            kept += 1;
        } else if is_open(parameter) {
            let error = covariances.alpha[slot].map_or(0.5, f64::sqrt);
            let end =
                |sign: f64| IntervalSide { objective, best: &best, slot, sign, others: others.clone() }.limit(error);
            parameter.interval = Some([end(-1.0), end(1.0)]);
        }
    }
    Ok(kept)
}

/// One side of the interval of the value in a slot.
struct IntervalSide<'b, 'a> {
    objective: &'b ProfileLikelihood<'a>,
    best: &'b ProfilePoint,
    slot: usize,
    sign: f64,
    /// Places of other branches.
    others: Vec<Vec<f64>>,
}

/// A held value with the best ℓ beside it.
struct Tried {
    home: ProfilePoint,
    root: f64,
    /// It is on a branch that was not known before.
    new: bool,
}

impl IntervalSide<'_, '_> {
    /// The end on this side; `error` is the standard error of the coordinate. The signed root of the deviance is nearly linear in the
    /// coordinate, so that secants meet it in a few tries. `None` where no value is unlikely enough.
    fn limit(mut self, error: f64) -> Option<f64> {
        let (coordinate, value) = (self.objective.coordinates[self.slot], self.best.values[self.slot]);
        let (sign, wanted) = (self.sign, wanted());
        let bound = if sign < 0.0 { coordinate.lower } else { coordinate.upper };
        if value == bound {
            return Some(bound);
        }
        // from zero no logarithm leads away: begin where nothing can be felt yet
        let value = if coordinate.log && value == 0.0 { TRACE * scale(self.best) } else { value };
        let (mut inner, mut outer): ((f64, f64), Option<(f64, f64)>) = ((0.0, 0.0), None);
        let mut distance = wanted * error;
        // the last one within: a search from one too far may stay on a branch that is lower here
        let mut near = self.best.clone();
        for _ in 0..TRIES {
            if coordinate.log {
                distance = distance.min(inner.0 + STRIDE);
            }
            let tried = coordinate.moved(value, sign * distance);
            let mut root = f64::INFINITY;
            if let Some(found) = self.highest(&near, tried) {
                // what was too low on the branches known before need not be on this one
                outer = outer.filter(|_| !found.new);
                root = found.root;
                near = if root < wanted { found.home } else { near };
            }
            if (root - wanted).abs() <= NEAR {
                return Some(tried);
            }
            if root < wanted {
                if tried == bound {
                    return Some(bound);
                }
                if coordinate.log && distance >= FAR {
                    // every value down to zero, or up to infinity, may be
                    return (sign < 0.0).then_some(coordinate.lower);
                }
                inner = (distance, root);
            } else {
                outer = Some((distance, root));
            }
            distance = next(inner, outer);
        }
        outer.map(|(far, _)| coordinate.moved(value, sign * 0.5 * (inner.0 + far)))
    }

    /// The best ℓ with the value held here: from nearby, where that is too low from other ends, and at the quantile from around it.
    fn highest(&mut self, near: &ProfilePoint, tried: f64) -> Option<Tried> {
        let wanted = wanted();
        let root = |home: &ProfilePoint| (2.0 * (self.best.value() - home.value())).max(0.0).sqrt();
        let mut end = held(self.objective, near, &near.values, (self.slot, tried));
        for other in &self.others {
            if end.as_ref().is_some_and(|end| root(&end.home) < wanted - NEAR) {
                break;
            }
            let from = held(self.objective, near, other, (self.slot, tried));
            let value = |end: &Option<SearchEnd>| end.as_ref().map_or(f64::NEG_INFINITY, |end| end.home.value());
            end = if value(&from) > value(&end) { from } else { end };
        }
        let end = end?;
        if (root(&end.home) - wanted).abs() > NEAR {
            return Some(Tried { root: root(&end.home), home: end.home, new: false });
        }
        let before = end.home.values.clone();
        let end = explore::around(self.objective, end, self.slot); // ℓ may be higher elsewhere
        let new = !alike(&before, &end.home.values, ALIKE);
        let root = root(&end.home);
        if new {
            self.others.push(end.home.values.clone());
        }
        Some(Tried { root, home: end.home, new })
    }
}

/// Where the root of the deviance ends an interval.
fn wanted() -> f64 {
    Normal::standard().inverse_cdf(0.975)
}

/// The next distance to try, between (distance, root) of one that is likely and one that is not.
fn next(inner: (f64, f64), outer: Option<(f64, f64)>) -> f64 {
    match outer {
        Some((far, root)) if root.is_finite() => {
            let secant = inner.0 + (far - inner.0) * (wanted() - inner.1) / (root - inner.1);
            secant.clamp(inner.0 + 0.05 * (far - inner.0), inner.0 + 0.95 * (far - inner.0))
        }
        Some((far, _)) => 0.5 * (inner.0 + far),
        None if inner.1 > 0.1 * wanted() => inner.0 * (1.02 * wanted() / inner.1).min(3.0),
        None => 3.0 * inner.0,
    }
}

/// The largest of the values.
fn scale(best: &ProfilePoint) -> f64 {
    let largest = best.values.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    if largest > 0.0 { largest } else { 1.0 }
}

/// The best ℓ with a value held, from these values.
fn held(
    objective: &ProfileLikelihood<'_>,
    near: &ProfilePoint,
    values: &[f64],
    (slot, value): (usize, f64),
) -> Option<SearchEnd> {
    let mut values = values.to_vec();
    values[slot] = value;
    let population = Population::from(&near.estimate);
    let home = objective.solve(&values, Some(&population)).ok()?;
    let mut silent = Silent;
    let mut search = SearchState::new(objective, &mut silent, home);
    search.hold(slot);
    let end = search.run().ok()?;
    debug_assert!(end.home.values[slot] == value, "a held value stays");
    Some(end)
}
