//! The coefficients and gains of a scalar measurement, and the root of the posterior covariance of ξ.
#![expect(non_snake_case, reason = "the letters of the theory: K, T, C")]

use kalfit_lanes::Real;

use crate::reduce::{Entries, StateFrame};
use crate::score::backward::input::{AdjointsWanted, BackwardInput};

/// The coefficients and gains of a scalar measurement.
#[derive(Debug, Clone, Copy)]
pub(super) struct ScalarMeasurement<'a, T, E> {
    pub(super) states: &'a [u32],
    pub(super) h: E,
    /// R, the noise variance.
    pub(super) noise: T,
    /// 1/S; 0 for a measurement without information, whose K and T are zero too.
    pub(super) weight: T,
    pub(super) K: E,
    pub(super) T: E,
}

/// The frame of the states, and the root C of the posterior covariance of ξ (p × columns, by rows).
#[derive(Debug, Clone, Copy)]
pub(super) struct PosteriorRoot<'a, T = f64> {
    pub(super) frame: &'a StateFrame,
    pub(super) root: &'a [T],
    pub(super) columns: usize,
    pub(super) wanted: AdjointsWanted,
}

impl<T: Real> PosteriorRoot<'_, T> {
    /// Whether adjoints of φ or h are wanted, so that P and ΨC are needed.
    #[inline(always)]
    pub(super) fn needs_covariance(&self) -> bool {
        self.wanted.motion || self.wanted.equation
    }

    /// Sets `out` to TC of a scalar measurement with T = `row`.
    #[inline(always)]
    pub(super) fn times_root<E: Entries<T>>(&self, row: E, out: &mut Vec<T>) {
        let c = self.columns;
        out.clear();
        out.resize(c, T::splat(0.0));
        for i in 0..self.frame.p {
            let t = row.entry(i);
            for k in 0..c {
                out[k] = t.fma(self.root[i * c + k], out[k]);
            }
        }
    }
}

impl BackwardInput<'_> {
    /// The scalar measurement with this line and row of the design.
    pub(super) fn line(&self, (line, row): (usize, usize)) -> ScalarMeasurement<'_, f64, &[f64]> {
        let ((states, h), (weight, K, T)) = (self.design.terms(line), self.gains.row(row));
        ScalarMeasurement { states, h, noise: self.design.noise[line], weight, K, T }
    }

    pub(super) fn posterior(&self) -> PosteriorRoot<'_> {
        let BackwardInput { design, moments, wanted, .. } = *self;
        PosteriorRoot { frame: &design.frame, root: &moments.root, columns: moments.columns, wanted }
    }
}
