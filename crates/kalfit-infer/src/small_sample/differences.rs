//! First and second derivatives of whole reductions by free parameters, from differences.
//!
//! A step of 1 % in a logarithm to both sides, and one of 2 %, give derivatives of fourth order: relative errors of
//! 1e-9 in J, and of 1e-8 where rounding of λ = Σ log|S| is divided by the square of the step.

use std::collections::BTreeSet;

use nalgebra::DMatrix;

use crate::SharedProgress;
use crate::small_sample::NoDf;
use crate::small_sample::border::{Border, log_determinant};
use crate::small_sample::forest::Leaf;
use crate::small_sample::variances::{Variances, exponents};
use kalfit_estimate::Stop;
use kalfit_filter::reduce::Reductions;
use kalfit_search::{DynamicFit, ProfileLikelihood, Standing};

/// Step of a logarithm.
const STEP: f64 = 1e-2;
/// Step of any other value, in its standard errors.
const STEP_IN_ERRORS: f64 = 0.03;
/// Largest relative difference of derivatives of second and of fourth order.
const MAX_DIFFERENCE: f64 = 1e-2;
/// Most runs of the filters.
const MOST_RUNS: usize = 150;
/// Places of a stencil, in steps.
const PLACES: [f64; 4] = [-2.0, -1.0, 1.0, 2.0];

/// Reductions at the places of the stencils.
pub(crate) struct VarianceSlopes {
    pub(crate) variances: Variances,
    steps: Vec<f64>,
    /// Along each coordinate.
    along: Vec<[Reductions; 4]>,
    /// Along the sum of two coordinates a > b, in packed order without the diagonal; `None` where no test depends on
    /// both.
    across: Vec<Option<[Reductions; 4]>>,
}

/// The reductions about a fit from which derivatives by the free parameters follow; `None` where no parameter moves.
pub(crate) fn slopes(
    objective: &ProfileLikelihood<'_>,
    fit: &DynamicFit,
    errors: &[Option<f64>],
    progress: &SharedProgress<'_>,
) -> Result<Option<VarianceSlopes>, NoDf> {
    let moving = |s: &usize| matches!(fit.standing[*s], Standing::Inside | Standing::Unidentified);
    let slots: Vec<usize> = (0..fit.values.len()).filter(moving).collect();
    if slots.is_empty() {
        return Ok(None);
    }
    if fit.stop != Stop::Certified {
        return Err(NoDf::NotCertified);
    }
    let is_shared = |s: &usize| fit.joint.shared().contains(s);
    let is_suboptimal = objective.model.phases.iter().any(|phase| phase.filter.is_some());
    if is_suboptimal || !slots.iter().all(is_shared) || slots.iter().any(|&slot| objective.edges.has(slot)) {
        return Err(NoDf::Parameters);
    }
    let sigma = &fit.estimate.covariance;
    let structured = kalfit_search::matrix_derivatives(objective.model, &fit.alpha, &fit.slots, sigma);
    if slots.iter().any(|slot| structured.contains_key(slot)) {
        return Err(NoDf::Parameters);
    }
    let k = slots.len();
    if 4 * k > MOST_RUNS {
        return Err(NoDf::Size);
    }
    let variances = coordinates(objective, fit, slots);
    let step = |&s: &usize| match objective.coordinates[s].log {
        true => Some(STEP),
        false => errors[s].filter(|e| *e > 0.0 && e.is_finite()).map(|e| STEP_IN_ERRORS * e),
    };
    let steps: Vec<f64> = variances.slots.iter().map(step).collect::<Option<_>>().ok_or(NoDf::Parameters)?;
    let at = |moved: &[usize]| -> Result<[Reductions; 4], NoDf> {
        let one = |place: f64| -> Result<Reductions, NoDf> {
            if progress.stops() {
                return Err(NoDf::Stopped);
            }
            let mut sought = fit.sought.clone();
            for &a in moved {
                let (slot, step) = (variances.slots[a], place * steps[a]);
                let is_log = objective.coordinates[slot].log;
                sought[slot] = if is_log { sought[slot] * step.exp() } else { sought[slot] + step };
            }
            Ok(objective.reduce(&sought).map_err(|_| NoDf::Parameters)?.reductions)
        };
        let [a, b, c, d] = PLACES;
        Ok([one(a)?, one(b)?, one(c)?, one(d)?])
    };
    let along: Vec<[Reductions; 4]> = (0..k).map(|a| at(&[a])).collect::<Result<_, _>>()?;
    let depend: Vec<Vec<bool>> = along.iter().map(|places| dependent(&places[1], &places[2])).collect();
    let pairs: Vec<[usize; 2]> = (0..k).flat_map(|a| (0..a).map(move |b| [a, b])).collect();
    let meet = |[a, b]: [usize; 2]| depend[a].iter().zip(&depend[b]).any(|(one, other)| *one && *other);
    let runs = 4 * (k + pairs.iter().filter(|pair| meet(**pair)).count());
    if runs > MOST_RUNS {
        return Err(NoDf::Size);
    }
    let both = |pair: &[usize; 2]| if meet(*pair) { at(pair).map(Some) } else { Ok(None) };
    let across = pairs.iter().map(both).collect::<Result<_, _>>()?;
    Ok(Some(VarianceSlopes { variances, steps, along, across }))
}

/// Whether each test has another reduction at another of two places.
fn dependent(here: &Reductions, there: &Reductions) -> Vec<bool> {
    let differs = |j: usize| {
        here.constant(j) != there.constant(j) || here.factor(j) != there.factor(j) || here.data(j) != there.data(j)
    };
    (0..here.len()).map(differs).collect()
}

