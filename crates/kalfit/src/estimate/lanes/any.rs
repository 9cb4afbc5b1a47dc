//! What tests with one J each say at a point, a block of them side by side or one by itself, for any number of states: the formulas
//! of [`super::dense`], row by row. One elimination takes S to D⁻¹-free triangular form and R and d with it:
//!
//! ```text
//! [S R d-Rμ] → [DL' U u]      U = L⁻¹R, u = L⁻¹(d-Rμ)      [W r; r' u'D⁻¹u] = [U u]'D⁻¹[U u]
//! ```
//!
//! Of classes of several tests u has further columns, of the vectors of their scatter.
#![expect(non_snake_case, reason = "R, S, L, D, U, W, F are the letters of the theory")]

use kalfit_lanes::Lanes;
use nalgebra::DMatrix;

use crate::estimate::lanes::rows::add_weighed;
use crate::estimate::point::{Point, Regressors};
use crate::linalg::fold::fold;

/// The room that one block needs, and what it says at last. Matrices by rows.
#[derive(Debug)]
pub(super) struct ClassWorkspace<T> {
    p: usize,
    /// Columns of u.
    columns: usize,
    /// μ of each test.
    mean: Vec<T>,
    /// F.
    F: DMatrix<f64>,
    /// (RF)', p × p.
    X: Vec<T>,
    /// [S R d-Rμ], then [DL' U u]: p × (2p + columns); S from its diagonal on.
    rows: Vec<T>,
    /// D⁻¹.
    inverse: Vec<T>,
    minus_inverse: Vec<T>,
    /// The lower triangle of [W r; r' u'D⁻¹u], (p + columns) × (p + columns).
    W: Vec<T>,
}

impl<T: Lanes> ClassWorkspace<T> {
    /// For a point: μ and F, lower triangular; and so many columns of u.
    pub(super) fn new(mean: &[f64], root: &DMatrix<f64>, columns: usize) -> ClassWorkspace<T> {
        let p = mean.len();
        let zeros = |size: usize| vec![T::splat(0.0); size];
        ClassWorkspace {
            p,
            columns,
            mean: mean.iter().map(|&x| T::splat(x)).collect(),
            F: root.clone(),
            X: zeros(p * p),
            rows: zeros(p * (2 * p + columns)),
            inverse: zeros(p),
            minus_inverse: zeros(p),
            W: zeros((p + columns) * (p + columns)),
        }
    }

    /// Makes room for so many columns of u.
    pub(super) fn widen(&mut self, columns: usize) {
        self.columns = columns;
        let width = self.width();
        self.rows.resize(self.p * (self.p + width), T::splat(0.0));
        self.W.resize(width * width, T::splat(0.0));
    }

    /// Moves μ by the regressions.
    #[inline(always)]
    pub(super) fn move_mean(&mut self, covariates: &[T], point: &Point, regressors: &Regressors) {
        for &element in regressors {
            self.mean[element] = T::splat(point.mean[element]);
        }
        for (c, &element) in regressors.iter().enumerate() {
            self.mean[element] = covariates[c].fma(T::splat(point.coefficients[c]), self.mean[element]);
        }
    }

    /// Numbers of a row of [R d-Rμ].
    #[inline(always)]
    fn width(&self) -> usize {
        self.p + self.columns
    }

    /// Evaluates a block: R by columns, d, then vectors of the scatter for the other columns of u, in lanes. |S| as
    /// mantissa × 2^exponent. d and the scatter are so many times as large as they stand there.
    #[inline(always)]
    pub(super) fn evaluate(&mut self, block: &[f64], unit: f64) -> (T, T) {
        self.load(block, unit);
        self.spread(block);
        self.cover();
        let det = self.eliminate(None);
        self.weigh();
        det
    }

    /// [0 R d-Rμ].
    #[inline(always)]
    fn load(&mut self, block: &[f64], unit: f64) {
        let (p, width, unit) = (self.p, self.p + self.width(), T::splat(unit));
        self.rows.fill(T::splat(0.0));
        let mut next = block.chunks_exact(T::COUNT);
        for k in 0..p {
            for row in self.rows.chunks_exact_mut(width).take(k + 1) {
                if let Some(x) = next.next() {
                    row[p + k] = T::load(x);
                }
            }
        }
        for row in self.rows.chunks_exact_mut(width) {
            let Some(d) = next.next() else { break };
            let mut residual = T::load(d) * unit;
            for k in 0..p {
                residual = row[p + k].fnma(self.mean[k], residual);
            }
            row[2 * p] = residual;
        }
        for column in 1..self.columns {
            for row in self.rows.chunks_exact_mut(width) {
                let Some(x) = next.next() else { break };
                row[2 * p + column] = T::load(x) * unit;
            }
        }
    }

