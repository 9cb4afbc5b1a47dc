//! Determines which states a single test could estimate.

use kalfit_lanes::{Isa, Kernel, Lanes};
use nalgebra::DMatrix;

use crate::direction::ZERO_EIGENVALUE;
use kalfit_algebra::fold::norm;
use kalfit_algebra::symmetric;

/// A state whose part in the directions without information exceeds this norm is not observed.
pub(super) const MAX_UNINFORMED_PART: f64 = 1e-6;

/// Norm of column k of R, which is packed by columns.
pub(super) fn column_norm(factor: &[f64], k: usize) -> f64 {
    norm(&factor[k * (k + 1) / 2..][..=k])
}

/// Clears `observes` for informed states whose unit vector is not in the range of J = R'R on the informed states.
pub(super) fn observe(factor: &[f64], informs: &[bool], observes: &mut [bool]) {
    let p = informs.len();
    let informed = || (0..p).filter(|&i| informs[i]);
    let entry = |i: usize, k: usize| if i <= k { factor[i + k * (k + 1) / 2] } else { 0.0 };
    // The least eigenvalue of J scaled to unit diagonal is at least a third of its determinant, and the determinant
    // at least Π R_kk² of the scaled R: eigenvalues are not needed where this bound excludes an eigenvalue near zero.
    let determinant: f64 = informed().map(|k| (entry(k, k) / column_norm(factor, k)).powi(2)).product();
    if determinant > 10.0 * ZERO_EIGENVALUE {
        return;
    }
    let states: Vec<usize> = informed().collect();
    let norms: Vec<f64> = states.iter().map(|&k| column_norm(factor, k)).collect();
    if states.iter().enumerate().all(|(c, &state)| c == state)
        && Isa::best().run(WellConditioned { factor, norms: &norms })
    {
        return;
    }
    let scaled = DMatrix::from_fn(p, states.len(), |i, c| entry(i, states[c]) / norms[c]);
    let (values, vectors) = symmetric::eigen(&(scaled.transpose() * &scaled));
    for (c, &state) in states.iter().enumerate() {
        let uninformed = values.iter().enumerate().filter(|(_, v)| **v < ZERO_EIGENVALUE).map(|(k, _)| vectors[(c, k)]);
        observes[state] = uninformed.fold(0.0, f64::hypot) <= MAX_UNINFORMED_PART;
    }
}

/// Kernel that checks whether no eigenvalue of R'R, scaled to unit diagonal, can be near zero: the least eigenvalue is
/// at least 1 / ‖D R⁻¹‖², where D is diagonal with the norms of the columns of R; R is packed by columns.
struct WellConditioned<'a> {
    factor: &'a [f64],
    norms: &'a [f64],
}

impl Kernel for WellConditioned<'_> {
    type Output = bool;

    /// Each column update uses as many numbers at a time as registers hold.
    #[inline(always)]
    fn run<T: Lanes>(self) -> bool {
        let n = self.norms.len();
        let mut column = vec![0.0; n];
        let mut squares = 0.0;
        for k in 0..n {
            column[..k].fill(0.0);
            column[k] = 1.0;
            for m in (0..=k).rev() {
                let (above, diagonal) = self.factor[m * (m + 1) / 2..][..=m].split_at(m);
                let own = column[m] / diagonal[0];
                for (x, u) in column[..m].iter_mut().zip(above) {
                    *x -= own * u;
                }
                squares += (self.norms[m] * own) * (self.norms[m] * own);
            }
        }
        10.0 * ZERO_EIGENVALUE * squares < 1.0 // false for NaN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observed(factor: &[f64], informs: [bool; 3]) -> [bool; 3] {
        let mut observes = informs;
        observe(factor, &informs, &mut observes);
        observes
    }

    #[test]
    fn what_is_surely_observed_is_what_eigenvalues_say() {
        // the last column approaches the one before it, in units a million times as large
        for (off, expected) in [(1.0, true), (1e-2, true), (1e-3, true), (1e-9, false), (0.0, false)] {
            let factor = [2.0, 0.5, 1.0, 1e6, 2e6, off * 1e6];
            let norms: Vec<f64> = (0..3).map(|k| norm(&factor[k * (k + 1) / 2..][..=k])).collect();
            for isa in Isa::all() {
                assert_eq!(isa.run(WellConditioned { factor: &factor, norms: &norms }), expected, "{isa:?}: {off}");
            }
            assert_eq!(observed(&factor, [true; 3]), [true, expected, expected], "{off}");
        }
        assert_eq!(observed(&[2.0, 0.0, 0.0, 1.0, 0.0, 3.0], [true, false, true]), [true, false, true]);
    }
}
