//! Likelihood terms, at a point, of a block of classes in lanes or of one class by itself, for any number of states:
//! the formulas of [`super::dense`], row by row. One elimination makes S upper triangular and transforms R and d - Rμ
//! along with S:
//!
//! ```text
//! [S R d-Rμ] → [DL' U u]      U = L⁻¹R, u = L⁻¹(d-Rμ)      [W r; r' u'D⁻¹u] = [U u]'D⁻¹[U u]
//! ```
//!
//! For classes of several tests u has further columns, one for each vector of the scatter. Rows C that are measured
//! exactly come before the rows of R, and have no noise in S (theory §13): S = diag(0, I) + [C; R]Σ[C; R]'.
#![expect(non_snake_case, reason = "R, S, L, D, U, W, F are the letters of the theory")]

use kalfit_lanes::Lanes;
use nalgebra::DMatrix;

use crate::lanes::rows::add_weighed;
use crate::point::{Point, Regressors};
use kalfit_algebra::fold::fold;

/// Workspace for one block; after an evaluation, the workspace holds the likelihood terms of the block. Matrices are by
/// rows.
#[derive(Debug)]
pub(super) struct ClassWorkspace<T> {
    p: usize,
    /// q, number of rows of C.
    exact: usize,
    /// Number of columns of u.
    columns: usize,
    /// Mean of the test in each lane.
    mean: Vec<T>,
    /// F with Σ = FF', lower triangular.
    F: DMatrix<f64>,
    /// (RF)', p × (q + p).
    X: Vec<T>,
    /// [S R d-Rμ], later [DL' U u]: (q + p) × (q + 2p + columns); rows of S hold only entries from the diagonal on.
    rows: Vec<T>,
    /// Diagonal of D⁻¹.
    inverse: Vec<T>,
    minus_inverse: Vec<T>,
    /// The lower triangle of [W r; r' u'D⁻¹u], (p + columns) × (p + columns).
    W: Vec<T>,
}

