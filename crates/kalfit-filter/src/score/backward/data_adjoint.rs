//! The data-dependent part of the backward pass through equal steps of one scalar measurement: for one record, or in
//! lanes for several records that differ in their data only.
//!
//! ```text
//! u = ē/S - K'r        ∂ℓ/∂R: ½u²        ∂ℓ/∂d: u        r ← r + hu        ∂ℓ/∂h: u (x̄⁻ + P⁻r)
//! ∂ℓ/∂Q: ½rr'        ∂ℓ/∂b: r        ∂ℓ/∂φ: r (x̄ + Pφ'r)'        r ← φ'r
//! ```

use kalfit_lanes::{Lanes, Real};

use crate::reduce;
use crate::reduce::Stretch;
use crate::score::backward::input::{AdjointsWanted, BackwardInput};

/// The coefficients of a step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepCoefficients<T, const N: usize> {
    pub(crate) filter: reduce::InvariantStep<T, N>,
    pub(super) wanted: AdjointsWanted,
    pub(super) has_transition: bool,
}

/// P before a step and, where ∂ℓ/∂h is wanted, before the measurement of the step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PriorVariances<const N: usize> {
    pub(crate) before_step: [[f64; N]; N],
    pub(crate) before_measurement: [[f64; N]; N],
}

/// The data-dependent part of the adjoints of the coefficients, summed over steps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DataSums<T, const N: usize> {
    pub(crate) u: T,
    pub(crate) uu: T,
    pub(crate) h: [T; N],
    /// Sums of r and rr' (lower triangle) of the states after the transitions.
    pub(crate) r: [T; N],
    pub(crate) rr: [[T; N]; N],
    pub(crate) phi: [[T; N]; N],
}

impl<T: Real, const N: usize> DataSums<T, N> {
    #[inline(always)]
    pub(crate) fn zeros() -> DataSums<T, N> {
        let zero = T::splat(0.0);
        let (vector, matrix) = ([zero; N], [[zero; N]; N]);
        DataSums { u: zero, uu: zero, h: vector, r: vector, rr: matrix, phi: matrix }
    }
}

impl<T: Lanes, const N: usize> DataSums<T, N> {
    /// The sums of the test in the first lane.
    pub(super) fn one(&self) -> DataSums<f64, N> {
        let (u, uu) = (self.u.lane(0), self.uu.lane(0));
        DataSums { u, uu, h: one(self.h), r: one(self.r), rr: self.rr.map(one), phi: self.phi.map(one) }
    }
}

impl<T: Real, const N: usize> StepCoefficients<T, N> {
    /// The coefficients of the steps of a stretch; `x`: x̄ before the stretch.
    #[inline(always)]
    pub(crate) fn new(input: &BackwardInput<'_>, stretch: &Stretch<'_>, x: &[T]) -> StepCoefficients<T, N> {
        let filter = reduce::InvariantStep::new(input.design, stretch, x);
        StepCoefficients { filter, wanted: input.wanted, has_transition: stretch.transition.is_some() }
    }

    /// The backward pass through one step; `x`: x̄ before the step.
    #[inline(always)]
    pub(crate) fn back(
        &self,
        r: &mut [T; N],
        &(weight, ref K): &(f64, [f64; N]),
        e: T,
        (x, P): (&[T; N], &PriorVariances<N>),
        sums: &mut DataSums<T, N>,
    ) {
        if weight != 0.0 {
            let mut u = e * T::splat(weight);
            for i in 0..N {
                u = T::splat(K[i]).fnma(r[i], u);
            }
            sums.u = sums.u + u;
            sums.uu = u.fma(u, sums.uu);
            for i in 0..N {
                r[i] = T::splat(self.filter.h[i]).fma(u, r[i]);
            }
            if self.wanted.equation {
                let before_measurement = smoothed(&self.filter.predicted(x), &P.before_measurement, r);
                for i in 0..N {
                    sums.h[i] = u.fma(before_measurement[i], sums.h[i]);
                }
            }
        }
        if !self.has_transition {
            return;
        }
        let r_before = self.filter.adjoint(r);
        for i in 0..N {
            sums.r[i] = sums.r[i] + r[i];
            for j in 0..=i {
                sums.rr[i][j] = r[i].fma(r[j], sums.rr[i][j]);
            }
        }
        if self.wanted.motion {
            let before_step = smoothed(x, &P.before_step, &r_before);
            for i in 0..N {
                for j in 0..N {
                    sums.phi[i][j] = r[i].fma(before_step[j], sums.phi[i][j]);
                }
            }
        }
        *r = r_before;
    }
}

/// The smoothed state x̄ + Pr.
#[inline(always)]
fn smoothed<T: Real, const N: usize>(x: &[T; N], P: &[[f64; N]; N], r: &[T; N]) -> [T; N] {
    let mut smoothed = *x;
    for i in 0..N {
        for j in 0..N {
            smoothed[i] = T::splat(P[i][j]).fma(r[j], smoothed[i]);
        }
    }
    smoothed
}

/// The numbers of the test in the first lane.
pub(super) fn one<T: Lanes, const M: usize>(numbers: [T; M]) -> [f64; M] {
    numbers.map(|x| x.lane(0))
}
