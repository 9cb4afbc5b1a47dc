//! The law of ξ ~ N(μ, FF') given known linear combinations Cξ.

use nalgebra::{DMatrix, DVector};

/// ξ ~ N(μ, FF') given Cξ: mean μ + K(g - Cμ) and root F̃ with F̃F̃' = (I - KC)FF', K = FF'C'(CFF'C')⁻¹. Nothing is
/// subtracted from Σ: with (CF)' = Q[T; 0], F̃ is F times the columns of Q after the first q.
#[derive(Debug, Clone)]
pub struct Conditional {
    coefficients: DMatrix<f64>,
    /// F times the first q columns of Q, p × q.
    known_directions: DMatrix<f64>,
    /// T, upper triangular, q × q.
    upper: DMatrix<f64>,
    /// F̃, p × (columns of F - q).
    pub root: DMatrix<f64>,
}

impl Conditional {
    /// The law given Cξ, with `coefficients` C, q × p, and `root` F, p × n; `None` where CFF'C' is singular.
    pub fn new(coefficients: DMatrix<f64>, root: &DMatrix<f64>) -> Option<Conditional> {
        let (q, n) = (coefficients.nrows(), root.ncols());
        if n < q {
            return None;
        }
        let mut transposed_q = DMatrix::identity(n, n);
        let qr = (&coefficients * root).transpose().qr();
        qr.q_tr_mul(&mut transposed_q);
        let rotated_root = root * transposed_q.transpose();
        let upper = qr.r();
        let regular = (0..q).all(|i| upper[(i, i)].is_normal());
        let (known_directions, left) =
            (rotated_root.columns(0, q).into_owned(), rotated_root.columns(q, n - q).into_owned());
        regular.then_some(Conditional { coefficients, known_directions, upper, root: left })
    }

    /// T'⁻¹x, for x with q rows.
    pub fn whitened(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        self.upper.tr_solve_upper_triangular(x).expect("its diagonal is regular")
    }

    /// x - KCx, for x with p rows.
    pub fn left(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        x - &self.known_directions * self.whitened(&(&self.coefficients * x))
    }

    /// E[ξ | Cξ = g].
    pub fn mean(&self, mean: &DVector<f64>, values: &[f64]) -> DVector<f64> {
        let deviation = DVector::from_column_slice(values) - &self.coefficients * mean;
        let deviation = DMatrix::from_column_slice(deviation.len(), 1, deviation.as_slice());
        mean + (&self.known_directions * self.whitened(&deviation)).column(0)
    }

    /// log p(Cξ = g).
    pub fn log_density(&self, mean: &DVector<f64>, values: &[f64]) -> f64 {
        let deviation = DVector::from_column_slice(values) - &self.coefficients * mean;
        let deviation = self.whitened(&DMatrix::from_column_slice(deviation.len(), 1, deviation.as_slice()));
        let log_root: f64 = self.upper.diagonal().iter().map(|x| x.abs().ln()).sum();
        -0.5 * (values.len() as f64 * std::f64::consts::TAU.ln() + deviation.norm_squared()) - log_root
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_law_is_that_of_the_textbook() {
        let root = DMatrix::from_row_slice(3, 3, &[1.0, 0.2, -0.5, 2.0, 0.3, 0.1, -0.4, 1.5, 0.7]);
        let coefficients = DMatrix::from_row_slice(2, 3, &[1.0, 2.0, 0.0, 0.5, 0.0, -1.0]);
        let (mean, values) = (DVector::from_vec(vec![0.3, -1.0, 2.0]), [0.7, -0.2]);
        let found = Conditional::new(coefficients.clone(), &root).unwrap();
        let sigma = &root * root.transpose();
        let spread = &coefficients * &sigma * coefficients.transpose();
        let gain = &sigma * coefficients.transpose() * spread.clone().try_inverse().unwrap();
        let deviation = DVector::from_column_slice(&values) - &coefficients * &mean;
        let covariance = &sigma - &gain * &coefficients * &sigma;
        assert!((&found.root * found.root.transpose() - covariance).amax() < 1e-13);
        assert!((found.mean(&mean, &values) - (&mean + &gain * &deviation)).amax() < 1e-13);
        let quadratic = deviation.dot(&(spread.clone().try_inverse().unwrap() * &deviation));
        let density = -std::f64::consts::TAU.ln() - 0.5 * (spread.determinant().ln() + quadratic);
        assert!((found.log_density(&mean, &values) - density).abs() < 1e-13);
        let x = DMatrix::from_row_slice(3, 1, &[1.0, -2.0, 0.5]);
        assert!((found.left(&x) - (&x - &gain * (&coefficients * &x))).amax() < 1e-13);
        assert!(Conditional::new(coefficients, &DMatrix::from_column_slice(3, 1, &[1.0, 1.0, 1.0])).is_none());
    }
}
