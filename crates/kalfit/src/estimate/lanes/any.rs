//! What tests with one J each say at a point, a block of them side by side, for any number of states: the formulas of
//! [`super::dense`], row by row. One elimination takes S to D⁻¹-free triangular form and R and d with it:
//!
//! ```text
//! [S R d-Rμ] → [DL' U u]      U = L⁻¹R, u = L⁻¹(d-Rμ)      [W r; r' u'D⁻¹u] = [U u]'D⁻¹[U u]
//! ```
//!
//! Of classes of several tests u has further columns, of the vectors of their scatter.
#![expect(non_snake_case, reason = "R, S, L, D, U, W, F are the letters of the theory")]

use kalfit_lanes::Lanes;
use nalgebra::DMatrix;

use crate::estimate::lanes::rows::{add_one, add_weighed, at};

/// The room that one block needs, and what it says at last. Matrices by rows, in lanes.
#[derive(Debug)]
pub(super) struct Room {
    p: usize,
    /// Columns of u.
    pub(super) columns: usize,
    /// μ of each test.
    pub(super) mean: Vec<f64>,
    /// F.
    F: DMatrix<f64>,
    /// (RF)', p × p.
    X: Vec<f64>,
    /// [S R d-Rμ], then [DL' U u]: p × (2p + columns); S from its diagonal on.
    rows: Vec<f64>,
    /// D⁻¹.
    inverse: Vec<f64>,
    minus_inverse: Vec<f64>,
    /// The lower triangle of [W r; r' u'D⁻¹u], (p + columns) × (p + columns).
    pub(super) W: Vec<f64>,
}

impl Room {
    /// For a point: μ and F, lower triangular; and so many columns of u.
    pub(super) fn new(mean: &[f64], root: &DMatrix<f64>, columns: usize, lanes: usize) -> Room {
        let p = mean.len();
        let zeros = |size: usize| vec![0.0; size * lanes];
        Room {
            p,
            columns,
            mean: mean.iter().flat_map(|&x| std::iter::repeat_n(x, lanes)).collect(),
            F: root.clone(),
            X: zeros(p * p),
            rows: zeros(p * (2 * p + columns)),
            inverse: zeros(p),
            minus_inverse: zeros(p),
            W: zeros((p + columns) * (p + columns)),
        }
    }

    /// Numbers of a row of [R d-Rμ].
    fn width(&self) -> usize {
        self.p + self.columns
    }

    /// Evaluates a block: R by columns, d, then vectors of the scatter for the other columns of u, in lanes. |S| as
    /// mantissa × 2^exponent.
    #[inline(always)]
    pub(super) fn evaluate<T: Lanes>(&mut self, block: &[f64]) -> (T, T) {
        self.load::<T>(block);
        self.spread::<T>(block);
        self.cover::<T>();
        let root_det = self.eliminate::<T>();
        self.weigh::<T>();
        root_det
    }

    /// [0 R d-Rμ].
    #[inline(always)]
    fn load<T: Lanes>(&mut self, block: &[f64]) {
        let (p, n, width) = (self.p, T::COUNT, (self.p + self.width()) * T::COUNT);
        self.rows.fill(0.0);
        let mut next = block.chunks_exact(n);
        for k in 0..p {
            for row in self.rows.chunks_exact_mut(width).take(k + 1) {
                if let Some(x) = next.next() {
                    row[(p + k) * n..][..n].copy_from_slice(x);
                }
            }
        }
        for row in self.rows.chunks_exact_mut(width) {
            let Some(d) = next.next() else { break };
            let mut residual = T::load(d);
            for k in 0..p {
                residual = at::<T>(row, p + k).fnma(at(&self.mean, k), residual);
            }
            residual.store(&mut row[2 * p * n..]);
        }
        for column in 1..self.columns {
            for row in self.rows.chunks_exact_mut(width) {
                let Some(x) = next.next() else { break };
                row[(2 * p + column) * n..][..n].copy_from_slice(x);
            }
        }
    }

    /// (RF)': row c is Σ_k F_kc (column k of R).
    #[inline(always)]
    fn spread<T: Lanes>(&mut self, block: &[f64]) {
        let (p, n) = (self.p, T::COUNT);
        self.X.fill(0.0);
        for (c, row) in self.X.chunks_exact_mut((p * n).max(1)).enumerate() {
            for k in c..p {
                let column = &block[k * (k + 1) / 2 * n..][..(k + 1) * n];
                add_one(row, T::splat(self.F[(k, c)]), column);
            }
        }
    }

    /// S = I + RF(RF)'.
    #[inline(always)]
    fn cover<T: Lanes>(&mut self) {
        let (p, n, width) = (self.p, T::COUNT, (self.p + self.width()) * T::COUNT);
        for i in 0..p {
            let row = &mut self.rows[i * width..][i * n..p * n];
            T::splat(1.0).store(row);
            let x = &self.X[i * n..];
            add_weighed::<T>(row, p, (x, p, 0), None);
        }
    }

    /// [S R d-Rμ] → [DL' U u].
    #[inline(always)]
    fn eliminate<T: Lanes>(&mut self) -> (T, T) {
        let (p, n, wide) = (self.p, T::COUNT, self.p + self.width());
        let one = T::splat(1.0);
        let (mut mantissa, mut exponent) = (one, T::splat(0.0));
        for i in 0..p {
            let (done, row) = self.rows.split_at_mut(i * wide * n);
            let row = &mut row[i * n..wide * n];
            if i > 0 {
                add_weighed::<T>(row, i, (&done[i * n..], wide, 0), Some(&self.minus_inverse));
            }
            // S ⪰ I, so no pivot is below one; rounding must not make it so
            let pivot = T::load(row).maximum(one);
            let inverse = pivot.recip();
            inverse.store(&mut self.inverse[i * n..]);
            (-inverse).store(&mut self.minus_inverse[i * n..]);
            let (m, e) = (mantissa * pivot).split();
            (mantissa, exponent) = (m, exponent + e);
        }
        (mantissa, exponent)
    }

    /// [W r; r' u'D⁻¹u].
    #[inline(always)]
    fn weigh<T: Lanes>(&mut self) {
        let (p, n, width) = (self.p, T::COUNT, self.width());
        let wide = p + width;
        self.W.fill(0.0);
        for a in 0..width {
            let to = &mut self.W[a * width * n..][..(a + 1) * n];
            add_weighed::<T>(to, p, (&self.rows[p * n..], wide, a), Some(&self.inverse));
        }
    }

    /// r.
    #[inline(always)]
    pub(super) fn r<T: Lanes>(&self) -> &[f64] {
        self.r_of::<T>(0)
    }

    /// r of a column of u.
    #[inline(always)]
    pub(super) fn r_of<T: Lanes>(&self, column: usize) -> &[f64] {
        &self.row::<T>(self.p + column)[..self.p * T::COUNT]
    }

    /// u'D⁻¹u of a column.
    #[inline(always)]
    pub(super) fn quadratic<T: Lanes>(&self, column: usize) -> T {
        at(self.row::<T>(self.p + column), self.p + column)
    }

    /// Row a of the lower triangle of [W r; r' u'D⁻¹u].
    #[inline(always)]
    pub(super) fn row<T: Lanes>(&self, a: usize) -> &[f64] {
        &self.W[a * self.width() * T::COUNT..][..(a + 1) * T::COUNT]
    }
}
