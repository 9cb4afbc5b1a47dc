//! The map of one level: what a test, or the tests of a group, say after the effect with covariance Σ of the level is
//! integrated out.

use nalgebra::DMatrix;

/// The map K ← W = BK of (14.1) with Σ = FF': P = F(I + F'K₁₁F)⁻¹F', B = I - K₁P, W = K - K₁PK₁', with K₁ the first p
/// columns of K and K₁₁ the first p rows of K₁. No matrix is inverted but I + F'K₁₁F.
#[derive(Debug, Clone)]
pub(super) struct LevelMap {
    /// W, bordered width × bordered width.
    pub(super) w: DMatrix<f64>,
    /// B.
    pub(super) b: DMatrix<f64>,
    /// P, p × p.
    pub(super) p: DMatrix<f64>,
}

impl LevelMap {
    /// The map of a bordered K; `root` is F, p × p. `None` where numbers are not finite.
    pub(super) fn of(k: &DMatrix<f64>, root: &DMatrix<f64>) -> Option<LevelMap> {
        let (width, p) = (k.nrows(), root.nrows());
        let first = k.columns(0, p);
        let inner = DMatrix::identity(root.ncols(), root.ncols()) + root.transpose() * first.rows(0, p) * root;
        let half = inner.cholesky()?.l().solve_lower_triangular(&root.transpose())?;
        let own = half.transpose() * half;
        let turned = first * &own;
        let mut b = DMatrix::identity(width, width);
        b.columns_mut(0, p).zip_apply(&turned, |x, y| *x -= y);
        let w = k - &turned * first.transpose();
        Some(LevelMap { w: symmetrised(&w), b, p: own })
    }

    /// BXB', for symmetric X.
    pub(super) fn turned(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        &self.b * x * self.b.transpose()
    }

    /// B'YB + P, the derivative by K of log|I + KΣ| + tr(YW).
    pub(super) fn adjoint(&self, y: &DMatrix<f64>) -> DMatrix<f64> {
        let mut all = self.b.transpose() * y * &self.b;
        let p = self.p.nrows();
        all.view_mut((0, 0), (p, p)).zip_apply(&self.p, |x, own| *x += own);
        all
    }
}

/// ½(X + X').
pub(super) fn symmetrised(x: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(x.nrows(), x.ncols(), |i, j| 0.5 * (x[(i, j)] + x[(j, i)]))
}

/// X + X'.
pub(super) fn with_transpose(x: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(x.nrows(), x.ncols(), |i, j| x[(i, j)] + x[(j, i)])
}
