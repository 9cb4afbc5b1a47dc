//! The covariance that a filter assumes, and the gains that follow from it.
#![expect(non_snake_case, reason = "the letters of the theory: K, L, M, P, Q, R, S, U")]

use nalgebra::{DMatrix, DVector};

use crate::reduce::suboptimal::matrices::{append, fold};
use kalfit_algebra::symmetric;
use kalfit_model::Filter;

/// A measurement is redundant when the standard deviation of the measurement, given other measurements of the step, is
/// at most this fraction of the standard deviation before the step.
const REDUNDANT_FRACTION: f64 = 1e-13;
/// A measurement counts as known already when the standard deviation of the measurement is at most this fraction of the
/// standard deviation before any measurement.
const KNOWN_FRACTION: f64 = 1e-12;
/// Largest correlation of a state with an innovation that counts as rounding error. Such a correlation must not become
/// a gain: the gain would vanish in the rounding of a larger estimate, yet the estimate's covariance would consist of
/// that gain alone.
const UNCORRELATED: f64 = 1e-13;

/// The covariance of [x_k; x_0] that the filter assumes, right or wrong.
#[derive(Debug, Clone)]
pub(super) struct AssumedCovariance<'a> {
    filter: &'a Filter,
    /// U with UU' = P, 2n × any number of columns.
    U: DMatrix<f64>,
    /// Covariance of x_k without measurements: the scale on which a deviation counts as zero.
    unmeasured: DMatrix<f64>,
}

/// White innovations w of a step: e = Lw for the measurements that add information.
struct Whitened {
    informative: Vec<usize>,
    L: DMatrix<f64>,
    /// Covariance of [x_k; x_0] with w, one column for each element of w.
    C: DMatrix<f64>,
}

impl<'a> AssumedCovariance<'a> {
    pub(super) fn new(filter: &'a Filter) -> AssumedCovariance<'a> {
        let (n, unmeasured) = (filter.covariance.nrows(), filter.covariance.clone());
        let mut root = symmetric::square_root(&unmeasured);
        (0..n).filter(|&i| unmeasured[(i, i)] == 0.0).for_each(|i| root.row_mut(i).fill(0.0));
        AssumedCovariance { filter, U: DMatrix::from_fn(2 * n, n, |i, j| root[(i % n, j)]), unmeasured }
    }

    pub(super) fn predict(&mut self, phi: &DMatrix<f64>, Q: &DMatrix<f64>, root: &DMatrix<f64>) {
        let n = phi.nrows();
        let moved = phi * self.U.rows(0, n);
        self.U.rows_mut(0, n).copy_from(&moved);
        append(&mut self.U, 0, root);
        self.unmeasured = phi * &self.unmeasured * phi.transpose() + Q;
    }

    /// Updates U by all measurements of a step at once; `noise` is a root of R. Returns [K; K⁰], 2n × m, with zero rows
    /// for considered states in both: the gain minimises the variance of each other state and does not change
    /// considered states. (Schmidt 1966)
    ///
    /// The update is Joseph's form, P ← (I - KM)P(I - KM)' + KRK', which holds for any gain, applied to roots.
    pub(super) fn update(&mut self, M: &DMatrix<f64>, noise: &DMatrix<f64>) -> DMatrix<f64> {
        let n = M.ncols();
        fold(&mut self.U);
        let MU = M * self.U.rows(0, n);
        let Whitened { informative, L, C } = self.whiten(M, &MU, noise);
        let gain = L.transpose().solve_upper_triangular(&C.transpose()).unwrap_or_else(|| DMatrix::zeros(0, 2 * n));
        let mut K = DMatrix::zeros(2 * n, M.nrows());
        for (k, &i) in informative.iter().enumerate() {
            K.set_column(i, &gain.row(k).transpose());
        }
        for &state in &self.filter.consider {
            K.row_mut(state).fill(0.0);
            K.row_mut(n + state).fill(0.0);
        }
        self.U -= &K * MU;
        append(&mut self.U, 0, &(&K * noise));
        K
    }

    /// Gram-Schmidt orthogonalisation of the rows of [MU R^½], applied twice.
    fn whiten(&self, M: &DMatrix<f64>, MU: &DMatrix<f64>, noise: &DMatrix<f64>) -> Whitened {
        let (m, n, c) = (M.nrows(), M.ncols(), MU.ncols());
        let width = c + noise.ncols();
        let row = |i: usize| DVector::from_fn(width, |j, _| if j < c { MU[(i, j)] } else { noise[(i, j - c)] });
        let (mut informative, mut basis, mut parts): (Vec<usize>, Vec<DVector<f64>>, Vec<Vec<f64>>) =
            Default::default();
        for i in 0..m {
            let mut remainder = row(i);
            let size = remainder.norm();
            let unmeasured: f64 = (0..n).map(|j| M[(i, j)].abs() * self.unmeasured[(j, j)].max(0.0).sqrt()).sum();
            let mut part = vec![0.0; basis.len()];
            for (k, own) in (0..2).flat_map(|_| basis.iter().enumerate()) {
                let along = own.dot(&remainder);
                remainder.axpy(-along, own, 1.0);
                part[k] += along;
            }
            let length = remainder.norm();
            if size > KNOWN_FRACTION * unmeasured && length > REDUNDANT_FRACTION * size {
                part.push(length);
                basis.push(remainder / length);
                parts.push(part);
                informative.push(i);
            }
        }
        let L = DMatrix::from_fn(informative.len(), informative.len(), |i, k| if k <= i { parts[i][k] } else { 0.0 });
        let C = DMatrix::from_fn(2 * n, informative.len(), |i, k| {
            let own = self.U.row(i);
            let covariance: f64 = own.iter().zip(&basis[k]).map(|(u, w)| u * w).sum();
            if covariance.abs() > UNCORRELATED * own.norm() { covariance } else { 0.0 }
        });
        Whitened { informative, L, C }
    }
}
