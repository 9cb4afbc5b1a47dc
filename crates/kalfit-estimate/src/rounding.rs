//! Bounds on the effect of rounding errors on the estimates.
//!
//! The scores are built from d_j - R_jμ, a difference of numbers as large as R_jμ, whose error is therefore about δ_j =
//! ε|R_j||μ|. The error of the score of the mean is then Σ_j R_j'S_j⁻¹δ_j, S_j = I + R_jΣR_j', which in standard errors
//! is at most
//!
//! ```text
//! √(Σ_j δ_j'S_j⁻¹δ_j) ≤ ε Σ_i |μ_i| √(Σ_j W_j)_ii,   W_j = R_j'S_j⁻¹R_j
//! ```
//!
//! since the matrices S_j^-½ R_j (Σ W_j)^-½, stacked, have orthonormal columns. The score of Σ is linear in r_j, and
//! its error is as large in units of its standard errors. In a frame, |μ_i| means the sum of the absolute values of the
//! centre, the mean in η and the regression, which may cancel.

use crate::frame::Frame;
use crate::newton::NewtonIterate;

/// ε in units of the machine epsilon. Fits of numbers up to 1e13 at noise 1, by up to 40,000 rows a test with and
/// without process noise, had errors of no more than 0.8 units whatever the number of rows: errors of single rows do
/// not all have the same sign.
const EPSILON_UNITS: f64 = 2.0;

/// Bound for each mean coordinate (elements of μ, then regression coefficients), in standard errors.
pub(crate) fn rounding(frame: &Frame, iterate: &NewtonIterate) -> Vec<f64> {
    let (point, information) = (&iterate.point, &iterate.local.mean_information);
    let epsilon = EPSILON_UNITS * f64::EPSILON;
    let p = point.mean.len();
    let size = |i: usize| match i.checked_sub(p) {
        None => (frame.centre[i] / frame.scale[i]).abs() + point.mean[i].abs(),
        Some(c) => point.coefficients[c].abs(),
    };
    (0..information.nrows()).map(|i| epsilon * size(i) * information[(i, i)].max(0.0).sqrt()).collect()
}
