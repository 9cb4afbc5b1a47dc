//! ℓ of a reduction by the plainest formula, as a reference in tests.

use nalgebra::{DMatrix, DVector};

use crate::reduce::ReductionRef;
use crate::score::InitialLaw;
use kalfit_model::unpack;

/// ℓ of a reduction: log N(d; Rμ, I + RΣR') plus the constant of the reduction.
pub(crate) fn likelihood(reduction: ReductionRef<'_>, law: &InitialLaw) -> f64 {
    let p = law.root.nrows();
    let factor = unpack(reduction.factor, p);
    let residual = DVector::from_column_slice(reduction.data) - &factor * law.mean_of(&[]);
    let rf = factor * &law.root;
    let spread = DMatrix::identity(p, p) + &rf * rf.transpose();
    let cholesky = spread.cholesky().expect("positive definite");
    reduction.constant - 0.5 * cholesky.determinant().ln() - 0.5 * residual.dot(&cholesky.solve(&residual))
}
