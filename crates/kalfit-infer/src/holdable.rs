//! Quantities that can be held at a value, and that have an error and an interval.

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
    pub fn value(self, mean: &[f64], coefficients: &[f64], sigma: &DMatrix<f64>) -> Option<f64> {
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

/// One of each quantity, by its kind.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantities<T> {
    /// Of μ (p).
    pub mean: Vec<T>,
    /// Of the regression coefficients.
    pub coefficients: Vec<T>,
    /// Of the standard deviations (p).
    pub std_dev: Vec<T>,
    /// Of Σ (p × p).
    pub covariance: Vec<Vec<T>>,
    /// Of the correlations (p × p).
    pub correlation: Vec<Vec<T>>,
}

impl<T: Copy> Quantities<T> {
    /// The same of each; so many are in μ, and so many regression coefficients.
    pub(crate) fn all(one: T, p: usize, coefficients: usize) -> Quantities<T> {
        Quantities {
            mean: vec![one; p],
            coefficients: vec![one; coefficients],
            std_dev: vec![one; p],
            covariance: vec![vec![one; p]; p],
            correlation: vec![vec![one; p]; p],
        }
    }

    /// That of a quantity.
    pub fn of(&self, what: Holdable) -> T {
        match what {
            Holdable::Mean(i) => self.mean[i],
            Holdable::Coefficient(c) => self.coefficients[c],
            Holdable::StdDev(i) => self.std_dev[i],
            Holdable::Covariance(i, j) => self.covariance[i][j],
            Holdable::Correlation(i, j) => self.correlation[i][j],
        }
    }

    /// Puts one in place, in both triangles.
    pub(crate) fn set(&mut self, what: Holdable, one: T) {
        match what {
            Holdable::Mean(i) => self.mean[i] = one,
            Holdable::Coefficient(c) => self.coefficients[c] = one,
            Holdable::StdDev(i) => self.std_dev[i] = one,
            Holdable::Covariance(i, j) => (self.covariance[i][j], self.covariance[j][i]) = (one, one),
            Holdable::Correlation(i, j) => (self.correlation[i][j], self.correlation[j][i]) = (one, one),
        }
    }
}
