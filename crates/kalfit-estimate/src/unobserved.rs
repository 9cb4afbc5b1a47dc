//! Directions of ξ that no test observes keep the distribution of the start (theory §5).
//!
//! Where J_j n = 0 for all tests j, ℓ depends only on o = V'ξ, where V is a basis of the complement of all such n. EM
//! leaves the distribution of ξ given o unchanged; Newton's steps drift along such directions without changing ℓ. With
//! Σ0 the start and K = Σ0V(V'Σ0V)⁻¹ that distribution is preserved by
//!
//! ```text
//! Σ = K (V'ΣV) K' + (Σ0 - K (V'Σ0V) K')
//! ```

use nalgebra::{DMatrix, DVector};

use crate::covariance::{CoordinateForm, CovarianceMap, PhaseForm, submatrix};
use kalfit_algebra::symmetric;

/// Scaled information below this counts as zero.
const ZERO_INFORMATION: f64 = 1e-10;

/// The root of a Σ with the present distribution of what is observed, and the start's distribution of the rest given
/// what is observed. `None` where everything is observed, or where constraints tie observed and unobserved directions.
pub(crate) fn restored(
    map: &CovarianceMap,
    information: &DMatrix<f64>,
    start: &DMatrix<f64>,
    root: &DMatrix<f64>,
) -> Option<DMatrix<f64>> {
    let unconstrained = |part: &&PhaseForm| map.of_part(part).constraints.is_empty();
    let blocks = map.parts.iter().filter(unconstrained).flat_map(|part| match &part.form {
        CoordinateForm::Factor(blocks) => blocks.as_slice(),
        _ => &[],
    });
    let mut completed = root.clone();
    let mut changed = false;
    for block in blocks {
        let Some(observed) = observed(&submatrix(information, block)) else { continue };
        let rows = |root: &DMatrix<f64>| DMatrix::from_fn(block.len(), root.ncols(), |i, c| root[(block[i], c)]);
        let block_root = completed_root(&rows(start), &rows(root), &observed);
        for (k, &i) in block.iter().enumerate() {
            (0..root.ncols()).for_each(|c| completed[(i, c)] = 0.0);
            for (c, &at) in block.iter().enumerate() {
                completed[(i, at)] = block_root[(k, c)];
            }
        }
        changed = true;
    }
    changed.then_some(completed)
}

/// V, an orthonormal basis (columns) of the observed directions; `None` where all directions are observed.
fn observed(information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let range = symmetric::range(information, |value| value >= ZERO_INFORMATION);
    (range.ncols() < information.nrows()).then_some(range)
}

/// A square root of K S K' + Σ0 - K (V'Σ0V) K', S = V'FF'V.
fn completed_root(start: &DMatrix<f64>, root: &DMatrix<f64>, v: &DMatrix<f64>) -> DMatrix<f64> {
    let (n, o) = v.shape();
    let sigma = start * start.transpose();
    let observed_covariance = v.transpose() * &sigma * v;
    let size = DVector::from_vec(symmetric::sizes(&observed_covariance)).map(f64::recip);
    let scale = DMatrix::from_diagonal(&size);
    let gain = &sigma * v * &scale * symmetric::pseudo_inverse(&(&scale * &observed_covariance * &scale)) * &scale;
    // (I - KV') Σ0 (I - KV')', whose rank is at most n - o
    let rest = (DMatrix::identity(n, n) - &gain * v.transpose()) * start;
    let rest = rest.svd(true, false);
    let directions = rest.u.expect("asked for");
    let observed_root = (v.transpose() * root).transpose().qr().r().transpose(); // S = seen seen', o × o
    let explained = gain * observed_root;
    DMatrix::from_fn(
        n,
        n,
        |i, c| if c < o { explained[(i, c)] } else { directions[(i, c - o)] * rest.singular_values[c - o] },
    )
}
