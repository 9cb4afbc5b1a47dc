//! Standard errors from the observed information at the optimum.

use nalgebra::{DMatrix, DVector};

use crate::estimate::{CovarianceMap, Estimate, Form, State};
use crate::infer::{Direction, Quantity};
use crate::linalg::symmetric::{self, pair, pairs};

/// Scaled eigenvalues of the information below this carry none.
const FLAT: f64 = 1e-10;
/// An element that takes part in an unidentified direction by more than this has no standard error.
const PART: f64 = 1e-6;

/// Standard errors, in the user's units. `None` where a quantity is fixed, not identified, or on the boundary.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertainty {
    /// Of μ (p).
    pub mean: Vec<Option<f64>>,
    /// Of the regression coefficients.
    pub coefficients: Vec<Option<f64>>,
    /// Of Σ (p × p).
    pub covariance: Vec<Vec<Option<f64>>>,
    /// Of the standard deviations (p).
    pub std_dev: Vec<Option<f64>>,
    /// Of the correlations (p × p).
    pub correlation: Vec<Vec<Option<f64>>>,
    /// Relative standard error of β in Σ = βΣ*.
    pub scale: Option<f64>,
    /// Blocks of Σ that are singular.
    pub boundary: Vec<Boundary>,
}

/// A block of Σ on the boundary of the positive semidefinite cone.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Boundary {
    /// Elements of the block.
    pub states: Vec<usize>,
    /// Its rank.
    pub rank: usize,
    /// Elements whose variance is zero.
    pub zero_variances: Vec<usize>,
}

/// Standard errors at an estimate.
pub fn uncertainty(estimate: &Estimate, unidentified: &[Direction]) -> Uncertainty {
    let state = &estimate.state;
    let map = &state.problem.covariance;
    let boundary = boundary(map, &state.place.point.root);
    let law = Law::new(state);
    let p = estimate.mean.len();
    let parts = |quantity: Quantity, k: usize| {
        let of = unidentified.iter().filter(|d| d.quantity == quantity);
        of.map(|d| d.direction[k].abs()).fold(0.0, f64::max) > PART
    };
    let on_boundary = |i: usize| boundary.iter().any(|b| b.states.contains(&i));
    let known = |i: usize, j: usize| !(on_boundary(i) || on_boundary(j) || parts(Quantity::Covariance, pair(i, j)));
    let sigma = &estimate.covariance;
    let mut covariance = vec![vec![None; p]; p];
    let mut correlation = vec![vec![None; p]; p];
    let mut std_dev = vec![None; p];
    for i in 0..p {
        for j in 0..=i {
            let error = known(i, j).then(|| law.sigma_error(i, j)).flatten();
            covariance[i][j] = error;
            covariance[j][i] = error;
        }
        std_dev[i] = covariance[i][i].filter(|_| sigma[(i, i)] > 0.0).map(|e| e / (2.0 * sigma[(i, i)].sqrt()));
    }
    for i in 0..p {
        for j in 0..i {
            let error =
                (known(i, j) && known(i, i) && known(j, j)).then(|| law.correlation_error(sigma, i, j)).flatten();
            correlation[i][j] = error;
            correlation[j][i] = error;
        }
    }
    let mean = (0..p).map(|i| if parts(Quantity::Mean, i) { None } else { law.mean_error(i) }).collect();
    let coefficients = (0..estimate.coefficients.len())
        .map(|c| if parts(Quantity::Mean, p + c) { None } else { law.coefficient_error(c) })
        .collect();
    let scale = matches!(map.form, Form::Scale(_)).then(|| law.scale_error(sigma)).flatten();
    Uncertainty { mean, coefficients, covariance, std_dev, correlation, scale, boundary }
}

/// Blocks of Σ that are singular.
fn boundary(map: &CovarianceMap, root: &DMatrix<f64>) -> Vec<Boundary> {
    let blocks: Vec<Vec<usize>> = match &map.form {
        Form::Factor(blocks) => blocks.clone(),
        Form::StdDevs(_, states) => states.iter().filter(|&&i| root.row(i).norm() == 0.0).map(|&i| vec![i]).collect(),
        Form::Scale(_) if root.amax() == 0.0 => vec![map.random.clone()],
        _ => Vec::new(),
    };
    let rank = |block: &[usize]| {
        let own = DMatrix::from_fn(block.len(), root.ncols(), |i, c| root[(block[i], c)]);
        let norms: Vec<f64> = (0..block.len()).map(|i| own.row(i).norm()).collect();
        let scaled =
            DMatrix::from_fn(
                block.len(),
                own.ncols(),
                |i, c| if norms[i] > 0.0 { own[(i, c)] / norms[i] } else { 0.0 },
            );
        let (values, _) = symmetric::eigen(&(&scaled * scaled.transpose()));
        values.iter().filter(|v| **v > 1e-11).count()
    };
    blocks
        .into_iter()
        .map(|states| Boundary {
            rank: rank(&states),
            zero_variances: states.iter().copied().filter(|&i| root.row(i).norm() == 0.0).collect(),
            states,
        })
        .filter(|b| b.rank < b.states.len())
        .collect()
}

