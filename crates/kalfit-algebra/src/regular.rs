//! Symmetric matrices that are surely positive definite: triangular root, solutions and inverse, computed by blocks so
//! that the work for a large matrix is matrix products.

use nalgebra::{DMatrix, DVector};

/// Number of rows and columns of a block; a matrix that is no larger is one block.
const BLOCK: usize = 96;

/// Lower bound on the eigenvalues of a matrix of unit diagonal for which the triangular root replaces the eigenvectors:
/// above it, no digits are lost.
const MIN_EIGENVALUE: f64 = 1e-8;

/// Number of inverse iterations that estimate the least eigenvalue of a large matrix, and the factor by which the
/// estimate may be too large.
const ITERATIONS: usize = 12;
const ESTIMATE_MARGIN: f64 = 4.0;

/// R, upper triangular with R'R = A, of a matrix A of about unit diagonal whose eigenvalues are surely positive. Rows
/// of zeros, including the diagonal, are skipped: the rest is solved and inverted, and the results are zero in those
/// rows.
#[derive(Debug, Clone)]
pub struct Regular {
    root: DMatrix<f64>,
}

impl Regular {
    /// Factorises A; `None` where an eigenvalue of A may be below `MIN_EIGENVALUE`. For a matrix of one block the
    /// bound is rigorous: the least eigenvalue is at least the inverse of Σ 1/λ = ‖R⁻¹‖². For a larger matrix, inverse
    /// iteration estimates the least eigenvalue from above, and `ESTIMATE_MARGIN` is the margin.
    ///
    /// The root is computed in the memory of A; where the result is `None`, A is lost.
    pub fn within(a: DMatrix<f64>) -> Option<Regular> {
        let factorised = Regular { root: root(a)? };
        let inverses = if factorised.root.nrows() > BLOCK {
            ESTIMATE_MARGIN * factorised.largest_inverse()
        } else {
            blocks(factorised.root.nrows()).map(|block| factorised.panel(block).norm_squared()).sum()
        };
        (inverses * MIN_EIGENVALUE <= 1.0).then_some(factorised)
    }

    /// The largest eigenvalue of A⁻¹, estimated from below by inverse iteration, which starts from a vector that
    /// resembles no eigenvector.
    fn largest_inverse(&self) -> f64 {
        let mut x = DVector::from_fn(self.root.nrows(), |i, _| 1.0 + 0.5 * ((i * i) as f64).sin());
        let mut size = 0.0;
        for _ in 0..ITERATIONS {
            x /= x.norm();
            x = self.solve(&x);
            size = x.norm();
        }
        size
    }

    /// Whether no row of A is a row of zeros.
    pub fn has_no_zero_rows(&self) -> bool {
        self.root.diagonal().iter().all(|x| x.is_finite())
    }

    /// A = R'R.
    pub fn into_product(self) -> DMatrix<f64> {
        let mut root = self.root;
        root.iter_mut().filter(|x| x.is_infinite()).for_each(|x| *x = 0.0);
        root.transpose() * root
    }

    /// R⁻ᵀg.
    pub fn below(&self, g: &DVector<f64>) -> DVector<f64> {
        let mut out = DVector::zeros(g.len());
        for k in 0..g.len() {
            out[k] = (g[k] - self.root.column(k).rows(0, k).dot(&out.rows(0, k))) / self.root[(k, k)];
        }
        out
    }

    /// R⁻¹g.
    pub fn above(&self, mut g: DVector<f64>) -> DVector<f64> {
        let n = g.len();
        above(&self.root, g.as_mut_slice(), (0, n));
        g
    }

    /// A⁻¹g.
    pub fn solve(&self, g: &DVector<f64>) -> DVector<f64> {
        self.above(self.below(g))
    }

    /// A⁻¹ = R⁻¹R⁻ᵀ, in the memory of R.
    pub fn into_inverse(mut self) -> DMatrix<f64> {
        let n = self.root.nrows();
        // a panel of R⁻¹ depends on no column of R after the panel, so the last panel is computed first
        let all: Vec<(usize, usize)> = blocks(n).collect();
        for &(start, end) in all.iter().rev() {
            let panel = self.panel((start, end));
            self.root.view_mut((0, start), panel.shape()).copy_from(&panel);
        }
        let mut inverse = self.root;
        for (start, end) in blocks(n) {
            // rows start..end of R⁻¹ are zero before column `start`, where the rows above hold the inverse by now
            let right = inverse.view((start, start), (end - start, n - start)).transpose();
            let own = inverse.view((0, start), (end, n - start)) * right;
            inverse.view_mut((0, start), own.shape()).copy_from(&own);
        }
        inverse.fill_lower_triangle_with_upper_triangle();
        inverse
    }

    /// Columns start..end of R⁻¹, end × (end - start): the elements below are zero.
    fn panel(&self, (start, end): (usize, usize)) -> DMatrix<f64> {
        let mut panel = DMatrix::zeros(end, end - start);
        for c in 0..end - start {
            panel[(start + c, c)] = 1.0;
            above(&self.root, &mut panel.as_mut_slice()[c * end..][..end], (start, start + c + 1));
        }
        let earlier: Vec<(usize, usize)> = blocks(start).collect();
        for &(top, bottom) in earlier.iter().rev() {
            let known = panel.rows(bottom, end - bottom).into_owned();
            let mut own = self.root.view((top, bottom), (bottom - top, end - bottom)) * known * -1.0;
            for mut column in own.column_iter_mut() {
                let mut whole = vec![0.0; bottom];
                whole[top..].copy_from_slice(column.as_slice());
                above(&self.root, &mut whole, (top, bottom));
                column.copy_from_slice(&whole[top..]);
            }
            panel.view_mut((top, 0), own.shape()).copy_from(&own);
        }
        panel
    }
}

