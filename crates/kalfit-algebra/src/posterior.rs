//! Square root of the posterior covariance.

use nalgebra::DMatrix;

/// C with CC' = F(I + F'JF)⁻¹F', J = R'R, which loses no digits where the test informs about ξ far better than the
/// population does. I + F'JF = U'U by QR of [I; RF], without forming it: however large RF is, the diagonal of U is
/// nonzero. Shapes: `factor` (R) p × p, `root` (F) and the result p × n.
pub fn posterior_root(factor: &DMatrix<f64>, root: &DMatrix<f64>) -> DMatrix<f64> {
    let (p, n) = root.shape();
    let rf = factor * root;
    let stacked = DMatrix::from_fn(n + p, n, |i, c| if i < n { f64::from(i == c) } else { rf[(i - n, c)] });
    let mut upper = stacked.qr().r();
    for k in 0..n {
        // no diagonal element is below the least singular value of [I; RF], which is at least one; rounding must not
        // make a diagonal element less than one
        upper[(k, k)] = upper[(k, k)].abs().max(1.0).copysign(upper[(k, k)]);
    }
    let half = upper.transpose().solve_lower_triangular(&root.transpose()).expect("its diagonal is at least one");
    half.transpose()
}
