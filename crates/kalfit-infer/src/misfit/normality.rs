//! Whether innovations are normal, by Shapiro and Francia's W' with Royston's (1993) law.

use statrs::distribution::{ContinuousCDF, Normal};

/// Fewest and most values for which the law of W' was found.
const LEAST: usize = 20;
const MOST: usize = 5000;

/// The test of normality.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Normality {
    /// Number of values, at most 5000; of more, values at equal distances in the order of the data are taken.
    pub count: usize,
    /// W', the squared correlation of the sorted values with normal scores.
    pub statistic: f64,
    /// Probability of a W' as small as this.
    pub p_value: f64,
}

impl Normality {
    /// The test of standardised innovations; `None` for fewer than 20, or values that are all equal.
    pub(super) fn of(values: &[f64]) -> Option<Normality> {
        let mut taken: Vec<f64> = values.iter().copied().step_by(values.len().div_ceil(MOST).max(1)).collect();
        let n = taken.len();
        if n < LEAST {
            return None;
        }
        taken.sort_by(f64::total_cmp);
        let normal = Normal::standard();
        let scores: Vec<f64> =
            (1..=n).map(|rank| normal.inverse_cdf((rank as f64 - 0.375) / (n as f64 + 0.25))).collect();
        let mean = taken.iter().sum::<f64>() / n as f64;
        let (mut cross, mut square, mut of_scores) = (0.0, 0.0, 0.0);
        for (x, score) in taken.iter().zip(&scores) {
            cross += (x - mean) * score;
            square += (x - mean) * (x - mean);
            of_scores += score * score;
        }
        let statistic = cross * cross / (square * of_scores);
        let p_value = normal.sf(standardised(1.0 - statistic, n));
        (statistic.is_finite() && p_value.is_finite()).then_some(Normality { count: n, statistic, p_value })
    }
}

/// A number that is N(0, 1) for normal values, from 1 - W'.
fn standardised(lacking: f64, n: usize) -> f64 {
    let u = (n as f64).ln();
    let v = u.ln();
    let mean = -1.2725 + 1.0521 * (v - u);
    let std_dev = 1.0308 - 0.26758 * (v + 2.0 / u);
    (lacking.max(f64::MIN_POSITIVE).ln() - mean) / std_dev
}
