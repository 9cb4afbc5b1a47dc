//! What laws of series to draw from have in common.

use rand_chacha::ChaCha8Rng;

/// Longest lag of any series.
pub(super) const MOST_LAGS: usize = 10;
/// Numbers for each lag.
pub(super) const PER_LAG: usize = 5;

/// A law of series to draw from.
pub(super) trait SeriesProposal: Sync {
    /// Draw number `number` into `z`.
    fn draw(&self, number: usize, rng: &mut ChaCha8Rng, z: &mut [f64]);

    /// f/g at z, whose sums of products by lag are `products`.
    fn weight(&self, z: &[f64], products: &[f64]) -> f64;
}

/// Longest lag for n numbers.
pub(super) fn lags(n: usize) -> usize {
    (n / PER_LAG).min(MOST_LAGS)
}
