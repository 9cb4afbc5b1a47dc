//! Short series: sinusoids in noise, and autoregressions of one lag.

use std::f64::consts::PI;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::proposal::{SeriesProposal, lags};

/// Draws of ten that are uncorrelated, that are sinusoids; the rest are autoregressions.
const PLAIN: usize = 1;
const SINUSOIDS: usize = 5;
const OF: usize = 10;
/// How strong sinusoids are: with this probability uncorrelated numbers are so much in one direction.
const CHANCES: [f64; 5] = [1e-1, 1e-2, 1e-4, 1e-7, 1e-11];
/// Coefficients of the autoregressions.
const COEFFICIENTS: [f64; 10] = [-0.95, -0.8, -0.6, -0.4, -0.2, 0.2, 0.4, 0.6, 0.8, 0.95];

/// The mixture; weights are of directions alone.
pub(super) struct ShortMixture {
    /// Sinusoids of length one: the eigenvectors of the lag-one product.
    sinusoids: Vec<Vec<f64>>,
    /// How often each is drawn.
    shares: Vec<f64>,
    /// Variance in the direction of a sinusoid, beyond that of the noise.
    strengths: Vec<f64>,
}

impl ShortMixture {
    pub(super) fn new(n: usize) -> ShortMixture {
        let sinusoid = |j: usize| -> Vec<f64> {
            let length = (0.5 * (n + 1) as f64).sqrt();
            (1..=n).map(|i| ((i * j) as f64 * PI / (n + 1) as f64).sin() / length).collect()
        };
        // the slowest and the fastest are those of the largest statistics
        let share = |j: usize| ((j + 1).min(n - j) as f64).recip();
        let all: f64 = (0..n).map(share).sum();
        let strength = |p: f64| {
            let rest = p.powf(2.0 / (n - 1) as f64);
            (n - 1) as f64 * (1.0 - rest) / rest
        };
        ShortMixture {
            sinusoids: (1..=n).map(sinusoid).collect(),
            shares: (0..n).map(|j| share(j) / all).collect(),
            strengths: CHANCES.map(strength).to_vec(),
        }
    }
}

/// One of so many, evenly.
fn choice(rng: &mut ChaCha8Rng, count: usize) -> usize {
    (rng.random::<f64>() * count as f64) as usize
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl SeriesProposal for ShortMixture {
    fn draw(&self, number: usize, rng: &mut ChaCha8Rng, z: &mut [f64]) {
        match number % OF {
            kind if kind < PLAIN => {}
            kind if kind < PLAIN + SINUSOIDS => {
                let mut left = rng.random::<f64>();
                let passed = |share: &f64| {
                    left -= share;
                    left < 0.0
                };
                let which = self.shares.iter().position(passed).unwrap_or(0);
                let size =
                    self.strengths[choice(rng, self.strengths.len())].sqrt() * rng.sample::<f64, _>(StandardNormal);
                z.iter_mut().zip(&self.sinusoids[which]).for_each(|(z, v)| *z += size * v);
            }
            _ => {
                let (lag, coefficient) =
                    (1 + choice(rng, lags(z.len())), COEFFICIENTS[choice(rng, COEFFICIENTS.len())]);
                (lag..z.len()).for_each(|i| z[i] += coefficient * z[i - lag]);
            }
        }
    }

    fn weight(&self, z: &[f64], products: &[f64]) -> f64 {
        let (n, square) = (z.len(), products[0]);
        let power = -0.5 * n as f64;
        let mut density = PLAIN as f64;
        for (v, share) in self.sinusoids.iter().zip(&self.shares) {
            let part = dot(v, z).powi(2) / square;
            let of = |s: &f64| (power * (-s / (1.0 + s) * part).ln_1p()).exp() / (1.0 + s).sqrt();
            let strengths: f64 = self.strengths.iter().map(of).sum();
            density += (SINUSOIDS as f64) * share * strengths / self.strengths.len() as f64;
        }
        let longest = products.len() - 1;
        let each = (OF - PLAIN - SINUSOIDS) as f64 / (longest * COEFFICIENTS.len()) as f64;
        let mut last = 0.0;
        for lag in 1..=longest {
            last += z[n - lag] * z[n - lag];
            for a in COEFFICIENTS {
                // squares of what the autoregression was driven by
                let driving = square * (1.0 + a * a) - a * a * last - 2.0 * a * products[lag];
                density += each * (driving / square).powf(power);
            }
        }
        OF as f64 / density
    }
}
