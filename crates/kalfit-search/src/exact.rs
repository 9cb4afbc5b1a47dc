//! Scores through exact measurements (theory §13): the derivatives by α of C and g in Cξ = g come from differences,
//! with the rest of a test and the law of ξ unchanged. The backward pass gives the rest of the score: there, exact
//! measurements are only a condition on ξ.

use rayon::prelude::*;

use crate::indirect::{Around, WEIGHTS, moved};
use kalfit_algebra::{log_determinant, whitened, whitener};
use kalfit_filter::reduce::{ReduceError, ReductionRef, Reductions};
use kalfit_filter::score::InitialLaw;
use kalfit_filter::score::{ExactConditional, Gradient, add};
use kalfit_model::PhasedTest;
use kalfit_model::unpack;
use nalgebra::DMatrix;

/// Adds the contributions of exact rows to the scores of their tests.
pub fn add_exact(
    around: &Around<'_>,
    values: &[f64],
    (reductions, law): (&Reductions, &InitialLaw),
    scores: &mut [Gradient],
) -> Result<(), ReduceError> {
    let numbers: Vec<usize> = (0..reductions.len()).filter(|&j| reductions.exact(j).is_some()).collect();
    if numbers.is_empty() {
        return Ok(());
    }
    let tests: Vec<PhasedTest> = numbers.iter().map(|&j| around.tests[j].clone()).collect();
    for slot in 0..values.len() {
        let results_at = |places: &[f64]| moved(around, values, (&[slot], places), |reducer| reducer.reduce(&tests));
        // most values do not affect exact rows
        let (one_step, _) = results_at(&[1.0])?;
        let is_same = |(k, &j): (usize, &usize)| one_step.iter().all(|there| there.exact(k) == reductions.exact(j));
        if numbers.iter().enumerate().all(is_same) {
            continue;
        }
        let (there, steps) = results_at(&WEIGHTS.map(|(sign, _)| sign))?;
        let slopes = |(k, &j): (usize, &usize)| {
            let home = reductions.get(j);
            let at = |there: &Reductions| value(ReductionRef { exact: there.exact(k), ..home }, law);
            let sum: f64 = there.iter().zip(WEIGHTS).map(|(there, (_, weight))| weight * at(there)).sum();
            (j, sum / steps[&slot])
        };
        let slopes: Vec<(usize, f64)> = numbers.par_iter().enumerate().map(slopes).collect();
        slopes.into_iter().for_each(|(j, slope)| add(&mut scores[j], &vec![(slot, slope)]));
    }
    Ok(())
}

/// ℓ of a test; under the restricted likelihood with -½ tr(X'WX), X a root of the covariance of μ_j, as in
/// [`moments`](kalfit_filter::score::Moments).
fn value(reduction: ReductionRef<'_>, law: &InitialLaw) -> f64 {
    let p = law.root.nrows();
    let (known, factor) = (ExactConditional::of(reduction, law), unpack(reduction.factor, p));
    let mean = known.mean(reduction, law);
    let lower = whitener(&(&factor * known.root(law)));
    let left = DMatrix::from_column_slice(p, 1, reduction.data) - &factor * DMatrix::from_columns(&[mean]);
    let own = reduction.constant - 0.5 * (log_determinant(&lower) + whitened(&lower, &left).norm_squared());
    let restricted = law.mean_root_of(reduction.covariates).map_or(0.0, |half| {
        let along = known.whitened(reduction, &half).map_or(0.0, |along| along.norm_squared());
        along + whitened(&lower, &(&factor * known.left(half))).norm_squared()
    });
    own + known.log_density(reduction, law) - 0.5 * restricted
}
