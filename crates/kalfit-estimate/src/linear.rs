//! Linear covariance structures Σ = G0 + Σ_g θ_g G_g (Anderson 1973) in the solver's terms: blocks and linear
//! constraints.
//!
//! An element that is zero in every matrix is a structural zero. Among the other elements, as many pivots are chosen as
//! there are generators; with the generators in echelon form, each element that is no pivot is linear in the pivots,
//! which is one constraint.

use nalgebra::{DMatrix, DVector};

use crate::covariance::{Constraint, CovarianceMap, place, submatrix};
use crate::frame::Frame;
use kalfit_algebra::echelon::echelon;
use kalfit_algebra::symmetric;
use kalfit_model::{CovarianceStructure, StructureError};

/// Smallest eigenvalue of the correlations at which a start counts as well inside the cone.
const INTERIOR_EIGENVALUE: f64 = 0.05;
/// Maximum number of rounds of projections onto the structure and the cone.
const MAX_PROJECTIONS: usize = 500;
/// Coefficients of a constraint below this fraction of the largest coefficient are rounding errors.
const COEFFICIENT_ROUNDING: f64 = 1e-14;

/// A linear structure in η.
#[derive(Debug, Clone)]
pub(crate) struct LinearStructure {
    constant: DMatrix<f64>,
    generators: Vec<DMatrix<f64>>,
}

impl LinearStructure {
    pub(crate) fn new(
        structure: &CovarianceStructure,
        constant: &DMatrix<f64>,
        generators: &[DMatrix<f64>],
        frame: &Frame,
    ) -> Result<LinearStructure, StructureError> {
        let p = frame.scale.len();
        if !(structure.fixed.is_empty() && structure.equal.is_empty()) {
            return Err(StructureError::NotAlone);
        }
        check(constant, p, || "the constant of the linear covariance".to_owned())?;
        for (g, generator) in generators.iter().enumerate() {
            check(generator, p, || format!("generator {g} of the linear covariance"))?;
        }
        let constant = frame.covariance_in(constant);
        let generators: Vec<_> = generators.iter().map(|g| frame.covariance_in(g)).collect();
        Ok(LinearStructure { constant, generators })
    }

    /// Whether an element is zero in every member of the structure.
    pub(crate) fn is_zero(&self, i: usize, j: usize) -> bool {
        self.constant[(i, j)] == 0.0 && self.generators.iter().all(|g| g[(i, j)] == 0.0)
    }

    /// States with a variance that is not zero in every member of the structure.
    pub(crate) fn random(&self) -> Vec<usize> {
        (0..self.constant.nrows()).filter(|&i| !self.is_zero(i, i)).collect()
    }

    /// Constraints on the elements that are not structural zeros.
    pub(crate) fn constraints(&self, map: &CovarianceMap) -> Result<Vec<Constraint>, StructureError> {
        let all = (0..map.p).flat_map(|i| (0..=i).map(move |j| (i, j)));
        let (zero, free): (Vec<_>, Vec<_>) = all.partition(|&(i, j)| map.is_structural_zero(i, j));
        if zero.iter().any(|&(i, j)| !self.is_zero(i, j)) {
            return Err(StructureError::NoMember); // a state without variance has a covariance
        }
        // each generator is scaled to size one, so that a small one is not taken for zero
        let unit = |g: &DMatrix<f64>| if g.amax() > 0.0 { g.amax().recip() } else { 0.0 };
        let units: Vec<f64> = self.generators.iter().map(unit).collect();
        let span = DMatrix::from_fn(free.len(), units.len(), |s, g| self.generators[g][free[s]] * units[g]);
        let (pivots, span) = echelon(span);
        if pivots.len() < units.len() {
            return Err(StructureError::Dependent { generators: units.len(), rank: pivots.len() });
        }
        let others = (0..free.len()).filter(|s| !pivots.contains(s));
        Ok(others.map(|s| self.constraint(&free, &pivots, span.row(s).iter().copied(), s)).collect())
    }

    /// The constraint σ_s - Σ_g e_g σ_pivot(g) = (G0)_s - Σ_g e_g (G0)_pivot(g), divided by the largest coefficient.
    fn constraint(
        &self,
        free: &[(usize, usize)],
        pivots: &[usize],
        row: impl Iterator<Item = f64> + Clone,
        s: usize,
    ) -> Constraint {
        let size = row.clone().map(f64::abs).fold(1.0, f64::max);
        let by_pivot = pivots.iter().map(|&t| free[t]).zip(row).filter(|(_, e)| e.abs() > COEFFICIENT_ROUNDING * size);
        let own = (free[s], 1.0 / size);
        let terms: Vec<_> = std::iter::once(own).chain(by_pivot.map(|(at, e)| (at, -e / size))).collect();
        let value = terms.iter().map(|&(at, x)| x * self.constant[at]).sum();
        Constraint { terms: terms.into_iter().map(|((i, j), x)| (i, j, x)).collect(), value }
    }
}

fn check(matrix: &DMatrix<f64>, p: usize, what: impl Fn() -> String) -> Result<(), StructureError> {
    if matrix.shape() != (p, p) {
        let (rows, columns) = matrix.shape();
        return Err(StructureError::Shape { what: what(), rows, columns, states: p });
    }
    let places = (0..p).flat_map(|row| (row..p).map(move |column| (row, column)));
    for (row, column) in places {
        let (above, below) = (matrix[(row, column)], matrix[(column, row)]);
        let same = (above - below).abs() <= 1e-12 * above.abs().max(below.abs()); // false for NaN
        if !(same && above.is_finite()) {
            return Err(StructureError::Asymmetric { what: what(), row, column, above, below });
        }
    }
    Ok(())
}

/// A positive semidefinite Σ of one phase that (nearly) meets the constraints, near `wanted`: by alternating
/// projections onto the constraints and the cone, well inside the cone if possible.
pub(crate) fn member(map: &CovarianceMap, wanted: &DMatrix<f64>) -> DMatrix<f64> {
    let normals = crate::local::normals(&map.constraints, &map.elements);
    // in the metric tr(DD) an element off the diagonal counts twice
    let weight = |(i, j): (usize, usize)| if i == j { 1.0 } else { 0.5 };
    let metric = DVector::from_iterator(map.elements.count(), map.elements.all().map(weight));
    let transposed_normals = DMatrix::from_diagonal(&metric) * normals.transpose();
    let solve = symmetric::pseudo_inverse(&(&normals * &transposed_normals));
    let mut sigma = wanted.clone();
    for round in 0..MAX_PROJECTIONS {
        let step = &transposed_normals * (&solve * map.residual(&sigma));
        sigma -= map.elements.unpack(&step);
        let own = submatrix(&sigma, &map.random);
        let floor = if round < MAX_PROJECTIONS / 2 { INTERIOR_EIGENVALUE } else { 0.0 };
        let (size, values, vectors) = symmetric::scaled_eigen(&own);
        if values.first().is_none_or(|least| *least >= 0.5 * floor) {
            break;
        }
        let raised = DMatrix::from_diagonal(&DVector::from_iterator(values.len(), values.iter().map(|v| v.max(floor))));
        let inside = &vectors * raised * vectors.transpose();
        let inside = DMatrix::from_fn(own.nrows(), own.ncols(), |i, j| size[i] * inside[(i, j)] * size[j]);
        place(&mut sigma, &map.random, &inside);
    }
    sigma
}
