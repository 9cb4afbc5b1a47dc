//! Are the innovations uncorrelated in time?

mod lags;
mod null;
mod table;

use self::lags::lag_count;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Ljung and Box's test (1978), computed for each measurement of each phase and added up over all measurements:
///
/// ```text
/// Q = Σ_measurements n (n + 2) Σ_k r_k² / (n - k)      r_k = Σ_t z_t z_{t+k} / Σ_t z_t²      k = 1 … min(10, n/5)
/// ```
///
/// The mean of the z = e/√S is known to be zero and is not subtracted, so that Q has exactly the mean of its χ² however
/// few innovations there are, and a bias of the innovations counts as correlation. The tail of Q differs from the tail
/// of χ² and is known by simulation for every length: the p-value holds to 1e-6 and beyond
/// (book/src/guide/coverage.md). Each measurement's Q is converted to the χ² value of the same probability, and the χ²
/// values are added up. A measurement with fewer than five innovations has no lag. The lag is counted in innovations of
/// the measurement, whatever the time between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Whiteness {
    /// Q.
    pub statistic: f64,
    /// The longest lag of any measurement.
    pub lags: usize,
    /// Degrees of freedom of Q: the lags of all measurements together.
    pub degrees_of_freedom: usize,
    /// Probability of so much correlation by chance.
    pub p_value: f64,
}

impl Whiteness {
    /// Tests e/√S of each measurement, in the order of the filter; `None` when no measurement has five innovations, or
    /// all innovations are zero.
    pub fn of<'a>(channels: impl Iterator<Item = &'a [f64]>) -> Option<Whiteness> {
        let (mut statistic, mut chi_squared_sum, mut lags, mut degrees_of_freedom) = (0.0, 0.0, 0, 0);
        for z in channels {
            if let Some(q) = ljung_box(z) {
                statistic += q;
                chi_squared_sum += null::chi_squared_value(q, z.len());
                lags = lags.max(lag_count(z.len()));
                degrees_of_freedom += lag_count(z.len());
            }
        }
        let chi = ChiSquared::new(degrees_of_freedom as f64).ok().filter(|_| degrees_of_freedom > 0)?;
        Some(Whiteness { statistic, lags, degrees_of_freedom, p_value: chi.sf(chi_squared_sum) })
    }
}

fn ljung_box(z: &[f64]) -> Option<f64> {
    let (n, largest) = (z.len(), z.iter().fold(0.0, |most: f64, x| most.max(x.abs())));
    if lag_count(n) == 0 || largest == 0.0 {
        return None;
    }
    // relative to the largest |z|, so that no square overflows or vanishes
    let z: Vec<f64> = z.iter().map(|x| x / largest).collect();
    let square: f64 = z.iter().map(|x| x.powi(2)).sum();
    let lag = |(k, product): (usize, f64)| (product / square).powi(2) / (n - k) as f64;
    let products = lagged_products(&z, lag_count(n));
    Some((n * (n + 2)) as f64 * (1..).zip(products).map(lag).sum::<f64>())
}

/// Σ_t z_t z_{t+k} for k = 1 … `lags`, all in one pass: each sum is in the order of t.
fn lagged_products(z: &[f64], lags: usize) -> Vec<f64> {
    let mut sums = vec![0.0; lags];
    for window in z.windows(lags + 1) {
        sums.iter_mut().zip(&window[1..]).for_each(|(sum, later)| *sum += window[0] * later);
    }
    let rest = &z[z.len().saturating_sub(lags)..];
    for (t, earlier) in rest.iter().enumerate() {
        sums.iter_mut().zip(&rest[t + 1..]).for_each(|(sum, later)| *sum += earlier * later);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(z: &[f64]) -> Option<Whiteness> {
        Whiteness::of(std::iter::once(z))
    }

    #[test]
    fn the_statistic_is_ljung_and_boxs() {
        // n = 6, one lag: r = (1·2 + 2·-1 + -1·3 + 3·0 + 0·1)/(1 + 4 + 1 + 9 + 0 + 1) = -3/16; Q = 48 r²/5
        let found = of(&[1.0, 2.0, -1.0, 3.0, 0.0, 1.0]).expect("long enough");
        let expected = 48.0 * (3.0f64 / 16.0).powi(2) / 5.0;
        assert!((found.statistic - expected).abs() < 1e-14, "{} {expected}", found.statistic);
        assert_eq!((found.lags, found.degrees_of_freedom), (1, 1));
    }

    #[test]
    fn short_and_silent_series_have_none_and_huge_ones_do_not_overflow() {
        assert_eq!(of(&[1.0, -1.0, 1.0, 2.0]), None);
        assert_eq!(of(&[0.0; 50]), None);
        let huge: Vec<f64> = (0..50).map(|k| if k % 3 == 0 { 1e200 } else { -3e199 }).collect();
        let found = of(&huge).expect("long enough");
        assert!(found.statistic.is_finite() && (0.0..=1.0).contains(&found.p_value), "{found:?}");
    }
}
