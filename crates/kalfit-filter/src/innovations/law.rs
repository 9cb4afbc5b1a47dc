//! The law of what enters a phase, updated by the phase's measurements.

use nalgebra::{DMatrix, DVector};

use kalfit_algebra::fold::{fold, fold_row};

/// The law of σ = m + Fu: u ~ N(0, I) before the phase's measurements, and the measurements give square-root
/// information [R | d] on u:
///
/// ```text
/// σ | z ~ N(m + F R⁻¹d, F R⁻¹R⁻ᵀF')
/// ```
///
/// R begins as the identity, so that R always has an inverse, whatever F is: Σ may be singular, zero or huge.
#[derive(Debug, Clone)]
pub struct EnteringLaw {
    mean: DVector<f64>,
    /// F, q × c.
    root: DMatrix<f64>,
    /// [R | d; 0 residual of e], (c + 1) × (c + 1), row-major.
    information: Vec<f64>,
    /// [F't, e - t'm] of the last measurement, c + 1 numbers.
    row: Vec<f64>,
    /// R⁻ᵀF't of the last measurement.
    whitened_row: Vec<f64>,
}

impl EnteringLaw {
    /// The law N(mean, root root').
    pub(crate) fn new(mean: DVector<f64>, root: &DMatrix<f64>) -> EnteringLaw {
        let root = with_fewest_columns(root);
        let width = root.ncols() + 1;
        let mut information = vec![0.0; width * width];
        (0..width - 1).for_each(|k| information[k * (width + 1)] = 1.0);
        EnteringLaw { mean, root, information, row: Vec::with_capacity(width), whitened_row: Vec::with_capacity(width) }
    }

    /// Takes in e = t'σ + v, v ~ N(0, 1/weight); returns (innovation, S).
    pub fn take(&mut self, e: f64, t: &[f64], weight: f64) -> (f64, f64) {
        let width = self.root.ncols() + 1;
        let (row, whitened_row) = (&mut self.row, &mut self.whitened_row);
        row.clear();
        row.extend(self.root.column_iter().map(|f| f.iter().zip(t).map(|(f, t)| f * t).sum::<f64>()));
        let prior_value: f64 = self.mean.iter().zip(t).map(|(m, t)| m * t).sum();
        row.push(e - prior_value);
        whitened_row.clear();
        whitened_row.extend_from_slice(&row[..width - 1]);
        solve_transposed(&self.information, width, whitened_row);
        let expected: f64 =
            whitened_row.iter().enumerate().map(|(k, w)| w * self.information[k * width + width - 1]).sum();
        let variance = weight.recip() + whitened_row.iter().map(|w| w * w).sum::<f64>();
        let value = row[width - 1] - expected;
        let sqrt_weight = weight.sqrt();
        row.iter_mut().for_each(|x| *x *= sqrt_weight);
        fold_row(&mut self.information, row, |_, _| {});
        (value, variance)
    }

    /// (mean of σ, root of the covariance of σ), given all measurements taken in.
    pub fn posterior(&self) -> (DVector<f64>, DMatrix<f64>) {
        let c = self.root.ncols();
        let width = c + 1;
        let mut root = self.root.clone();
        let mut mean = self.mean.clone();
        let mut line = vec![0.0; c];
        for i in 0..root.nrows() {
            line.iter_mut().zip(self.root.row(i).iter()).for_each(|(entry, root_entry)| *entry = *root_entry);
            solve_transposed(&self.information, width, &mut line);
            for (k, &x) in line.iter().enumerate() {
                root[(i, k)] = x;
                mean[i] += x * self.information[k * width + c]; // F R⁻¹d, by rows of F R⁻¹
            }
        }
        (mean, root)
    }
}

/// x ← R⁻ᵀx for the upper triangular R of an array `width` wide.
fn solve_transposed(array: &[f64], width: usize, x: &mut [f64]) {
    for k in 0..x.len() {
        let mut sum = x[k];
        for i in 0..k {
            sum -= array[i * width + k] * x[i];
        }
        x[k] = sum / array[k * (width + 1)];
    }
}

