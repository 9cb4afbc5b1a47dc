//! Populations of set-ups from which ensembles are drawn.

use kalfit::Population;
use nalgebra::DMatrix;

/// A population of independent states. `std_dev`: of the states of all phases, the tests' own first, then of each level of
/// groups, whose effects have no mean.
pub(crate) fn independent(mean: &[f64], coefficients: &[f64], std_dev: &[&[f64]]) -> Population {
    let all = std_dev.concat();
    let variance = |i: usize, k: usize| if i == k { all[i] * all[i] } else { 0.0 };
    Population {
        mean: [mean, &vec![0.0; all.len() - mean.len()]].concat(),
        coefficients: coefficients.to_vec(),
        covariance: DMatrix::from_fn(all.len(), all.len(), variance),
    }
}
