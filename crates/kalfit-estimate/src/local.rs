//! A function of (mean coordinates, Σ) near a point: value, score and information, also in free coordinates.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::chart::Chart;
use crate::covariance::{Constraint, CovarianceMap};
use crate::point::Point;
use crate::sums::Sums;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::sparse::Sparse;
use kalfit_algebra::symmetric;

/// Value and derivatives at a point, in mean coordinates and the elements of Σ ([`Elements`]).
#[derive(Debug, Clone)]
pub struct Local {
    /// Value of the function.
    pub value: f64,
    /// Gradient by the mean coordinates.
    pub mean_score: DVector<f64>,
    /// Information on the mean coordinates.
    pub mean_information: DMatrix<f64>,
    /// G: the value changes by tr(G dΣ).
    pub score: DMatrix<f64>,
    /// -∂²/∂mean ∂σ, mean coordinates × elements.
    pub cross: DMatrix<f64>,
    /// -∂²/∂σ ∂σ', elements × elements.
    pub information: Arc<DMatrix<f64>>,
    /// Σ_j W_j, p × p: the scale of information on Σ.
    pub weight: DMatrix<f64>,
    /// Covariance of the free mean coordinates at a known Σ, under the restricted likelihood.
    pub(crate) mean_covariance: Option<DMatrix<f64>>,
}

impl Local {
    /// Value and derivatives from sums. The second derivatives by the elements of Σ are moved out of the sums.
    pub fn of(sums: &mut Sums) -> Local {
        Local {
            value: sums.value,
            mean_score: sums.mean_score.clone(),
            mean_information: sums.mean_information.clone(),
            score: sums.score(),
            cross: sums.cross_information(),
            information: Arc::new(sums.observed_information()),
            weight: sums.weight.clone(),
            mean_covariance: sums.restricted.as_ref().map(|r| r.covariance.clone()),
        }
    }

    /// Number of mean coordinates plus number of elements of Σ.
    pub(crate) fn gradient_size(&self) -> usize {
        self.mean_score.len() + self.information.nrows()
    }
}

/// A function of (mean coordinates, Σ) that is maximised.
pub trait Objective {
    /// Value and derivatives; `None` where the function is not defined. `near` is the covariance of the free mean
    /// coordinates at a nearby point, if known.
    fn local(&self, point: &Point, near: Option<&DMatrix<f64>>) -> Option<Local>;
    /// d(mean coordinates) / d(free mean coordinates).
    fn mean_jacobian(&self) -> &DMatrix<f64>;
    /// The point with its free mean coordinates moved.
    fn move_mean(&self, point: &Point, step: &[f64]) -> Point;
}

/// The derivatives in free coordinates (mean, then ψ), along the tangent space of the constraints.
#[derive(Debug, Clone)]
pub struct Tangent {
    /// Number of free mean coordinates.
    pub mean: usize,
    /// Coordinates ψ around the root F of Σ = FF'.
    pub chart: Chart,
    /// dσ/dψ, elements × ψ.
    pub jacobian: Sparse,
    /// Columns span the directions in (mean, ψ) that keep the constraints.
    pub basis: Sparse,
    /// Gradient along `basis`.
    pub gradient: DVector<f64>,
    /// Negative Hessian of the Lagrangian along `basis`.
    pub information: DMatrix<f64>,
    /// Natural length of a step along each column of `basis`, by [`natural_sizes`].
    pub sizes: Vec<f64>,
    /// Lagrange multipliers: dℓ_max / d(constraint value).
    pub multipliers: Vec<f64>,
    /// G - Λ, p × p: the score less the Lagrange multipliers of the constraints on Σ.
    pub residual_score: DMatrix<f64>,
}

impl Tangent {
    pub(crate) fn new(
        local: &Local,
        mean_jacobian: &DMatrix<f64>,
        map: &CovarianceMap,
        root: &DMatrix<f64>,
    ) -> Tangent {
        let chart = map.chart(root);
        let jacobian = chart.jacobian_at(&chart.root);
        let q = mean_jacobian.ncols();
        let packed = map.elements.pack_score(&local.score);
        let sigma_gradient = jacobian.transposed_times(&packed);
        let in_sigma = normals(&map.constraints, &map.elements);
        let normals = jacobian.after(&in_sigma);
        let constraints = (&map.constraints[..], &map.elements);
        let multipliers = multipliers(constraints, (&in_sigma, &normals), &packed, &sigma_gradient);
        let residual_score = &local.score - multiplier_matrix(&map.constraints, multipliers.as_slice(), map.p);
        let held = held_coordinates(&chart, &sigma_gradient);
        let basis = tangent_basis(q, &normals, &held, jacobian.ncols());
        let sizes = coordinate_sizes(mean_jacobian, &map.regressors, &chart, root);
        let mut tangent = Tangent {
            mean: q,
            jacobian,
            gradient: DVector::zeros(0),
            information: DMatrix::zeros(0, 0),
            sizes: basis.columns().map(|c| natural_length(c.iter().map(|&(row, x)| (x, sizes[row])))).collect(),
            chart,
            basis,
            multipliers: multipliers.as_slice().to_vec(),
            residual_score,
        };
        tangent.gradient = tangent.pulled_back(mean_jacobian, &local.mean_score, &sigma_gradient);
        tangent.set_information(local, mean_jacobian);
        tangent
    }

