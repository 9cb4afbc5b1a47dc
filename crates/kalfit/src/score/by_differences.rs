//! ℓ of a test and slopes, in the plainest way.

use nalgebra::{DMatrix, DVector};

use crate::estimate::InitialLaw;
use crate::reduce::{ReductionRef, unpack};

/// The slope of a function at zero, by differences of fourth order.
pub(crate) fn slope(at: impl Fn(f64) -> f64, h: f64) -> f64 {
    (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h)
}

/// log N(d; Rμ, I + RΣR') and the constant.
pub(crate) fn likelihood(reduction: ReductionRef<'_>, law: &InitialLaw) -> f64 {
    let p = law.root.nrows();
    let factor = unpack(reduction.factor, p);
    let residual = DVector::from_column_slice(reduction.data) - &factor * law.mean_of(&[]);
    let rf = factor * &law.root;
    let spread = DMatrix::identity(p, p) + &rf * rf.transpose();
    let cholesky = spread.cholesky().expect("positive definite");
    reduction.constant - 0.5 * cholesky.determinant().ln() - 0.5 * residual.dot(&cholesky.solve(&residual))
}
