//! Multipliers that are not determined: at a singular Σ, combinations Λ of constraints with ΛΣ = 0 change no
//! first-order condition.
//!
//! The certificate needs *some* multipliers with -(G - Λ) ⪰ 0 on the null space of Σ. The undetermined combinations are
//! therefore chosen so that the largest eigenvalue of G - Λ on the null space is as small as possible. Where that
//! eigenvalue stays positive, the matrix P ⪰ 0 that proves the minimum is a direction in which Σ may grow within the
//! constraints, tr(PΛ) = 0.

use nalgebra::{DMatrix, DVector};

use crate::covariance::Constraint;
use crate::local::natural_sizes;
use kalfit_algebra::symmetric;

/// Number of gradient steps at each sharpness.
const STEPS_PER_SHARPNESS: usize = 80;
/// Sharpness of the smooth maximum of the eigenvalues, times the largest element of the matrix.
const SHARPNESS: [f64; 6] = [1.0, 4.0, 16.0, 64.0, 256.0, 1024.0];
/// Squared effect on F, in natural sizes, below which a combination counts as having none.
const ZERO_EFFECT: f64 = 1e-9;

/// Matrices Λ (p × p), combinations of the constraints, with ΛF = 0.
pub(crate) fn undetermined_multipliers(constraints: &[Constraint], root: &DMatrix<f64>) -> Vec<DMatrix<f64>> {
    let (p, n) = root.shape();
    let mut matrices: Vec<DMatrix<f64>> = constraints.iter().map(|c| matrix(c, p)).collect();
    if matrices.is_empty() {
        return Vec::new();
    }
    let sizes = natural_sizes(root);
    let unit = DMatrix::from_fn(p, n, |i, c| root[(i, c)] / sizes[i]);
    let mut effects = DMatrix::zeros(p * n, matrices.len());
    for (m, lambda) in matrices.iter_mut().enumerate() {
        let scaled = |matrix: &DMatrix<f64>| DMatrix::from_fn(p, p, |i, j| sizes[i] * matrix[(i, j)] * sizes[j]);
        *lambda /= scaled(lambda).norm();
        effects.column_mut(m).copy_from_slice((scaled(lambda) * &unit).as_slice());
    }
    let (values, vectors) = symmetric::eigen(&(effects.transpose() * &effects));
    let combined =
        |k: usize| matrices.iter().zip(vectors.column(k).iter()).fold(DMatrix::zeros(p, p), |sum, (m, v)| sum + m * *v);
    (0..values.len()).filter(|&k| values[k] <= ZERO_EFFECT).map(combined).collect()
}

fn matrix(constraint: &Constraint, p: usize) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(p, p);
    for &(i, j, x) in &constraint.terms {
        matrix[(i, j)] += 0.5 * x;
        matrix[(j, i)] += 0.5 * x;
    }
    matrix
}

/// (A - Σ t_m S_m, P): the matrix with its largest eigenvalue made as small as possible by the t_m, and the density
/// matrix P that proves the minimum.
pub(crate) fn minimise_largest_eigenvalue(
    a: &DMatrix<f64>,
    multiplier_matrices: &[DMatrix<f64>],
) -> (DMatrix<f64>, DMatrix<f64>) {
    let multiplier_matrices = orthonormal(multiplier_matrices);
    let mut best = a.clone();
    let mut proof = density(a, f64::INFINITY).1;
    if multiplier_matrices.is_empty() {
        return (best, proof);
    }
    let size = a.amax().max(f64::MIN_POSITIVE);
    let mut current = a.clone();
    let mut least = f64::INFINITY;
    for sharpness in SHARPNESS.map(|s| s / size) {
        for _ in 0..STEPS_PER_SHARPNESS {
            let (largest, p) = density(&current, sharpness);
            if largest < least {
                (least, best, proof) = (largest, current.clone(), p.clone());
            }
            let slopes: Vec<f64> = multiplier_matrices.iter().map(|s| p.component_mul(s).sum()).collect();
            multiplier_matrices.iter().zip(&slopes).for_each(|(s, slope)| current -= s * (slope / sharpness));
        }
    }
    (best, proof)
}