    /// The gradient along the basis, from the derivatives by mean coordinates and by ψ.
    pub fn pulled_back(
        &self,
        mean_jacobian: &DMatrix<f64>,
        of_mean: &DVector<f64>,
        of_psi: &DVector<f64>,
    ) -> DVector<f64> {
        let of_mean = mean_jacobian.transpose() * of_mean;
        let all = of_mean.iter().chain(of_psi.iter()).copied();
        self.basis.transposed_times(&DVector::from_iterator(self.basis.nrows(), all))
    }

    /// Computes the information along the basis.
    pub(crate) fn set_information(&mut self, local: &Local, mean_jacobian: &DMatrix<f64>) {
        let all = free_information(local, mean_jacobian, &self.chart, &self.jacobian, &self.residual_score);
        self.information = along(&self.basis, all);
    }
}

/// The information along a basis, from the information in free coordinates.
fn along(basis: &Sparse, mut information: DMatrix<f64>) -> DMatrix<f64> {
    if !basis.is_identity() {
        return basis.congruence(&information);
    }
    information.fill_lower_triangle_with_upper_triangle();
    information
}

/// The natural size of each element of ξ, in η: √(1 + Σ_ii), from the variance over tests and the unit variance that
/// one test cannot reduce. Information is compared in units of natural sizes: a large Σ makes the information on μ and
/// Σ small even where the data are as good as data can be.
pub fn natural_sizes(root: &DMatrix<f64>) -> Vec<f64> {
    root.row_iter().map(|row| (1.0 + row.norm_squared()).sqrt()).collect()
}

/// Natural length of a step along Σ weight × coordinate, 1/√(Σ (weight/size)²): the smallest size counts most, as in
/// the information.
pub fn natural_length(parts: impl Iterator<Item = (f64, f64)>) -> f64 {
    let sum: f64 = parts.map(|(weight, size)| (weight / size).powi(2)).sum();
    if sum > 0.0 { sum.sqrt().recip() } else { 1.0 }
}

/// Natural sizes of the free coordinates (mean, then ψ).
fn coordinate_sizes(
    mean_jacobian: &DMatrix<f64>,
    regressors: &[usize],
    chart: &Chart,
    root: &DMatrix<f64>,
) -> Vec<f64> {
    let sizes = natural_sizes(root);
    // a regression coefficient, whose covariates are of size one, has the natural size of the state that the
    // coefficient acts on
    let of = |i: usize| sizes[if i < sizes.len() { i } else { regressors[i - sizes.len()] }];
    let mean = mean_jacobian.column_iter().map(|c| natural_length(c.iter().enumerate().map(|(i, x)| (*x, of(i)))));
    let psi = chart.coordinates.iter().map(|entries| natural_length(entries.iter().map(|&(i, _, x)| (x, sizes[i]))));
    mean.chain(psi).collect()
}

/// Gradients of the constraints by the elements of Σ, constraints × elements.
pub(crate) fn normals(constraints: &[Constraint], elements: &Elements) -> DMatrix<f64> {
    let mut normals = DMatrix::zeros(constraints.len(), elements.count());
    for (m, constraint) in constraints.iter().enumerate() {
        for &(i, j, x) in &constraint.terms {
            normals[(m, elements.index(i, j))] += x;
        }
    }
    normals
}