impl<T: Lanes> ClassWorkspace<T> {
    /// A workspace for a point, given by μ and F, lower triangular, with `columns` columns of u.
    pub(super) fn new(mean: &[f64], root: &DMatrix<f64>, columns: usize) -> ClassWorkspace<T> {
        let p = mean.len();
        let zeros = |size: usize| vec![T::splat(0.0); size];
        ClassWorkspace {
            p,
            exact: 0,
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

    /// Resizes the workspace for `exact` rows of C and `columns` columns of u.
    pub(super) fn resize(&mut self, exact: usize, columns: usize) {
        (self.exact, self.columns) = (exact, columns);
        let (height, width, zero) = (self.height(), self.width(), T::splat(0.0));
        self.X.resize(self.p * height, zero);
        self.rows.resize(height * (height + width), zero);
        self.inverse.resize(height, zero);
        self.minus_inverse.resize(height, zero);
        self.W.resize(width * width, zero);
    }

    /// Sets the mean to μ plus the effects of the regressions.
    #[inline(always)]
    pub(super) fn move_mean(&mut self, covariates: &[T], point: &Point, regressors: &Regressors) {
        for &element in regressors {
            self.mean[element] = T::splat(point.mean[element]);
        }
        for (c, &element) in regressors.iter().enumerate() {
            self.mean[element] = covariates[c].fma(T::splat(point.coefficients[c]), self.mean[element]);
        }
    }

    /// Number of rows of C and R together.
    #[inline(always)]
    fn height(&self) -> usize {
        self.exact + self.p
    }

    /// Number of columns of [R d-Rμ].
    #[inline(always)]
    fn width(&self) -> usize {
        self.p + self.columns
    }

    /// Evaluates a block, which holds in lanes R by columns, C by rows, d and g, then vectors of the scatter for the
    /// other columns of u; d and the scatter are multiplied by `unit`. Returns |S| as mantissa × 2^exponent.
    #[inline(always)]
    pub(super) fn evaluate(&mut self, block: &[f64], unit: f64) -> (T, T) {
        self.load(block, unit);
        self.multiply_root(block);
        self.form_innovation_covariance();
        let det = self.eliminate(None);
        self.weigh();
        det
    }

    /// Sets `rows` to [0 R d-Rμ].
    #[inline(always)]
    fn load(&mut self, block: &[f64], unit: f64) {
        let (p, exact, height) = (self.p, self.exact, self.height());
        let (stride, unit) = (height + self.width(), T::splat(unit));
        self.rows.fill(T::splat(0.0));
        let mut next = block.chunks_exact(T::COUNT);
        for k in 0..p {
            for row in self.rows.chunks_exact_mut(stride).skip(exact).take(k + 1) {
                if let Some(x) = next.next() {
                    row[height + k] = T::load(x);
                }
            }
        }
        for row in self.rows.chunks_exact_mut(stride).take(exact) {
            for (to, x) in row[height..height + p].iter_mut().zip(&mut next) {
                *to = T::load(x);
            }
        }
        for column in 0..self.columns {
            let (first, last) = self.rows.split_at_mut(exact * stride);
            for row in last.chunks_exact_mut(stride).chain(first.chunks_exact_mut(stride)) {
                let Some(x) = next.next() else { break };
                let mut residual = T::load(x) * unit;
                for k in 0..if column == 0 { p } else { 0 } {
                    residual = row[height + k].fnma(self.mean[k], residual);
                }
                row[height + p + column] = residual;
            }
        }
    }

    /// Computes (RF)': row c is Σ_k F_kc (column k of R).
    #[inline(always)]
    fn multiply_root(&mut self, block: &[f64]) {
        let (p, exact, height) = (self.p, self.exact, self.height());
        self.X.fill(T::splat(0.0));
        for (c, row) in self.X.chunks_exact_mut(height.max(1)).enumerate() {
            for k in c..p {
                let (factor, column) = (T::splat(self.F[(k, c)]), &block[k * (k + 1) / 2 * T::COUNT..]);
                for (x, r) in row[exact..=exact + k].iter_mut().zip(column.chunks_exact(T::COUNT)) {
                    *x = factor.fma(T::load(r), *x);
                }
                for (i, x) in row[..exact].iter_mut().enumerate() {
                    *x = factor.fma(T::load(&block[(p * (p + 1) / 2 + i * p + k) * T::COUNT..]), *x);
                }
            }
        }
    }

    /// Adds S = I + RF(RF)' to `rows`.
    #[inline(always)]
    fn form_innovation_covariance(&mut self) {
        let (p, exact, height) = (self.p, self.exact, self.height());
        let stride = height + self.width();
        for i in 0..height {
            let row = &mut self.rows[i * stride..][i..height];
            row[0] = T::splat(if i < exact { 0.0 } else { 1.0 });
            add_weighed(row, p, (&self.X[i..], height, 0), None);
        }
    }

    /// Eliminates [S R d-Rμ] → [DL' U u]; returns |S| as mantissa × 2^exponent. With `root`, upper triangular by rows
    /// with S = root' root, S itself is not read.
    #[inline(always)]
    fn eliminate(&mut self, root: Option<&[T]>) -> (T, T) {
        let (exact, height) = (self.exact, self.height());
        let stride = height + self.width();
        let (mut mantissa, mut exponent) = (T::splat(1.0), T::splat(0.0));
        for i in 0..height {
            let (done, row) = self.rows.split_at_mut(i * stride);
            let row = &mut row[i..stride];
            if i > 0 {
                add_weighed(row, i, (&done[i..], stride, 0), Some(&self.minus_inverse));
            }
            if let Some(root) = root {
                let known = &root[i * height..][i..height];
                for (s, x) in row.iter_mut().zip(known) {
                    *s = known[0] * *x;
                }
            }
            // S ⪰ diag(0, I), so no pivot of a row of R is below 1 but for rounding. A pivot of a row of C is zero
            // where Σ is zero along C: the likelihood is then zero
            let pivot = row[0].maximum(T::splat(if i < exact { f64::MIN_POSITIVE } else { 1.0 }));
            self.inverse[i] = pivot.recip();
            self.minus_inverse[i] = -self.inverse[i];
            let (m, e) = (mantissa * pivot).split();
            (mantissa, exponent) = (m, exponent + e);
        }
        (mantissa, exponent)
    }

    /// Computes [W r; r' u'D⁻¹u].
    #[inline(always)]
    fn weigh(&mut self) {
        let (height, width) = (self.height(), self.width());
        let stride = height + width;
        self.W.fill(T::splat(0.0));
        for a in 0..width {
            let to = &mut self.W[a * width..][..a + 1];
            add_weighed(to, height, (&self.rows[height..], stride, a), Some(&self.inverse));
        }
    }

    /// Number of columns of u.
    #[inline(always)]
    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    /// r of a column of u.
    #[inline(always)]
    pub(super) fn r_of(&self, column: usize) -> &[T] {
        &self.row(self.p + column)[..self.p]
    }

    /// u'D⁻¹u of a column of u.
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
    /// Evaluates a block as [`Self::evaluate`] does, but without forming S: QR folds the rows of (RF)' into diag(0, I).
    pub(super) fn evaluate_by_qr(&mut self, block: &[f64], unit: f64) -> (f64, f64) {
        self.load(block, unit);
        self.multiply_root(block);
        let height = self.height();
        let mut root = vec![0.0; height * height];
        (self.exact..height).for_each(|i| root[i * height + i] = 1.0);
        fold(&mut root, &mut self.X, height);
        let det = self.eliminate(Some(&root));
        self.weigh();
        det
    }
}
