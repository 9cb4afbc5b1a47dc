//! What a filter believes: its covariance, and the gains that follow.
#![expect(non_snake_case, reason = "the letters of the theory: K, M, P, Q, R, S")]

use nalgebra::DMatrix;

use crate::model::Filter;
use crate::reduce::semidefinite::{NotSemidefinite, ldl};

/// The covariance of [x_k; x_0] as the filter has it: its own, right or wrong.
#[derive(Debug, Clone)]
pub(super) struct Believed<'a> {
    filter: &'a Filter,
    /// P, 2n × 2n.
    P: DMatrix<f64>,
}

impl<'a> Believed<'a> {
    pub(super) fn new(filter: &'a Filter) -> Believed<'a> {
        let n = filter.covariance.nrows();
        Believed { filter, P: DMatrix::from_fn(2 * n, 2 * n, |i, j| filter.covariance[(i % n, j % n)]) }
    }

    pub(super) fn predict(&mut self, phi: &DMatrix<f64>, Q: &DMatrix<f64>) {
        let n = phi.nrows();
        let now = phi * self.P.view((0, 0), (n, n)) * phi.transpose() + Q;
        let cross = phi * self.P.view((0, n), (n, n));
        self.P.view_mut((0, 0), (n, n)).copy_from(&now);
        self.P.view_mut((0, n), (n, n)).copy_from(&cross);
        self.P.view_mut((n, 0), (n, n)).copy_from(&cross.transpose());
    }

    /// Takes all measurements of a step at once. Returns [K; K⁰], 2n × m, rows of considered states zero in both: the gain
    /// minimises the variance of each other state, and none of it goes to these. (Schmidt 1966)
    ///
    /// Joseph's form, P ← (I - KM)P(I - KM)' + KRK', which holds for any gain.
    pub(super) fn update(&mut self, M: &DMatrix<f64>, R: &DMatrix<f64>) -> Result<DMatrix<f64>, NotSemidefinite> {
        let n = M.ncols();
        let MP = M * self.P.rows(0, n);
        let S = MP.columns(0, n) * M.transpose() + R;
        let mut K = solve(&S, MP.clone())?.transpose();
        for &state in &self.filter.consider {
            K.row_mut(state).fill(0.0);
            K.row_mut(n + state).fill(0.0);
        }
        let left = &self.P - &K * MP;
        let back = left.columns(0, n) * M.transpose();
        let P = left - back * K.transpose() + &K * R * K.transpose();
        self.P = (&P + P.transpose()) * 0.5;
        Ok(K)
    }
}

/// S⁻¹b for a positive semidefinite S, m × m; what S knows already has no part in it.
fn solve(S: &DMatrix<f64>, mut b: DMatrix<f64>) -> Result<DMatrix<f64>, NotSemidefinite> {
    let m = S.nrows();
    let mut factor = ((S + S.transpose()) * 0.5).as_slice().to_vec();
    ldl(&mut factor, m)?;
    for mut column in b.column_iter_mut() {
        for i in 0..m {
            let known: f64 = (0..i).map(|k| factor[i * m + k] * column[k]).sum();
            column[i] -= known;
        }
        for i in 0..m {
            let pivot = factor[i * m + i];
            column[i] = if pivot > 0.0 { column[i] / pivot } else { 0.0 };
        }
        for i in (0..m).rev() {
            let known: f64 = (i + 1..m).map(|k| factor[k * m + i] * column[k]).sum();
            column[i] -= known;
        }
    }
    Ok(b)
}
