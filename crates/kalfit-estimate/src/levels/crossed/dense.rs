//! The system over all levels of the crossed factors of a part (theory §16, (A2), (A3)).
#![expect(non_snake_case, reason = "K, C, N, L are the letters of the theory")]

use std::sync::OnceLock;

use nalgebra::DMatrix;

use crate::levels::crossed::layout::{Crossing, Part, Unit};
use crate::levels::walk::LevelLaws;
use kalfit_algebra::rows::Rows;

/// The posterior of all levels of a part, given the measurements, at Σ; M = levels × p. With precise measurements K is
/// large and N = (I+KΣ)⁻¹K is not: N and I - KC are computed from roots, not as differences.
pub(super) struct Dense {
    /// K, M × M.
    pub(super) K: DMatrix<f64>,
    /// C = L(I+L'KL)⁻¹L' = Var[b | z], M × M.
    pub(super) C: DMatrix<f64>,
    /// U⁻ᵀL' by columns, of which C is the square: columns × M.
    pub(super) half: DMatrix<f64>,
    /// L, M × columns that are not zero.
    L: DMatrix<f64>,
    /// U, upper triangular, with U'U = I + L'KL.
    upper: DMatrix<f64>,
    /// B with N = B'B: S⁻ᵀR for K = R'R and S'S = I + RΣR'.
    root: DMatrix<f64>,
    /// log|I + L'KL|.
    pub(super) log_det: f64,
    p: usize,
    /// I - KC, once it was asked for.
    rest: OnceLock<DMatrix<f64>>,
    /// N, once it was asked for.
    weights: OnceLock<DMatrix<f64>>,
}

/// Pivot of K, relative to its diagonal element, below which a direction is not informed: what rounding leaves of a sum
/// of some hundred squares.
const NO_PIVOT: f64 = 1e-13;

impl Dense {
    /// Solves the system of a part.
    pub(super) fn new(K: DMatrix<f64>, part: &Part, crossing: &Crossing, at: &LevelLaws<'_>) -> Dense {
        let (p, size) = (at.mean.len(), K.nrows());
        // L without the columns that are zero
        let columns: Vec<Vec<usize>> = crossing
            .factors
            .iter()
            .map(|&block| (0..p).filter(|&c| at.roots[block].row(c).iter().any(|x| *x != 0.0)).collect())
            .collect();
        let width: usize = part.levels.iter().map(|(factor, _)| columns[*factor].len()).sum();
        let mut L = DMatrix::zeros(size, width);
        let mut first = 0;
        for (level, (factor, _)) in part.levels.iter().enumerate() {
            let root = &at.roots[crossing.factors[*factor]];
            for &c in &columns[*factor] {
                (0..p).for_each(|i| L[(level * p + i, first)] = root[(c, i)]);
                first += 1;
            }
        }
        let system = DMatrix::identity(width, width) + transpose_times_sparse(&L, &times_sparse(&K, &L));
        let upper = upper_factor(system, 0.0);
        let log_det = 2.0 * (0..width).map(|i| upper[(i, i)].ln()).sum::<f64>();
        let mut half = L.transpose();
        solve_transposed(&upper, &mut half);
        let C = half.transpose() * &half;
        let mut root = upper_factor(K.clone(), NO_PIVOT);
        let spread = times_sparse(&root, &L);
        let outer = upper_factor(DMatrix::identity(size, size) + &spread * spread.transpose(), 0.0);
        solve_transposed(&outer, &mut root);
        let (rest, weights) = (OnceLock::new(), OnceLock::new());
        Dense { K, C, half, L, upper, root, log_det, p, rest, weights }
    }

    /// v̂ and b̂ = Lv̂ = Cy.
    pub(super) fn effects(&self, y: &DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
        let mut v = self.L.transpose() * y;
        solve_transposed(&self.upper, &mut v);
        let solved = self.upper.solve_upper_triangular_mut(&mut v);
        debug_assert!(solved, "U'U = I + L'KL is at least I");
        let effects = &self.L * &v;
        (v, effects)
    }

    /// N of a level: K - KCK, the information of all measurements on the effect of the level, p × p.
    pub(super) fn weight(&self, level: usize) -> Rows {
        let (p, own) = (self.p, level * self.p);
        Rows::from_fn(p, p, |i, k| self.root.column(own + i).dot(&self.root.column(own + k)))
    }

    /// I - KC = I - NΣ, M × M.
    pub(super) fn rest(&self) -> &DMatrix<f64> {
        self.rest.get_or_init(|| {
            let spread = times_sparse(self.weights(), &self.L);
            DMatrix::identity(self.K.nrows(), self.K.nrows()) - times_sparse(&spread, &self.L.transpose())
        })
    }

    /// N = K - KCK, M × M.
    pub(super) fn weights(&self) -> &DMatrix<f64> {
        self.weights.get_or_init(|| self.root.transpose() * &self.root)
    }
}

