//! Other parameters that the estimates of a fit may stand for, drawn by the law of the estimates.
//!
//! An error δ of Σ is drawn from the normal law of the estimates, and Σ becomes Σ^½ exp(Σ^-½ δ Σ^-½) Σ^½: positive
//! semidefinite, of the rank of Σ, and Σ + δ to first order. Positive parameters are drawn in logarithms.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use kalfit_algebra::symmetric;
use kalfit_infer::dynamic::UnitInformation;
use kalfit_infer::{Estimand, Estimated, Knowledge};
use kalfit_model::{Alpha, Level, Population, Slots};

/// Directions of Σ, scaled to unit diagonal, with less than this share of the largest eigenvalue are rounding of a singular Σ:
/// draws leave them zero.
const LEAST_EIGENVALUE: f64 = 1e-12;

/// Free values of α, and (μ, Σ).
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnParameters {
    /// The free values of α, by slot.
    pub values: Vec<f64>,
    /// μ, coefficients and Σ.
    pub population: Population,
}

impl DrawnParameters {
    /// α with these free values.
    pub fn alpha(&self, about: &Alpha, slots: &Slots) -> Alpha {
        let mut alpha = about.clone();
        for (slot, value) in slots.slots().iter().zip(&self.values) {
            alpha.values[slot.parameter] = Level::Common(*value);
        }
        alpha
    }
}

/// Draws of the parameters about those of `candidates`; the same seed gives the same draws.
pub fn drawn(
    knowledge: &Knowledge,
    slots: &Slots,
    candidates: &UnitInformation,
    (count, seed): (usize, u64),
) -> Vec<DrawnParameters> {
    let root = symmetric::square_root(&knowledge.covariance);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let one = |_| {
        let normal: Vec<f64> = (0..root.ncols()).map(|_| StandardNormal.sample(&mut random)).collect();
        moved(knowledge, slots, candidates, &(&root * DVector::from_vec(normal)))
    };
    (0..count).map(one).collect()
}

/// The parameters after errors of the estimates.
fn moved(knowledge: &Knowledge, slots: &Slots, candidates: &UnitInformation, errors: &DVector<f64>) -> DrawnParameters {
    let mut population = candidates.population().clone();
    let mut values: Vec<f64> = (0..candidates.values()).map(|slot| candidates.value_of(slot)).collect();
    let mut error_of_sigma = DMatrix::zeros(population.covariance.nrows(), population.covariance.ncols());
    for (known, &error) in knowledge.quantities.iter().zip(errors.iter()) {
        match known {
            Estimand::Population(Estimated::Mean(i)) if *i < population.mean.len() => population.mean[*i] += error,
            Estimand::Population(Estimated::Coefficient(c)) => population.coefficients[*c] += error,
            Estimand::Population(Estimated::Covariance(i, j)) => {
                (error_of_sigma[(*i, *j)], error_of_sigma[(*j, *i)]) = (error, error);
            }
            Estimand::Parameter { parameter, level: None } => {
                if let Some(slot) = slots.common(*parameter) {
                    values[slot] = candidates.value_after(slot, error);
                }
            }
            Estimand::Population(_) | Estimand::Parameter { .. } => {}
        }
    }
    population.covariance = exponential(&population.covariance, &error_of_sigma);
    DrawnParameters { values, population }
}

/// Σ^½ exp(Σ^-½ δ Σ^-½) Σ^½ on the range of Σ.
fn exponential(sigma: &DMatrix<f64>, error: &DMatrix<f64>) -> DMatrix<f64> {
    let sizes: Vec<f64> = sigma.diagonal().iter().map(|x| x.max(0.0).sqrt()).collect();
    let scaled = |matrix: &DMatrix<f64>, by: &dyn Fn(f64) -> f64| {
        DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| by(sizes[i]) * matrix[(i, j)] * by(sizes[j]))
    };
    let reciprocal = |size: f64| if size > 0.0 { size.recip() } else { 0.0 };
    let (values, vectors) = symmetric::eigen(&scaled(sigma, &reciprocal));
    let largest = values.iter().copied().fold(0.0, f64::max);
    let kept: Vec<usize> = (0..values.len()).filter(|&k| values[k] > LEAST_EIGENVALUE * largest).collect();
    let along = |power: f64| {
        let mut root = vectors.select_columns(&kept);
        root.column_iter_mut().zip(&kept).for_each(|(mut column, &k)| column *= values[k].powf(power));
        root
    };
    let (root, inverse) = (along(0.5), along(-0.5));
    let inside = inverse.transpose() * scaled(error, &reciprocal) * inverse;
    let (logs, directions) = symmetric::eigen(&inside);
    let mut moved = root * directions;
    moved.column_iter_mut().zip(logs.iter()).for_each(|(mut column, log)| column *= (0.5 * log).exp());
    scaled(&(&moved * moved.transpose()), &|size| size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_fixtures::near;

    #[test]
    fn a_small_error_is_added_and_a_large_one_leaves_sigma_semidefinite() {
        let sigma = DMatrix::from_row_slice(3, 3, &[2.0, 0.6, 0.0, 0.6, 0.5, 0.0, 0.0, 0.0, 0.0]);
        let error = DMatrix::from_row_slice(3, 3, &[0.3, -0.2, 0.0, -0.2, 0.1, 0.0, 0.0, 0.0, 0.0]);
        let near_by = exponential(&sigma, &(&error * 1e-6));
        near::matrices("to first order", &((near_by - &sigma) * 1e6), &error, 1e-5);
        let far = exponential(&sigma, &(&error * -20.0));
        assert!(far.symmetric_eigenvalues().min() > -1e-12 && far[(2, 2)] == 0.0, "{far}");
        near::matrices("no error", &exponential(&sigma, &DMatrix::zeros(3, 3)), &sigma, 1e-13);
        let diagonal = DMatrix::from_diagonal(&DVector::from_vec(vec![4.0, 1e-8]));
        let moved = exponential(&diagonal, &DMatrix::from_diagonal(&DVector::from_vec(vec![4.0, -1e-8])));
        near::relative("e times", moved[(0, 0)], 4.0 * 1f64.exp(), 1e-12);
        near::relative("1/e times", moved[(1, 1)], 1e-8 / 1f64.exp(), 1e-12);
    }
}
