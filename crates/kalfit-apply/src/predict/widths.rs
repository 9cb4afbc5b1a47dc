//! Half widths of intervals about a point at distance x from the mean that contain a given part of the normal law.

use statrs::distribution::{ContinuousCDF, Normal};

/// r(x) with Φ(x + r) - Φ(x - r) = p, from a table of values and slopes.
#[derive(Debug, Clone)]
pub(super) struct Widths {
    table: Vec<(f64, f64)>,
    /// Quantile z_p: far from the mean, r = x + z_p.
    quantile: f64,
}

/// Distance in x between entries of the table.
const TABLE_STEP: f64 = 0.05;
/// Number of entries of the table.
const TABLE_ENTRIES: usize = 161;

impl Widths {
    pub(super) fn new(content: f64) -> Widths {
        let law = Normal::standard();
        let entry = |k: usize| {
            let x = TABLE_STEP * k as f64;
            let (mut low, mut high) = (0.0, x + law.inverse_cdf(0.5 * (1.0 + content)));
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                let within = law.cdf(x + middle) - law.cdf(x - middle);
                if within < content { low = middle } else { high = middle }
            }
            let r = 0.5 * (low + high);
            let [near, far] = [x - r, x + r].map(|x| (-0.5 * x * x).exp());
            (r, (near - far) / (near + far))
        };
        Widths { table: (0..TABLE_ENTRIES).map(entry).collect(), quantile: law.inverse_cdf(content) }
    }

    pub(super) fn at(&self, x: f64) -> f64 {
        let position = x / TABLE_STEP;
        let k = position as usize;
        if k + 1 >= self.table.len() {
            return x + self.quantile;
        }
        let (t, [(a, slope_a), (b, slope_b)]) = (position - k as f64, [self.table[k], self.table[k + 1]]);
        let (u, tt) = (1.0 - t, t * t);
        a * (1.0 + 2.0 * t) * u * u + b * tt * (3.0 - 2.0 * t) + TABLE_STEP * t * u * (slope_a * u - slope_b * t)
    }
}
