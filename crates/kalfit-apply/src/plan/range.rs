//! The coordinates that an information determines.

use nalgebra::{DMatrix, DVector};

/// Eigenvalues of the information, scaled to unit diagonal, below this threshold count as zero.
const LEAST_EIGENVALUE: f64 = 1e-11;
/// Part of a figure's derivatives outside the range beyond which the figure is not determined.
const MOST_OUTSIDE: f64 = 1e-6;

/// The range of an information matrix. Its coordinates y are of about one size: δ = TPy, with T the reciprocal sizes of the
/// coordinates and P the eigenvectors of the scaled information.
pub(super) struct Range {
    /// TP, d × r.
    map: DMatrix<f64>,
    /// Square roots of the diagonal; zero where there is no information.
    sizes: Vec<f64>,
    /// P, d × r.
    vectors: DMatrix<f64>,
    eigenvalues: Vec<f64>,
}

impl Range {
    pub(super) fn of(information: &DMatrix<f64>) -> Range {
        let sizes: Vec<f64> = information.diagonal().iter().map(|x| x.max(0.0).sqrt()).collect();
        let reciprocal = |size: f64| if size > 0.0 { size.recip() } else { 0.0 };
        let d = sizes.len();
        if d == 0 {
            let none = DMatrix::zeros(0, 0);
            return Range { map: none.clone(), sizes, vectors: none, eigenvalues: Vec::new() };
        }
        let scaled = DMatrix::from_fn(d, d, |i, j| information[(i, j)] * reciprocal(sizes[i]) * reciprocal(sizes[j]));
        let eigen = scaled.symmetric_eigen();
        let kept: Vec<usize> = (0..d).filter(|&k| eigen.eigenvalues[k] > LEAST_EIGENVALUE).collect();
        let vectors = eigen.eigenvectors.select_columns(&kept);
        let map = DMatrix::from_fn(d, kept.len(), |i, k| reciprocal(sizes[i]) * vectors[(i, k)]);
        Range { map, sizes, vectors, eigenvalues: kept.iter().map(|&k| eigen.eigenvalues[k]).collect() }
    }

    /// Number of coordinates.
    pub(super) fn dimension(&self) -> usize {
        self.map.ncols()
    }

    /// d(coordinates of the information)/d(coordinates of the range).
    pub(super) fn map(&self) -> &DMatrix<f64> {
        &self.map
    }

    /// log |TP|² where all coordinates are determined.
    pub(super) fn log_volume(&self) -> f64 {
        -2.0 * self.sizes.iter().map(|size| size.ln()).sum::<f64>()
    }

    /// log of the determinant where all coordinates are determined.
    pub(super) fn log_determinant(&self) -> f64 {
        self.eigenvalues.iter().map(|value| value.ln()).sum::<f64>() - self.log_volume()
    }

    /// Variance of the figure with these derivatives; `None` where the information does not determine it.
    pub(super) fn variance(&self, gradient: &DVector<f64>) -> Option<f64> {
        if gradient.iter().zip(&self.sizes).any(|(x, size)| *x != 0.0 && *size <= 0.0) {
            return None;
        }
        let scaled =
            DVector::from_fn(gradient.len(), |i, _| if gradient[i] == 0.0 { 0.0 } else { gradient[i] / self.sizes[i] });
        let along = self.vectors.tr_mul(&scaled);
        let outside = (&scaled - &self.vectors * &along).norm();
        let variance: f64 = along.iter().zip(&self.eigenvalues).map(|(x, value)| x * x / value).sum();
        (scaled.norm() > 0.0 && outside <= MOST_OUTSIDE * scaled.norm()).then_some(variance)
    }

    /// The inverse of the information on its range, d × d, zero beyond.
    pub(super) fn inverse(&self) -> DMatrix<f64> {
        let mut scaled = self.map.clone();
        scaled.column_iter_mut().zip(&self.eigenvalues).for_each(|(mut column, value)| column /= value.sqrt());
        &scaled * scaled.transpose()
    }
}
