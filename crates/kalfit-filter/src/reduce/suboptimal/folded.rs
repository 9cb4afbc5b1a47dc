//! Estimates of one test, with η', the unknown part of the noise of x_0, eliminated by folding.
#![expect(non_snake_case, reason = "the letters of the theory: G, R, T, T_B")]

use nalgebra::{DMatrix, DVector};

use crate::reduce::Terminal;
use crate::reduce::root::settle;
use crate::reduce::suboptimal::conditioned::Conditioned;
use crate::reduce::suboptimal::matrices::{append, fold as narrow};
use kalfit_algebra::fold::fold;

/// A diagonal entry of R up to this fraction of the norm of its column counts as zero information.
const UNINFORMED: f64 = 1e-12;

/// [I 0 0; G T y; 0 T_B y_B] folded into R of (η', σ), data and residual.
pub(super) struct FoldedEstimates {
    /// R with data and residual in the last column, (k + q + 1)², row-major.
    info: Vec<f64>,
    k: usize,
    q: usize,
    /// y_B; `white` is y.
    taken: DVector<f64>,
    white: DVector<f64>,
}

impl FoldedEstimates {
    pub(super) fn new(conditioned: &Conditioned, u: &DVector<f64>) -> FoldedEstimates {
        let (k, rows) = (conditioned.free, &conditioned.rows);
        let q = rows.ncols() - k;
        let taken = &conditioned.B * u;
        let white = &conditioned.W * u - &conditioned.C * &taken;
        let width = k + q + 1;
        let mut info = vec![0.0; width * width];
        (0..k).for_each(|i| info[i * (width + 1)] = 1.0);
        let mut rows_with_data = Vec::with_capacity(rows.nrows() * width);
        for (row, y) in rows.row_iter().zip(white.iter().chain(&taken)) {
            rows_with_data.extend(row.iter().chain([y]));
        }
        fold(&mut info, &mut rows_with_data, width);
        FoldedEstimates { info, k, q, taken, white }
    }

    fn at(&self, i: usize, j: usize) -> f64 {
        self.info[i * (self.k + self.q + 1) + j]
    }

    /// x̂_K, Ψ_K, P_K; `known` is φa + s̄_1.
    pub(super) fn terminal(&self, conditioned: &Conditioned, known: DVector<f64>) -> Terminal {
        let (k, q, r) = (self.k, self.q, self.white.len());
        let rows = &conditioned.rows;
        let (G, T) = (rows.view((0, 0), (r, k)), rows.view((0, k), (r, q)));
        let T_B = rows.view((r, k), (rows.nrows() - r, q));
        // η' at σ: mean R⁻¹(d - R_σ σ), root of the covariance R⁻¹
        let R = DMatrix::from_fn(k, k, |i, j| self.at(i, j));
        let through = &conditioned.from_free - &conditioned.from_white * G;
        let through =
            R.transpose().solve_lower_triangular(&through.transpose()).expect("1 or more on the diagonal").transpose();
        let d = DVector::from_fn(k, |i, _| self.at(i, k + q));
        let R_sigma = DMatrix::from_fn(k, q, |i, j| self.at(i, k + j));
        let mean = known + &conditioned.from_taken * &self.taken + &conditioned.from_white * &self.white + &through * d;
        let sensitivity =
            &conditioned.phi_E - &conditioned.from_taken * T_B - &conditioned.from_white * T - &through * R_sigma;
        let mut root = conditioned.rest.clone();
        append(&mut root, 0, &through);
        narrow(&mut root);
        Terminal { mean, sensitivity, root }
    }

    /// (constant, d, R packed) of σ.
    pub(super) fn reduction(self, conditioned: &Conditioned) -> (f64, Vec<f64>, Vec<f64>) {
        let (k, q) = (self.k, self.q);
        let logs: f64 = (0..k).map(|i| self.at(i, i).ln()).sum();
        let random = self.white.len() + self.taken.len();
        let mut R: Vec<f64> = (0..q * q).map(|at| self.at(k + at / q, k + at % q)).collect();
        let mut data: Vec<f64> = (0..q).map(|i| self.at(k + i, k + q)).collect();
        let (mut residual, mut settled) = (self.at(k + q, k + q).powi(2), Vec::new());
        settle(&mut R, q, UNINFORMED, &mut settled);
        settled.iter().for_each(|one| one.apply(&mut data, &mut residual));
        let constant = -0.5 * (random as f64 * std::f64::consts::TAU.ln() + residual) - conditioned.log_spread - logs;
        let factor = (0..q).flat_map(|j| (0..=j).map(move |i| (i, j))).map(|(i, j)| R[i * q + j]).collect();
        (constant, data, factor)
    }
}