/// θ of the free values: variances where all are variances of noise.
fn coordinates(objective: &ProfileLikelihood<'_>, fit: &DynamicFit, slots: Vec<usize>) -> Variances {
    let parameter = |s: usize| fit.slots.slots()[s].parameter;
    let moving: BTreeSet<usize> = slots.iter().map(|&s| parameter(s)).collect();
    let powers = exponents(objective.model, &moving);
    // v = x^k, of the value x or of its logarithm: v' and v''/v'
    let of = |&s: &usize| {
        let (power, x) = (powers.as_ref()?.get(&parameter(s)).copied()?, fit.values[s]);
        match objective.coordinates[s].log {
            true => Some([power * x.powf(power), power]),
            false if power == 1.0 => Some([1.0, 0.0]),
            false => (x > 0.0).then(|| [power * x.powf(power - 1.0), (power - 1.0) / x]),
        }
    };
    let found: Option<Vec<[f64; 2]>> = slots.iter().map(of).collect();
    let linear = found.is_some();
    let by_coordinate = found.unwrap_or_else(|| vec![[1.0, 0.0]; slots.len()]);
    let value_by_coordinate = |s: usize| if objective.coordinates[s].log { fit.values[s] } else { 1.0 };
    let value_by_theta = slots.iter().zip(&by_coordinate).map(|(&s, [by, _])| value_by_coordinate(s) / by).collect();
    let power = |s: usize| powers.as_ref().and_then(|powers| powers.get(&parameter(s)).copied()).filter(|_| linear);
    let values = slots.iter().map(|&s| [fit.values[s], power(s).unwrap_or(0.0)]).collect();
    Variances { linear, by_coordinate, value_by_theta, values, slots }
}

impl VarianceSlopes {
    /// Number of parameters.
    pub(crate) fn len(&self) -> usize {
        self.steps.len()
    }

    /// A test with its derivatives by θ; `None` where they cannot be trusted.
    pub(super) fn leaf(&self, border: &Border<'_>, home: &Reductions, j: usize) -> Option<Leaf> {
        let number = |x: f64| DMatrix::from_element(1, 1, x);
        let of = |all: &Reductions| Some((border.of_test(all, j)?, number(log_determinant(all, j)?)));
        let (k, log) = of(home)?;
        let derivatives = |places: &[Reductions; 4]| -> Option<Derivatives> {
            let [a, b, c, d] = places;
            let (ways, logs): (Vec<_>, Vec<_>) = [of(a)?, of(b)?, of(c)?, of(d)?].into_iter().unzip();
            Some(Derivatives { first: slope(&ways, &k)?, second: bend(&ways, &k), log: bend(&logs, &log)[(0, 0)] })
        };
        let along: Vec<Derivatives> = self.along.iter().map(&derivatives).collect::<Option<_>>()?;
        let mut across = self.across.iter();
        let (mut leaf, n) =
            (Leaf { k: k.clone(), slopes: vec![], curvatures: vec![], log_curvatures: vec![] }, self.len());
        for a in 0..n {
            let (h, [by, ratio]) = (self.steps[a], self.variances.by_coordinate[a]);
            leaf.slopes.push(&along[a].first / (h * by));
            for b in 0..a {
                let Some(places) = across.next()? else {
                    leaf.curvatures.push(DMatrix::zeros(k.nrows(), k.ncols()));
                    leaf.log_curvatures.push(0.0);
                    continue;
                };
                let both = derivatives(places)?;
                let unit = (2.0 * h * by * self.steps[b] * self.variances.by_coordinate[b][0]).recip();
                leaf.curvatures.push((both.second - &along[a].second - &along[b].second) * unit);
                leaf.log_curvatures.push((both.log - along[a].log - along[b].log) * unit);
            }
            // d²/dv² = (d²/du² - v''/v' d/du)/v'²
            let unit = (h * by).powi(-2);
            leaf.curvatures.push((&along[a].second - &along[a].first * (ratio * h)) * unit);
            let log_slope = self.log_slope(&self.along[a], j)?;
            leaf.log_curvatures.push((along[a].log - log_slope * ratio * h) * unit);
        }
        Some(leaf)
    }

    /// dλ/dcoordinate × step.
    fn log_slope(&self, places: &[Reductions; 4], j: usize) -> Option<f64> {
        let [a, b, c, d] = places;
        let at = |all: &Reductions| log_determinant(all, j);
        Some((at(a)? - 8.0 * at(b)? + 8.0 * at(c)? - at(d)?) / 12.0)
    }
}

/// Derivatives along a stencil, by its step.
struct Derivatives {
    first: DMatrix<f64>,
    second: DMatrix<f64>,
    log: f64,
}

/// First derivative × step; `None` where the error of second order is large.
fn slope(at: &[DMatrix<f64>], home: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let narrow = (&at[2] - &at[1]) * 0.5;
    let wide = (&at[0] - &at[3] + (&at[2] - &at[1]) * 8.0) / 12.0;
    let off = (&narrow - &wide).amax();
    (off <= MAX_DIFFERENCE * wide.amax() + 1e-12 * home.amax()).then_some(wide)
}

/// Second derivative × step².
fn bend(at: &[DMatrix<f64>], home: &DMatrix<f64>) -> DMatrix<f64> {
    ((&at[1] + &at[2]) * 16.0 - &at[0] - &at[3] - home * 30.0) / 12.0
}