    /// (RF)': row c is Σ_k F_kc (column k of R).
    #[inline(always)]
    fn spread(&mut self, block: &[f64]) {
        let p = self.p;
        self.X.fill(T::splat(0.0));
        for (c, row) in self.X.chunks_exact_mut(p.max(1)).enumerate() {
            for k in c..p {
                let (factor, column) = (T::splat(self.F[(k, c)]), &block[k * (k + 1) / 2 * T::COUNT..]);
                for (x, r) in row[..=k].iter_mut().zip(column.chunks_exact(T::COUNT)) {
                    *x = factor.fma(T::load(r), *x);
                }
            }
        }
    }

    /// S = I + RF(RF)'.
    #[inline(always)]
    fn cover(&mut self) {
        let (p, width) = (self.p, self.p + self.width());
        for i in 0..p {
            let row = &mut self.rows[i * width..][i..p];
            row[0] = T::splat(1.0);
            add_weighed(row, p, (&self.X[i..], p, 0), None);
        }
    }

    /// [S R d-Rμ] → [DL' U u]. Of S a root may be known, upper triangular by rows with S = root' root: S itself is then not read.
    #[inline(always)]
    fn eliminate(&mut self, root: Option<&[T]>) -> (T, T) {
        let (p, wide) = (self.p, self.p + self.width());
        let one = T::splat(1.0);
        let (mut mantissa, mut exponent) = (one, T::splat(0.0));
        for i in 0..p {
            let (done, row) = self.rows.split_at_mut(i * wide);
            let row = &mut row[i..wide];
            if i > 0 {
                add_weighed(row, i, (&done[i..], wide, 0), Some(&self.minus_inverse));
            }
            if let Some(root) = root {
                let known = &root[i * p..][i..p];
                for (s, x) in row.iter_mut().zip(known) {
                    *s = known[0] * *x;
                }
            }
            // S ⪰ I, so no pivot is below one; rounding must not make it so
            let pivot = row[0].maximum(one);
            self.inverse[i] = pivot.recip();
            self.minus_inverse[i] = -self.inverse[i];
            let (m, e) = (mantissa * pivot).split();
            (mantissa, exponent) = (m, exponent + e);
        }
        (mantissa, exponent)
    }

    /// [W r; r' u'D⁻¹u].
    #[inline(always)]
    fn weigh(&mut self) {
        let (p, width) = (self.p, self.width());
        let wide = p + width;
        self.W.fill(T::splat(0.0));
        for a in 0..width {
            let to = &mut self.W[a * width..][..a + 1];
            add_weighed(to, p, (&self.rows[p..], wide, a), Some(&self.inverse));
        }
    }

    /// Columns of u.
    #[inline(always)]
    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    /// r of a column of u.
    #[inline(always)]
    pub(super) fn r_of(&self, column: usize) -> &[T] {
        &self.row(self.p + column)[..self.p]
    }

    /// u'D⁻¹u of a column.
    #[inline(always)]
    pub(super) fn quadratic(&self, column: usize) -> T {
        self.row(self.p + column)[self.p + column]
    }

    /// Row a of the lower triangle of [W r; r' u'D⁻¹u].
    #[inline(always)]
    pub(super) fn row(&self, a: usize) -> &[T] {
        &self.W[a * self.width()..][..a + 1]
    }
}

impl ClassWorkspace<f64> {
    /// The same as [`Self::evaluate`] without forming S: the rows of (RF)' folded into I by QR.
    pub(super) fn evaluate_by_qr(&mut self, block: &[f64], unit: f64) -> (f64, f64) {
        self.load(block, unit);
        self.spread(block);
        let p = self.p;
        let mut root = vec![0.0; p * p];
        (0..p).for_each(|i| root[i * p + i] = 1.0);
        fold(&mut root, &mut self.X, p);
        let det = self.eliminate(Some(&root));
        self.weigh();
        det
    }
}