/// A root G with GG' = FF' for the root F, with at most as many columns as rows.
fn with_fewest_columns(root: &DMatrix<f64>) -> DMatrix<f64> {
    let q = root.nrows();
    if root.ncols() <= q {
        return root.clone();
    }
    let mut upper = vec![0.0; q * q];
    let mut columns: Vec<f64> = root.iter().copied().collect(); // column after column: the rows of the transpose
    fold(&mut upper, &mut columns, q);
    DMatrix::from_column_slice(q, q, &upper)
}

#[cfg(test)]
mod tests {
    use kalfit_fixtures::near;

    use super::*;

    /// Measurements of (σ_1, σ_2, σ_3): weight, e, t.
    const ROWS: [(f64, f64, [f64; 3]); 4] = [
        (4.0, 1.3, [1.0, 0.5, 0.0]),
        (1.0, -0.4, [0.0, 0.0, 0.0]),
        (25.0, 2.0, [0.0, 1.0, -2.0]),
        (0.5, 0.1, [1.0, 1.0, 1.0]),
    ];

    /// The textbook update, by covariances.
    fn naive(mean: &DVector<f64>, root: &DMatrix<f64>) -> (Vec<(f64, f64)>, DVector<f64>, DMatrix<f64>) {
        let (mut mean, mut covariance) = (mean.clone(), root * root.transpose());
        let mut seen = Vec::new();
        for (weight, e, t) in ROWS {
            let t = DVector::from_row_slice(&t);
            let (value, variance) = (e - t.dot(&mean), 1.0 / weight + (&covariance * &t).dot(&t));
            let gain = &covariance * &t / variance;
            mean += &gain * value;
            covariance -= &gain * gain.transpose() * variance;
            seen.push((value, variance));
        }
        (seen, mean, covariance)
    }

    #[test]
    fn measurements_come_in_as_in_the_textbook() {
        let mean = DVector::from_vec(vec![0.5, -1.0, 2.0]);
        let wide = DMatrix::from_row_slice(
            3,
            5,
            &[1.0, 0.2, 0.0, 3.0, 1.0, 0.0, 1.0, 0.5, -1.0, 0.0, 0.3, 0.0, 2.0, 0.1, 0.4],
        );
        let thin = DMatrix::from_row_slice(3, 1, &[1.0, 2.0, 0.0]);
        for root in [wide, thin, DMatrix::zeros(3, 3), DMatrix::zeros(3, 0)] {
            let (seen, last, covariance) = naive(&mean, &root);
            let mut law = EnteringLaw::new(mean.clone(), &root);
            for ((weight, e, t), (value, variance)) in ROWS.into_iter().zip(seen) {
                let found = law.take(e, &t, weight);
                near::absolute("innovation", found.0, value, 1e-10);
                near::absolute("variance", found.1, variance, 1e-9);
            }
            let (m, f) = law.posterior();
            let p = &f * f.transpose();
            m.iter().zip(&last).for_each(|(a, b)| near::absolute("mean", *a, *b, 1e-10));
            p.iter().zip(&covariance).for_each(|(a, b)| near::absolute("covariance", *a, *b, 1e-10));
        }
    }

    #[test]
    fn a_huge_start_costs_no_digits_of_what_is_measured_well() {
        // σ_1 + σ_2 is measured twice, σ_1 - σ_2 never
        let mut law = EnteringLaw::new(DVector::zeros(2), &(DMatrix::identity(2, 2) * 1e9));
        law.take(3.0, &[1.0, 1.0], 1e4);
        let (value, variance) = law.take(3.5, &[1.0, 1.0], 1e4);
        near::absolute("innovation", value, 0.5, 1e-11);
        near::absolute("variance", variance, 2e-4, 1e-15);
        let (_, root) = law.posterior();
        let sum: f64 = root.column_iter().map(|column| column.sum().powi(2)).sum();
        assert!((sum / 5e-5 - 1.0).abs() < 1e-6, "variance of the sum: {sum} against 5e-5");
    }
}
