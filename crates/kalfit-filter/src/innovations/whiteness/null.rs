//! The law of Ljung and Box's statistic when the innovations are uncorrelated.

use super::lags::{INNOVATIONS_PER_LAG, MAX_LAGS, lag_count};
use super::table::{CHI_SQUARED, LENGTHS, QUANTILES};

/// Number of tail probabilities for which quantiles are known.
const LEVELS: usize = CHI_SQUARED[0].len();
/// Number of rows of the table before the lengths that are interpolated: one for each length with fewer than `MAX_LAGS`
/// lags.
const SHORT_ROWS: usize = MAX_LAGS * INNOVATIONS_PER_LAG - INNOVATIONS_PER_LAG;

/// The χ² value with the tail probability of the statistic `q` of n innovations; the degrees of freedom of χ² are the
/// number of lags.
///
/// Q is far from χ² in its tail, even for hundreds of innovations: one slow or alternating motion makes all r_k large
/// at once. The quantiles of Q are known from simulation ([`super::table`]); between quantiles the value is
/// interpolated, and for probabilities below 1e-8 extrapolated. For more than 50 innovations the quantiles are
/// interpolated linearly in 1/n between lengths, with the quantiles of χ² for n → ∞.
pub(super) fn chi_squared_value(q: f64, n: usize) -> f64 {
    let lags = lag_count(n);
    let values = &CHI_SQUARED[lags - 1];
    let quantiles = quantiles(n);
    // the segment that holds q, or the last one
    let above = quantiles.iter().position(|&x| q < x).unwrap_or(LEVELS - 1);
    let (from, value) = if above == 0 { (0.0, 0.0) } else { (quantiles[above - 1], values[above - 1]) };
    value + (q - from) * (values[above] - value) / (quantiles[above] - from)
}

/// Quantiles of Q of n innovations.
fn quantiles(n: usize) -> [f64; LEVELS] {
    if n < LENGTHS[0] {
        return QUANTILES[n - INNOVATIONS_PER_LAG];
    }
    let longer = LENGTHS.iter().position(|&length| n < length).unwrap_or(LENGTHS.len());
    let reciprocal = |length: usize| (length as f64).recip();
    let (near, lower) = (reciprocal(LENGTHS[longer - 1]), &QUANTILES[SHORT_ROWS + longer - 1]);
    let (far, upper) = match LENGTHS.get(longer) {
        Some(&length) => (reciprocal(length), &QUANTILES[SHORT_ROWS + longer]),
        None => (0.0, &CHI_SQUARED[MAX_LAGS - 1]),
    };
    let weight = (reciprocal(n) - far) / (near - far);
    std::array::from_fn(|level| upper[level] + weight * (lower[level] - upper[level]))
}

#[cfg(test)]
mod tests {
    use statrs::distribution::{ChiSquared, ContinuousCDF};

    use super::super::table::LEVELS as PROBABILITIES;
    use super::*;

    #[test]
    fn the_table_is_in_order() {
        for (lags, values) in CHI_SQUARED.iter().enumerate() {
            let chi = ChiSquared::new((lags + 1) as f64).expect("positive");
            for (value, p) in values.iter().zip(PROBABILITIES) {
                assert!((chi.sf(*value) / p - 1.0).abs() < 1e-3, "χ² of {}: {} at {p}", lags + 1, chi.sf(*value));
            }
        }
        assert_eq!(QUANTILES.len(), SHORT_ROWS + LENGTHS.len());
        for row in &QUANTILES {
            assert!(row.windows(2).all(|pair| pair[0] < pair[1]), "{row:?}");
        }
    }

    #[test]
    fn the_value_grows_with_the_statistic_and_is_the_statistic_of_very_many() {
        for n in [5, 9, 10, 37, 49, 50, 51, 53, 99, 400, 9999, 10_000, 20_000] {
            let mut last = -1.0;
            for q in (0..4000).map(|k| 0.05 * f64::from(k)) {
                let value = chi_squared_value(q, n);
                assert!(value > last && value.is_finite(), "n = {n}, Q = {q}: {value} after {last}");
                last = value;
            }
        }
        for q in [3.0, 10.0, 30.0, 45.0] {
            let value = chi_squared_value(q, 1_000_000_000);
            assert!((value - q).abs() < 0.02 * q, "Q = {q}: {value}");
        }
    }

    #[test]
    fn one_lag_has_the_law_of_its_quadratic_form() {
        // P(|r_1| > r) of five: the eigenvalues of the lag-one product of five are cos(kπ/6); by Imhof's integral
        // P(Σ (λ_k - r) χ²_1 > 0) = ½ + ∫ sin θ(u) / (π u ρ(u)) du
        let tail = |r: f64| {
            let weights: Vec<f64> = (1..=5).map(|k| (f64::from(k) * std::f64::consts::PI / 6.0).cos() - r).collect();
            let integrand = |u: f64| {
                let theta: f64 = weights.iter().map(|w| 0.5 * (w * u).atan()).sum();
                let rho: f64 = weights.iter().map(|w| (1.0 + w * w * u * u).powf(0.25)).product();
                theta.sin() / (u * rho)
            };
            // u = exp(s), so that du/u = ds
            let step = 1e-3;
            let sum: f64 = (-20_000..20_000).map(|k| f64::from(k) * step).map(|s| s.exp() * integrand(s.exp())).sum();
            2.0 * (0.5 + sum * step / std::f64::consts::PI)
        };
        let chi = ChiSquared::new(1.0).expect("positive");
        for r in [0.3, 0.5, 0.7, 0.8, 0.83] {
            let (expected, found) = (tail(r), chi.sf(chi_squared_value(35.0 * r * r / 4.0, 5)));
            assert!((found / expected - 1.0).abs() < 0.05, "r = {r}: {found} {expected}");
        }
    }
}
