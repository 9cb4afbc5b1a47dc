//! Quantities that can be held at a value, and that have an error.

use nalgebra::DMatrix;

/// What is estimated, in the user's units. Indices are places in μ and Σ of all phases together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Holdable {
    /// An element of μ.
    Mean(usize),
    /// A regression coefficient, by its place among them.
    Coefficient(usize),
    /// A standard deviation: the square root of a variance in Σ.
    StdDev(usize),
    /// A correlation (i > j).
    Correlation(usize, usize),
    /// An element of Σ (i ≥ j).
    Covariance(usize, usize),
}

impl Holdable {
    /// Its value where these are μ, the regression coefficients and Σ; `None` for a correlation with a variance of zero.
    pub(crate) fn value(self, mean: &[f64], coefficients: &[f64], sigma: &DMatrix<f64>) -> Option<f64> {
        match self {
            Holdable::Mean(i) => Some(mean[i]),
            Holdable::Coefficient(c) => Some(coefficients[c]),
            Holdable::StdDev(i) => Some(sigma[(i, i)].max(0.0).sqrt()),
            Holdable::Covariance(i, j) => Some(sigma[(i, j)]),
            Holdable::Correlation(i, j) => {
                let unit = (sigma[(i, i)] * sigma[(j, j)]).sqrt();
                (unit > 0.0).then(|| (sigma[(i, j)] / unit).clamp(-1.0, 1.0))
            }
        }
    }
}
