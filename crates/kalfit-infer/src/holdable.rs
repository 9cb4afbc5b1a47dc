//! Quantities that can be held at a value, and that have a standard error and an interval.

use nalgebra::DMatrix;

/// An estimated quantity, in the user's units. Indices refer to μ and Σ of all phases together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Holdable {
    /// An element of μ.
    Mean(usize),
    /// A regression coefficient, by index.
    Coefficient(usize),
    /// A standard deviation: the square root of a variance in Σ.
    StdDev(usize),
    /// A correlation (i > j).
    Correlation(usize, usize),
    /// An element of Σ (i ≥ j).
    Covariance(usize, usize),
}

impl Holdable {
    /// Value of the quantity at given μ, regression coefficients and Σ; `None` for a correlation where σ_ii or σ_jj is
    /// zero.
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

/// One entry for each quantity, by kind.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantities<T> {
    /// One entry for each element of μ (p).
    pub mean: Vec<T>,
    /// One entry for each regression coefficient.
    pub coefficients: Vec<T>,
    /// One entry for each standard deviation (p).
    pub std_dev: Vec<T>,
    /// One entry for each element of Σ (p × p).
    pub covariance: Vec<Vec<T>>,
    /// One entry for each correlation (p × p).
    pub correlation: Vec<Vec<T>>,
}

impl<T: Copy> Quantities<T> {
    /// The entry `one` for every quantity, with p elements of μ and `coefficients` regression coefficients.
    pub(crate) fn all(one: T, p: usize, coefficients: usize) -> Quantities<T> {
        Quantities {
            mean: vec![one; p],
            coefficients: vec![one; coefficients],
            std_dev: vec![one; p],
            covariance: vec![vec![one; p]; p],
            correlation: vec![vec![one; p]; p],
        }
    }

    /// The entry of a quantity.
    pub fn of(&self, what: Holdable) -> T {
        match what {
            Holdable::Mean(i) => self.mean[i],
            Holdable::Coefficient(c) => self.coefficients[c],
            Holdable::StdDev(i) => self.std_dev[i],
            Holdable::Covariance(i, j) => self.covariance[i][j],
            Holdable::Correlation(i, j) => self.correlation[i][j],
        }
    }

    /// Sets the entry of a quantity, in both triangles of a matrix.
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
