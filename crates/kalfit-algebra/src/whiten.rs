//! Whitening by a covariance I + AA' without forming it.

use nalgebra::DMatrix;

/// L, lower triangular, with LL' = I + AA', by QR of [A'; I]: however large A is, L has a diagonal of at least one, up
/// to signs. Shapes: `a` m × n, the result m × m.
pub fn whitener(a: &DMatrix<f64>) -> DMatrix<f64> {
    let (m, n) = a.shape();
    let stacked = DMatrix::from_fn(n + m, m, |i, c| if i < n { a[(c, i)] } else { f64::from(i - n == c) });
    let mut lower = stacked.qr().r().transpose();
    for k in 0..m {
        lower[(k, k)] = lower[(k, k)].abs().max(1.0).copysign(lower[(k, k)]);
    }
    lower
}

/// log|I + AA'| of a [`whitener`].
pub fn log_determinant(lower: &DMatrix<f64>) -> f64 {
    2.0 * lower.diagonal().iter().map(|x| x.abs().ln()).sum::<f64>()
}

/// L⁻¹X.
pub fn whitened(lower: &DMatrix<f64>, x: &DMatrix<f64>) -> DMatrix<f64> {
    lower.solve_lower_triangular(x).expect("its diagonal is at least one")
}

/// B with BB' = XX' and no more columns than rows.
pub fn compressed(x: &DMatrix<f64>) -> DMatrix<f64> {
    if x.ncols() <= x.nrows() { x.clone() } else { x.transpose().qr().r().transpose() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_whitener_is_a_root_of_what_it_whitens_by_however_large_that_is() {
        for size in [0.0, 1.0, 1e9] {
            let a = DMatrix::from_row_slice(3, 2, &[1.0, 2.0, -0.5, 0.3, 2.0, 4.0]) * size;
            let lower = whitener(&a);
            let product = &lower * lower.transpose();
            let expected = DMatrix::identity(3, 3) + &a * a.transpose();
            let off = (&product - &expected).amax() / expected.amax();
            assert!(off < 1e-15 * 10.0, "size {size}: {product} against {expected}");
            assert!(lower.diagonal().iter().all(|x| x.abs() >= 1.0), "{lower}");
        }
    }

    #[test]
    fn a_compressed_root_has_the_same_square() {
        let x = DMatrix::from_row_slice(2, 4, &[1.0, 2.0, -0.5, 0.3, 2.0, 4.0, 0.0, -1.0]);
        let root = compressed(&x);
        assert_eq!(root.shape(), (2, 2));
        let off = (&root * root.transpose() - &x * x.transpose()).amax();
        assert!(off < 1e-14, "{root} {off}");
    }
}