/// Lagrange multipliers. Where all elements of a constraint belong to zero variances, no step in ψ changes the
/// constraint (dσ/dψ = 0): the multiplier is then the least-squares one, which makes the remaining score orthogonal to
/// the gradient of the constraint, as the certificate needs.
fn multipliers(
    (constraints, elements): (&[Constraint], &Elements),
    (in_sigma, normals): (&DMatrix<f64>, &DMatrix<f64>),
    score: &DVector<f64>,
    gradient: &DVector<f64>,
) -> DVector<f64> {
    if normals.nrows() == 0 {
        return DVector::zeros(0);
    }
    let mut found = symmetric::pseudo_solve(&(normals * normals.transpose()), &(normals * gradient));
    let inactive: Vec<usize> = (0..normals.nrows()).filter(|&m| normals.row(m).amax() == 0.0).collect();
    if !inactive.is_empty() {
        // under x σ_ij + y σ_kl = 0, σ_kl grows |x/y| times as fast as σ_ij: sizes in that ratio give both parts of the
        // score equal weight
        let mut size = DVector::from_element(score.len(), 1.0);
        for &m in &inactive {
            if let [(i, j, x), (k, l, y)] = constraints[m].terms[..] {
                size[elements.index(k, l)] = size[elements.index(i, j)] * (x / y).abs();
            }
        }
        let own = in_sigma.select_rows(&inactive) * DMatrix::from_diagonal(&size);
        let unexplained_score = (score - in_sigma.transpose() * &found).component_mul(&size);
        let shared = symmetric::pseudo_solve(&(&own * own.transpose()), &(&own * unexplained_score));
        inactive.iter().zip(shared.iter()).for_each(|(&m, share)| found[m] = *share);
    }
    found
}

/// Λ with tr(Λ dΣ) = Σ multiplier × d(constraint).
fn multiplier_matrix(constraints: &[Constraint], multipliers: &[f64], p: usize) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(p, p);
    for (constraint, multiplier) in constraints.iter().zip(multipliers) {
        for &(i, j, x) in &constraint.terms {
            let half = 0.5 * multiplier * x;
            matrix[(i, j)] += half;
            matrix[(j, i)] += half;
        }
    }
    matrix
}

/// Negative Hessian of the Lagrangian in (mean, ψ): the information by the chain rule, less tr((G - Λ) ∂²Σ/∂ψ∂ψ').
fn free_information(
    local: &Local,
    mean_jacobian: &DMatrix<f64>,
    chart: &Chart,
    jacobian: &Sparse,
    residual_score: &DMatrix<f64>,
) -> DMatrix<f64> {
    let (q, n) = (mean_jacobian.ncols(), jacobian.ncols());
    let mut information = DMatrix::zeros(q + n, q + n);
    let mean = mean_jacobian.transpose() * &local.mean_information * mean_jacobian;
    let cross = jacobian.after(&(mean_jacobian.transpose() * &local.cross));
    information.view_mut((0, 0), (q, q)).copy_from(&mean);
    information.view_mut((0, q), (q, n)).copy_from(&cross);
    information.view_mut((q, 0), (n, q)).copy_from(&cross.transpose());
    let mut sigma = information.view_mut((q, q), (n, n));
    jacobian.congruence_into(&local.information, &mut sigma);
    for l in 0..n {
        for k in 0..n {
            sigma[(k, l)] -= chart.second_order(residual_score, (k, l));
        }
    }
    information
}

/// Indices of the bounded coordinates that are at zero and that the gradient would move below zero.
fn held_coordinates(chart: &Chart, gradient: &DVector<f64>) -> Vec<usize> {
    let at_zero = |&k: &usize| chart.bounded[k].is_some_and(|value| value <= 0.0) && gradient[k] <= 0.0;
    (0..chart.bounded.len()).filter(at_zero).collect()
}

/// Orthonormal columns that span (all of the mean) × (null space of the normals), without the held coordinates.
fn tangent_basis(q: usize, normals: &DMatrix<f64>, held: &[usize], n: usize) -> Sparse {
    let kept: Vec<usize> = (0..n).filter(|k| !held.contains(k)).collect();
    let mut basis = Sparse::with_height(q + n);
    (0..q).for_each(|k| basis.push([(k, 1.0)].into_iter()));
    if normals.nrows() == 0 {
        kept.iter().for_each(|k| basis.push([(q + k, 1.0)].into_iter()));
        return basis;
    }
    let normals = normals.select_columns(&kept);
    let (values, vectors) = symmetric::eigen(&(normals.transpose() * &normals));
    let floor = values.last().copied().unwrap_or(0.0) * 1e-12;
    for c in (0..values.len()).filter(|&c| values[c] <= floor) {
        basis.push(kept.iter().zip(vectors.column(c).iter()).map(|(k, x)| (q + k, *x)));
    }
    basis
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The length satisfies 1/length² = Σ (weight/size)², and is one where all weights are zero.
    #[test]
    fn the_smallest_size_counts_most() {
        let found = natural_length([(2.0, 1.0), (3.0, 0.5), (0.0, 1e-9)].into_iter());
        let expected = 1.0 / f64::sqrt(4.0 + 36.0);
        assert!((found - expected).abs() < 1e-15, "{found} {expected}");
        assert_eq!(natural_length([(0.0, 3.0)].into_iter()), 1.0);
        assert_eq!(natural_length(std::iter::empty()), 1.0);
    }
}
