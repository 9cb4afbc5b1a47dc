//! Measurements of estimated states without any noise (theory §13).
//!
//! Each such measurement is a row of Cξ = g, in addition to (c, y, J).

use nalgebra::{DMatrix, DVector};

use kalfit_algebra::symmetric;

/// The rows Cξ = g that a test measures exactly, independent of each other.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ExactRows {
    /// C, q × p by rows.
    pub coefficients: Vec<f64>,
    /// g, q numbers.
    pub values: Vec<f64>,
}

impl ExactRows {
    /// (row k of C, g_k) for each k; p must not be zero.
    pub fn rows(&self, p: usize) -> impl Iterator<Item = (&[f64], f64)> {
        self.coefficients.chunks_exact(p).zip(self.values.iter().copied())
    }

    /// C as a matrix, q × p.
    pub fn matrix(&self, p: usize) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.values.len(), p, &self.coefficients)
    }

    /// The solutions ξ of Cξ = g, as a function of the p - q elements of ξ that C leaves free.
    pub fn free_states(&self, p: usize) -> FreeStates {
        let width = p + 1;
        let mut rows: Vec<Vec<f64>> = self.rows(p).map(|(row, value)| [row, &[value]].concat()).collect();
        let mut pivots: Vec<usize> = Vec::with_capacity(rows.len());
        for i in 0..rows.len() {
            let candidates = (0..p).filter(|k| !pivots.contains(k)).rev();
            let Some(pivot) = candidates.max_by(|a, b| rows[i][*a].abs().total_cmp(&rows[i][*b].abs())) else { break };
            let scale = rows[i][pivot].recip();
            rows[i].iter_mut().for_each(|x| *x *= scale);
            let own = rows[i].clone();
            for (_, row) in rows.iter_mut().enumerate().filter(|(k, _)| *k != i) {
                let multiplier = row[pivot];
                (0..width).for_each(|k| row[k] -= multiplier * own[k]);
            }
            pivots.push(pivot);
        }
        let states: Vec<usize> = (0..p).filter(|k| !pivots.contains(k)).collect();
        let (mut origin, mut basis) = (DVector::zeros(p), DMatrix::zeros(p, states.len()));
        for (c, &state) in states.iter().enumerate() {
            basis[(state, c)] = 1.0;
            pivots.iter().zip(&rows).for_each(|(&pivot, row)| basis[(pivot, c)] = -row[state]);
        }
        pivots.iter().zip(&rows).for_each(|(&pivot, row)| origin[pivot] = row[p]);
        FreeStates { origin, basis }
    }
}

/// All ξ with Cξ = g: ξ = origin + basis η, with η the free elements of ξ.
#[derive(Debug, Clone)]
pub struct FreeStates {
    /// ξ at η = 0, p numbers.
    pub origin: DVector<f64>,
    /// Derivative of ξ with respect to η, p × (p - q).
    pub basis: DMatrix<f64>,
}

impl FreeStates {
    /// Least eigenvalue of the information on η, scaled to unit diagonal, at which a direction counts as observed.
    const MIN_INFORMATION: f64 = 1e-11;

    /// (rank of R × basis, least ‖d - Rξ‖² over all ξ with Cξ = g), with `factor` R and `data` d.
    pub fn least_squares(&self, factor: &DMatrix<f64>, data: &[f64]) -> (usize, f64) {
        let (left, data) = (factor * &self.basis, DVector::from_column_slice(data) - factor * &self.origin);
        let size = |k: usize| Some(left.column(k).norm()).filter(|size| *size > 0.0).unwrap_or(1.0);
        let scaled = DMatrix::from_fn(left.nrows(), left.ncols(), |i, k| left[(i, k)] / size(k));
        let observed = symmetric::range(&(scaled.transpose() * &scaled), |value| value >= FreeStates::MIN_INFORMATION);
        let directions = &scaled * &observed;
        let residual = &data
            - &directions
                * (directions.transpose() * &directions).cholesky().map_or_else(
                    || DVector::zeros(observed.ncols()),
                    |own| own.solve(&(directions.transpose() * &data)),
                );
        (observed.ncols(), residual.norm_squared())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_fitted_where_the_exact_rows_hold() {
        // the solutions of ξ_1 + ξ_2 = 3 are ξ = (3 - x, x); of the rows (1, 1), (0, 2) with d = (3.5, 2) the first is
        // off by a half
        let exact = ExactRows { coefficients: vec![1.0, 1.0], values: vec![3.0] };
        let free_states = exact.free_states(2);
        let upper = |[a, b, c]: [f64; 3]| DMatrix::from_row_slice(2, 2, &[a, b, 0.0, c]);
        let back = &free_states.origin + &free_states.basis * DVector::from_element(1, 0.7);
        assert!((back[0] + back[1] - 3.0).abs() < 1e-15, "{back}");
        for unit in [1e-9, 1.0, 1e9] {
            let (rank, left) = free_states.least_squares(&upper([unit, unit, 2.0 * unit]), &[3.5 * unit, 2.0 * unit]);
            assert!(rank == 1 && (left / unit.powi(2) - 0.25).abs() < 1e-13, "{unit}: {rank} {left}");
        }
        // a row parallel to C has no information on η
        let (rank, left) = free_states.least_squares(&upper([2.0, 2.0, 0.0]), &[6.5, 0.0]);
        assert!(rank == 0 && (left - 0.25).abs() < 1e-13, "{rank} {left}");
        // no element of ξ is free
        let all = ExactRows { coefficients: vec![1.0, 1.0, 1.0, -1.0], values: vec![3.0, 1.0] };
        let (rank, left) = all.free_states(2).least_squares(&upper([1.0, 0.0, 1.0]), &[2.5, 1.0]);
        assert!(rank == 0 && (left - 0.25).abs() < 1e-13, "{rank} {left}");
    }
}
