//! Profile-likelihood intervals of α: where the best ℓ with one value held is χ²₁'s 95 % quantile, halved, below the maximum.

use statrs::distribution::{ContinuousCDF, Normal};

use crate::dynamic::bench::{Bench, Solved};
use crate::dynamic::covariances::Covariances;
use crate::dynamic::explore;
use crate::dynamic::iterate::{End, Search};
use crate::dynamic::{DynamicError, DynamicFit, ParameterInference, Standing};
use crate::estimate::Silent;
use crate::infer::Interval;
use crate::model::Population;

/// Tries to meet the quantile.
const TRIES: usize = 20;
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

/// Profile intervals in the place of Wald's, at values that the data determine and at those on a bound.
pub(crate) fn profiles(
    bench: &Bench<'_>,
    fit: &DynamicFit,
    covariances: &Covariances,
    parameters: &mut [ParameterInference],
) -> Result<(), DynamicError> {
    if fit.values.len() > MOST_PROFILED {
        return Ok(());
    }
    let near = Population::from(&fit.estimate);
    let best = bench.solve(&fit.sought, Some(&near))?;
    for (slot, parameter) in parameters.iter_mut().enumerate() {
        let is_open = matches!(parameter.standing, Standing::Inside | Standing::Lower | Standing::Upper);
        if is_open && !bench.edges.has(slot) {
            parameter.interval = profile(bench, &best, slot, covariances.alpha[slot].map(f64::sqrt));
        }
    }
    Ok(())
}

/// The interval of the value in a slot; `error` is the standard error of its coordinate. An end is `None` where no value is
/// unlikely enough.
pub(crate) fn profile(bench: &Bench<'_>, best: &Solved, slot: usize, error: Option<f64>) -> Interval {
    let end = |sign: f64| limit(bench, best, slot, sign, error.unwrap_or(0.5));
    Some([end(-1.0), end(1.0)])
}

/// One end: the signed root of the deviance is nearly linear in the coordinate, so that secants meet it in a few tries.
fn limit(bench: &Bench<'_>, best: &Solved, slot: usize, sign: f64, error: f64) -> Option<f64> {
    let wanted = Normal::standard().inverse_cdf(0.975);
    let (coordinate, value) = (bench.coordinates[slot], best.values[slot]);
    let bound = if sign < 0.0 { coordinate.lower } else { coordinate.upper };
    if value == bound {
        return Some(bound);
    }
    // from zero no logarithm leads away: begin where nothing can be felt yet
    let value = if coordinate.log && value == 0.0 { TRACE * scale(best) } else { value };
    let (mut inner, mut outer): ((f64, f64), Option<(f64, f64)>) = ((0.0, 0.0), None);
    let mut distance = wanted * error;
    let mut near = best.clone();
    for _ in 0..TRIES {
        if coordinate.log {
            distance = distance.min(inner.0 + STRIDE);
        }
        let tried = coordinate.moved(value, sign * distance);
        let at_bound = tried == bound;
        let root_at = |home: &Solved| (2.0 * (best.value() - home.value())).max(0.0).sqrt();
        let mut root = f64::INFINITY;
        if let Some(mut end) = held(bench, &near, slot, tried) {
            if (root_at(&end.home) - wanted).abs() <= NEAR {
                end = explore::around(bench, end, slot); // ℓ may be higher elsewhere
            }
            root = root_at(&end.home);
            near = end.home;
        }
        if (root - wanted).abs() <= NEAR {
            return Some(tried);
        }
        if root < wanted {
            if at_bound {
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
        distance = match outer {
            Some((far, root)) if root.is_finite() => {
                let secant = inner.0 + (far - inner.0) * (wanted - inner.1) / (root - inner.1);
                secant.clamp(inner.0 + 0.05 * (far - inner.0), inner.0 + 0.95 * (far - inner.0))
            }
            Some((far, _)) => 0.5 * (inner.0 + far),
            None if inner.1 > 0.1 * wanted => inner.0 * (1.02 * wanted / inner.1).min(3.0),
            None => 3.0 * inner.0,
        };
    }
    outer.map(|(far, _)| coordinate.moved(value, sign * 0.5 * (inner.0 + far)))
}

/// The largest of the values.
fn scale(best: &Solved) -> f64 {
    let largest = best.values.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    if largest > 0.0 { largest } else { 1.0 }
}

/// The best ℓ with a value held.
fn held(bench: &Bench<'_>, near: &Solved, slot: usize, value: f64) -> Option<End> {
    let mut values = near.values.clone();
    values[slot] = value;
    let population = Population::from(&near.estimate);
    let home = bench.solve(&values, Some(&population)).ok()?;
    let mut silent = Silent;
    let mut search = Search::new(bench, &mut silent, home);
    search.hold(slot);
    let end = search.run().ok()?;
    debug_assert!(end.home.values[slot] == value, "a held value stays");
    Some(end)
}