/// Start and end of each block of n rows.
fn blocks(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).step_by(BLOCK).map(move |start| (start, (start + BLOCK).min(n)))
}

/// R with R'R = A, in the memory of A; `None` where a pivot is not above [`MIN_EIGENVALUE`]. For a row k of zeros,
/// r_kk is ∞, so that 1/r_kk = 0.
fn root(a: DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = a.nrows();
    let empty: Vec<bool> = a.column_iter().map(|column| column.iter().all(|x| *x == 0.0)).collect();
    let mut root = a;
    root.fill_lower_triangle(0.0, 1);
    for (start, end) in blocks(n) {
        for k in start..n {
            // rows of this block in column k, at most down to the diagonal
            for i in start..=k.min(end - 1) {
                let own = root.column(i);
                let done = own.rows(start, i - start).dot(&root.column(k).rows(start, i - start));
                let left = root[(i, k)] - done;
                if i < k {
                    root[(i, k)] = left / root[(i, i)];
                } else if left > MIN_EIGENVALUE {
                    root[(k, k)] = left.sqrt();
                } else if empty[k] {
                    root[(k, k)] = f64::INFINITY;
                } else {
                    return None;
                }
            }
        }
        let rows = root.view((start, end), (end - start, n - end)).into_owned();
        for (from, to) in blocks(n - end) {
            let left = rows.columns(0, to).transpose();
            let right = rows.columns(from, to - from);
            root.view_mut((end, end + from), (to, to - from)).gemm(-1.0, &left, &right, 1.0);
        }
    }
    // the products also wrote below the diagonal of the blocks
    root.fill_lower_triangle(0.0, 1);
    Some(root)
}

/// Replaces elements `from..to` of g by R⁻¹g, with rows and columns `from..to` of R, if g is zero from `to` on.
fn above(root: &DMatrix<f64>, g: &mut [f64], (from, to): (usize, usize)) {
    for l in (from..to).rev() {
        g[l] /= root[(l, l)];
        let x = g[l];
        let column = &root.column(l);
        g[from..l].iter_mut().zip(&column.as_slice()[from..l]).for_each(|(g, r)| *g -= x * r);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn regular(n: usize) -> DMatrix<f64> {
        let wave = DMatrix::from_fn(n, n, |i, k| ((3 * i * i + 7 * k + i * k) as f64).sin());
        &wave * wave.transpose() / n as f64 + DMatrix::identity(n, n) * 0.05
    }

    #[test]
    fn solutions_and_inverse_are_those_of_the_library() {
        for n in [0, 1, 5, BLOCK, BLOCK + 1, 2 * BLOCK + 17] {
            let a = regular(n);
            let factorised = Regular::within(a.clone()).expect("no eigenvalue is below 0.05");
            let inverse = a.clone().cholesky().expect("it is positive definite").inverse();
            let g = DVector::from_fn(n, |i, _| (i as f64).cos());
            let (own, wanted) = (factorised.solve(&g), &inverse * &g);
            assert!((&own - &wanted).norm() <= 1e-10 * wanted.norm(), "{n}: {} {}", own.norm(), wanted.norm());
            let apart = (factorised.clone().into_inverse() - &inverse).norm();
            assert!(apart <= 1e-10 * inverse.norm(), "{n}: {apart} of {}", inverse.norm());
            assert!((factorised.into_product() - &a).norm() <= 1e-12 * a.norm(), "{n}");
        }
    }

    #[test]
    fn rows_of_zeros_are_passed_over() {
        let (n, gone) = (2 * BLOCK + 5, [0, 7, BLOCK, BLOCK + 30, 2 * BLOCK + 4]);
        let mut a = regular(n);
        for k in gone {
            a.row_mut(k).fill(0.0);
            a.column_mut(k).fill(0.0);
        }
        let factorised = Regular::within(a.clone()).expect("the rest is regular");
        let inverse = crate::symmetric::pseudo_inverse(&a);
        let apart = (factorised.clone().into_inverse() - &inverse).norm();
        assert!(apart <= 1e-10 * inverse.norm(), "{apart} of {}", inverse.norm());
        let g = DVector::from_fn(n, |i, _| (i as f64).cos());
        assert!((factorised.solve(&g) - &inverse * &g).norm() <= 1e-10 * (&inverse * &g).norm());
        assert!(!factorised.has_no_zero_rows());
    }

    #[test]
    fn what_may_be_below_the_floor_is_refused() {
        let diagonal = |least: f64| DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, least, 2.0]));
        for least in [1e-12, -0.5, f64::NAN] {
            assert!(Regular::within(diagonal(least)).is_none(), "{least}");
        }
        assert!(Regular::within(diagonal(1e-6)).is_some());
        let hilbert = DMatrix::from_fn(9, 9, |i, k| 1.0 / (i + k + 1) as f64); // least eigenvalue 3e-12
        assert!(Regular::within(hilbert).is_none());
        let mut large = regular(BLOCK + 40);
        let last = BLOCK + 39;
        let copy = large.column(3).into_owned();
        large.set_column(last, &copy);
        large.set_row(last, &copy.transpose());
        large[(last, last)] = large[(3, 3)];
        assert!(Regular::within(large).is_none(), "two rows are the same");
    }
}
