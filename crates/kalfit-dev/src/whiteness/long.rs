//! Long series: autoregressions with normal coefficients a ~ N(0, τ²I/n).
//!
//! With X the numbers before each number (zero before the first) and b = X'z, a is integrated out of the density:
//!
//! ```text
//! g/f = |I + (τ²/n)X'X|^-1/2 exp ½ b'(X'X + (n/τ²)I)⁻¹b
//! ```

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::proposal::{SeriesProposal, lags};

/// τ², each as often.
const SPREADS: [f64; 5] = [0.0, 1.0, 3.0, 6.0, 12.0];

/// The mixture over τ.
pub(super) struct LongMixture {
    n: usize,
}

impl LongMixture {
    pub(super) fn new(n: usize) -> LongMixture {
        LongMixture { n }
    }
}

impl SeriesProposal for LongMixture {
    fn draw(&self, number: usize, rng: &mut ChaCha8Rng, z: &mut [f64]) {
        let spread = (SPREADS[number % SPREADS.len()] / self.n as f64).sqrt();
        if spread == 0.0 {
            return;
        }
        let coefficients: Vec<f64> = (0..lags(self.n)).map(|_| spread * rng.sample::<f64, _>(StandardNormal)).collect();
        for i in 0..z.len() {
            let from = i.saturating_sub(coefficients.len());
            let before: f64 = z[from..i].iter().rev().zip(&coefficients).map(|(z, a)| a * z).sum();
            z[i] += before;
        }
    }

    fn weight(&self, z: &[f64], products: &[f64]) -> f64 {
        let (n, longest) = (self.n, products.len() - 1);
        // so large a sum of squares has no probability
        if products[0] > n as f64 + 60.0 * (n as f64).sqrt() + 600.0 {
            return 0.0;
        }
        let mut gram = DMatrix::zeros(longest, longest);
        for i in 1..=longest {
            for j in i..=longest {
                let beyond: f64 = (n - i..n).map(|t| z[t] * z[t - (j - i)]).sum();
                gram[(i - 1, j - 1)] = products[j - i] - beyond;
                gram[(j - 1, i - 1)] = gram[(i - 1, j - 1)];
            }
        }
        let b = DVector::from_column_slice(&products[1..]);
        let density: f64 = SPREADS.iter().map(|spread| self.ratio(*spread, &gram, &b)).sum();
        SPREADS.len() as f64 / density
    }
}

impl LongMixture {
    /// g/f of one τ².
    fn ratio(&self, spread: f64, gram: &DMatrix<f64>, b: &DVector<f64>) -> f64 {
        let scale = spread / self.n as f64;
        let whole = DMatrix::identity(b.len(), b.len()) + gram * scale;
        let Some(factor) = whole.cholesky() else { return f64::INFINITY };
        let log: f64 = factor.l_dirty().diagonal().iter().map(|x| x.ln()).sum();
        (0.5 * scale * b.dot(&factor.solve(b)) - log).exp()
    }
}