/// The asymptotic normal law of the free coordinates, carried to mean coordinates and elements of Σ.
pub(crate) struct Law<'a> {
    state: &'a State,
    /// Covariance of the coordinates along the tangent basis.
    coordinates: DMatrix<f64>,
    /// d(μ in η, γ; σ pairs) / d(tangent coordinates).
    jacobian: DMatrix<f64>,
}

impl<'a> Law<'a> {
    pub(crate) fn new(state: &'a State) -> Law<'a> {
        let tangent = &state.place.tangent;
        let mean = state.problem.mean.jacobian();
        let (m, s) = (mean.nrows(), pairs(state.place.point.mean.len()));
        let mut jacobian = DMatrix::zeros(m + s, tangent.mean + tangent.jacobian.ncols());
        jacobian.view_mut((0, 0), mean.shape()).copy_from(&mean);
        jacobian.view_mut((m, tangent.mean), tangent.jacobian.shape()).copy_from(&tangent.jacobian);
        Law { state, coordinates: inverse(&tangent.information), jacobian: jacobian * &tangent.basis }
    }

    /// Inverse of the information along the tangent basis.
    pub(crate) fn coordinates(&self) -> &DMatrix<f64> {
        &self.coordinates
    }

    fn variance(&self, weights: &DVector<f64>) -> Option<f64> {
        // in η, where sizes have a meaning whatever the user's units
        let unit = Some(weights.amax()).filter(|unit| *unit > 0.0)?;
        let along = self.jacobian.transpose() * (weights / unit);
        let size = along.amax();
        let variance = along.dot(&(&self.coordinates * &along)) * unit * unit;
        (size > 1e-12 && variance.is_finite() && variance > 0.0).then(|| variance.sqrt())
    }

    fn weights(&self, entries: &[(usize, f64)]) -> DVector<f64> {
        let mut weights = DVector::zeros(self.jacobian.nrows());
        entries.iter().for_each(|&(k, w)| weights[k] += w);
        weights
    }

    fn scale(&self) -> &[f64] {
        &self.state.problem.classes.frame.scale
    }

    /// Place of σ_ij among the rows of the jacobian, with its unit.
    fn sigma(&self, i: usize, j: usize, weight: f64) -> (usize, f64) {
        let p = self.scale().len();
        let rows = p + self.state.problem.mean.regressors.len();
        (rows + pair(i, j), weight * self.scale()[i] * self.scale()[j])
    }

    fn mean_error(&self, i: usize) -> Option<f64> {
        self.variance(&self.weights(&[(i, self.scale()[i])]))
    }

    fn coefficient_error(&self, c: usize) -> Option<f64> {
        let row = self.scale().len() + c;
        self.variance(&self.weights(&[(row, self.state.problem.mean.coefficient_scale[c].recip())]))
    }

    fn sigma_error(&self, i: usize, j: usize) -> Option<f64> {
        self.variance(&self.weights(&[self.sigma(i, j, 1.0)]))
    }

    /// Delta method for ρ = σ_ij / √(σ_ii σ_jj).
    fn correlation_error(&self, sigma: &DMatrix<f64>, i: usize, j: usize) -> Option<f64> {
        let (vi, vj) = (sigma[(i, i)], sigma[(j, j)]);
        if !(vi > 0.0 && vj > 0.0) {
            return None;
        }
        let unit = (vi * vj).sqrt();
        let rho = sigma[(i, j)] / unit;
        let entries =
            [self.sigma(i, j, 1.0 / unit), self.sigma(i, i, -0.5 * rho / vi), self.sigma(j, j, -0.5 * rho / vj)];
        self.variance(&self.weights(&entries))
    }

    /// Relative standard error of a common factor on Σ, read off its largest variance.
    fn scale_error(&self, sigma: &DMatrix<f64>) -> Option<f64> {
        let i = (0..sigma.nrows()).max_by(|&a, &b| sigma[(a, a)].total_cmp(&sigma[(b, b)]))?;
        (sigma[(i, i)] > 0.0).then(|| self.sigma_error(i, i).map(|e| e / sigma[(i, i)])).flatten()
    }
}

/// Inverse after scaling to unit diagonal; flat and negative directions count as no information and are left out.
fn inverse(information: &DMatrix<f64>) -> DMatrix<f64> {
    let n = information.nrows();
    let unit = |i: usize| if information[(i, i)] > 0.0 { information[(i, i)].sqrt().recip() } else { 0.0 };
    let scale = DVector::from_fn(n, |i, _| unit(i));
    let scaled = DMatrix::from_fn(n, n, |i, j| scale[i] * information[(i, j)] * scale[j]);
    let (values, vectors) = symmetric::eigen(&scaled);
    let inverse = values.iter().map(|&v| if v > FLAT { v.recip() } else { 0.0 });
    let inverse = &vectors * DMatrix::from_diagonal(&DVector::from_iterator(n, inverse)) * vectors.transpose();
    DMatrix::from_fn(n, n, |i, j| scale[i] * inverse[(i, j)] * scale[j])
}