/// The largest eigenvalue, and exp(sharpness × A) scaled to trace one.
fn density(a: &DMatrix<f64>, sharpness: f64) -> (f64, DMatrix<f64>) {
    let (values, vectors) = symmetric::eigen(a);
    let largest = values.last().copied().unwrap_or(0.0);
    let weight = |v: &f64| if *v == largest { 1.0 } else { (sharpness * (v - largest)).exp() };
    let weights = DVector::from_iterator(values.len(), values.iter().map(weight));
    let weights = &weights / weights.sum();
    (largest, &vectors * DMatrix::from_diagonal(&weights) * vectors.transpose())
}

/// Matrices with the same span, orthonormal in tr(ST).
fn orthonormal(multiplier_matrices: &[DMatrix<f64>]) -> Vec<DMatrix<f64>> {
    let n = multiplier_matrices.len();
    let gram = DMatrix::from_fn(n, n, |a, b| multiplier_matrices[a].component_mul(&multiplier_matrices[b]).sum());
    let (values, vectors) = symmetric::eigen(&gram);
    let floor = values.last().copied().unwrap_or(0.0) * ZERO_EFFECT;
    (0..n)
        .filter(|&k| values[k] > floor && values[k] > 0.0)
        .map(|k| {
            let zero = DMatrix::zeros(multiplier_matrices[0].nrows(), multiplier_matrices[0].ncols());
            multiplier_matrices
                .iter()
                .zip(vectors.column(k).iter())
                .fold(zero, |sum, (s, v)| sum + s * (*v / values[k].sqrt()))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_eigenvalue_is_made_as_small_as_can_be() {
        // diag(3, -1) less t diag(1, -1): both are one at t = 2
        let a = DMatrix::from_diagonal(&DVector::from_column_slice(&[3.0, -1.0]));
        let s = DMatrix::from_diagonal(&DVector::from_column_slice(&[2.0, -2.0]));
        let (best, p) = minimise_largest_eigenvalue(&a, std::slice::from_ref(&s));
        let largest = *symmetric::eigen(&best).0.last().expect("two");
        assert!((largest - 1.0).abs() < 0.02, "{largest} 1");
        assert!(p.component_mul(&s).sum().abs() < 0.2, "{p}");
        // two directions that can make all three eigenvalues equal, in rotated axes
        let rotation = DMatrix::from_fn(3, 3, |i, k| ((3 * i + 5 * k + 1) as f64).sin()).qr().q();
        let rotated = |diagonal: [f64; 3]| {
            &rotation * DMatrix::from_diagonal(&DVector::from_column_slice(&diagonal)) * rotation.transpose()
        };
        let multiplier_matrices = [rotated([1.0, -1.0, 0.0]), rotated([0.5, 1.0, -1.5])];
        for of in [[3.0_f64, -1.0, 0.4], [-2.0, 5.0, 0.0], [0.1, 0.2, -4.0]] {
            let (size, mean) = (of.iter().fold(0.0, |most: f64, x| most.max(x.abs())), of.iter().sum::<f64>() / 3.0);
            let (best, p) = minimise_largest_eigenvalue(&rotated(of), &multiplier_matrices);
            let largest = *symmetric::eigen(&best).0.last().expect("three");
            assert!(largest >= mean - 1e-12 && largest < mean + 2e-3 * size, "{of:?}: {largest} {mean}");
            assert!((best.trace() - 3.0 * mean).abs() < 1e-12 * size, "only along the free ones: {best}");
            // P is a third of I
            let bound = p.component_mul(&rotated(of)).sum();
            assert!((p.trace() - 1.0).abs() < 1e-12 && (bound - mean).abs() < 0.1 * size, "{of:?}: {bound} {mean}");
        }
        // a free direction with a trace makes the largest eigenvalue as negative as one likes
        let (best, _) = minimise_largest_eigenvalue(&a, &[DMatrix::identity(2, 2)]);
        assert!(*symmetric::eigen(&best).0.last().expect("two") < 0.0);
    }
}