/// The blocks of a matrix over the levels of a part that a unit meets.
pub(super) fn gathered(all: &DMatrix<f64>, unit: &Unit, p: usize) -> Rows {
    let width = unit.met.len() * p;
    Rows::from_fn(width, width, |i, k| all[(unit.met[i / p] * p + i % p, unit.met[k / p] * p + k % p)])
}

/// Rows of the levels that a unit meets, of a matrix with a row for each state of each level.
pub(super) fn rows_of(all: &DMatrix<f64>, unit: &Unit, p: usize) -> Rows {
    Rows::from_fn(unit.met.len() * p, all.ncols(), |i, c| all[(unit.met[i / p] * p + i % p, c)])
}

/// AB for a B with few entries in each column.
fn times_sparse(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let mut product = DMatrix::zeros(a.nrows(), b.ncols());
    for (c, mut column) in product.column_iter_mut().enumerate() {
        for (k, &x) in b.column(c).iter().enumerate().filter(|(_, x)| **x != 0.0) {
            column.axpy(x, &a.column(k), 1.0);
        }
    }
    product
}

/// A'B for an A with few entries in each column.
fn transpose_times_sparse(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let entries: Vec<Vec<(usize, f64)>> =
        (0..a.ncols()).map(|c| a.column(c).iter().copied().enumerate().filter(|(_, x)| *x != 0.0).collect()).collect();
    DMatrix::from_fn(a.ncols(), b.ncols(), |i, c| entries[i].iter().map(|&(k, x)| x * b[(k, c)]).sum())
}

/// Width of a panel of [`upper_factor`] and [`solve_transposed`]; any width gives the same factor but for rounding errors.
const PANEL: usize = 64;

/// U, upper triangular, with U'U = A for A ≥ 0, panel by panel: most of the work is a product of matrices. The row of a
/// pivot below `tolerance` times its diagonal element is zero.
fn upper_factor(mut a: DMatrix<f64>, tolerance: f64) -> DMatrix<f64> {
    let n = a.nrows();
    let least = a.diagonal() * tolerance;
    let divided = |x: f64, pivot: f64| if pivot > 0.0 { x / pivot } else { 0.0 };
    for from in (0..n).step_by(PANEL) {
        let to = (from + PANEL).min(n);
        for k in from..n {
            for i in from..k.min(to) {
                let dot: f64 = (from..i).map(|row| a[(row, i)] * a[(row, k)]).sum();
                a[(i, k)] = divided(a[(i, k)] - dot, a[(i, i)]);
            }
            if k < to {
                let pivot = a[(k, k)] - (from..k).map(|row| a[(row, k)].powi(2)).sum::<f64>();
                a[(k, k)] = if pivot > least[k] { pivot.sqrt() } else { 0.0 };
            }
        }
        if to < n {
            let panel = a.view((from, to), (to - from, n - to)).into_owned();
            a.view_mut((to, to), (n - to, n - to)).gemm(-1.0, &panel.transpose(), &panel, 1.0);
        }
    }
    for k in 0..n {
        (k + 1..n).for_each(|i| a[(i, k)] = 0.0);
    }
    a
}

/// B ← U⁻ᵀB, panel by panel.
fn solve_transposed(upper: &DMatrix<f64>, b: &mut DMatrix<f64>) {
    let (n, columns) = b.shape();
    for from in (0..n).step_by(PANEL) {
        let to = (from + PANEL).min(n);
        for c in 0..columns {
            for i in from..to {
                let dot: f64 = (from..i).map(|row| upper[(row, i)] * b[(row, c)]).sum();
                b[(i, c)] = (b[(i, c)] - dot) / upper[(i, i)];
            }
        }
        if to < n {
            let solved = b.view((from, 0), (to - from, columns)).into_owned();
            let panel = upper.view((from, to), (to - from, n - to)).transpose();
            b.view_mut((to, 0), (n - to, columns)).gemm(-1.0, &panel, &solved, 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_and_solutions_are_those_of_the_matrix_at_every_width() {
        for n in [0, 1, 5, PANEL, PANEL + 1, 3 * PANEL - 7] {
            let a = DMatrix::from_fn(n, n, |i, k| ((3 * i + 7 * k) as f64).sin());
            let square = DMatrix::identity(n, n) + a.transpose() * &a;
            let upper = upper_factor(square.clone(), 0.0);
            assert!((upper.transpose() * &upper - &square).amax() < 1e-11 * (1.0 + square.amax()), "{n}");
            let b = DMatrix::from_fn(n, 3, |i, k| ((i + 2 * k) as f64).cos());
            let mut x = b.clone();
            solve_transposed(&upper, &mut x);
            assert!((upper.transpose() * &x - b).amax() < 1e-11, "{n}");
        }
    }

    #[test]
    fn a_singular_matrix_has_rows_of_zeros() {
        let half = DMatrix::from_fn(3, 2 * PANEL, |i, k| ((i * 5 + k) as f64).sin());
        let square = half.transpose() * &half;
        let upper = upper_factor(square.clone(), NO_PIVOT);
        assert!((upper.transpose() * &upper - &square).amax() < 1e-12);
        assert!((0..2 * PANEL).filter(|&k| upper[(k, k)] > 0.0).count() <= 3);
    }
}
