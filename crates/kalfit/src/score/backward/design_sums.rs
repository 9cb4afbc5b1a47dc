//! What goes back through equal steps of one scalar measurement: arrays of known size, for the N states that move and C
//! columns of ΨC.

use kalfit_lanes::{Lanes, Real};

use crate::score::backward::data_adjoint::{PriorVariances, one};

/// P and ΨC before a step and, where ∂ℓ/∂h is wanted, before its measurement.
#[derive(Debug, Clone, Copy)]
pub(super) struct PriorMoments<const N: usize, const C: usize> {
    pub(super) P: PriorVariances<N>,
    pub(super) left: [[f64; C]; N],
    pub(super) arrived: [[f64; C]; N],
}

/// 1/S and K, and TC, of a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gain<const N: usize, const C: usize> {
    pub(super) own: (f64, [f64; N]),
    pub(super) T: [f64; C],
}

/// ρ, N.
#[derive(Debug, Clone, Copy)]
pub(super) struct DesignAdjoint<T, const N: usize, const C: usize> {
    pub(super) rho: [[T; C]; N],
    pub(super) N: [[T; N]; N],
}

impl<T: Lanes, const N: usize, const C: usize> DesignAdjoint<T, N, C> {
    /// Of one test.
    pub(super) fn one(&self) -> DesignAdjoint<f64, N, C> {
        DesignAdjoint { rho: self.rho.map(one), N: self.N.map(one) }
    }
}

/// The design's part of the adjoints of the coefficients, summed over steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct DesignSums<T, const N: usize, const C: usize> {
    pub(super) noise: T,
    pub(super) upsilon: [T; C],
    pub(super) h: [T; N],
    pub(super) q: [[T; N]; N],
    pub(super) phi: [[T; N]; N],
    /// ρ where the transitions end.
    pub(super) rho: [[T; C]; N],
}

impl<T: Real, const N: usize, const C: usize> DesignSums<T, N, C> {
    #[inline(always)]
    pub(super) fn none() -> DesignSums<T, N, C> {
        let zero = T::splat(0.0);
        let (columns, matrix) = ([zero; C], [[zero; N]; N]);
        DesignSums { noise: zero, upsilon: columns, h: [zero; N], q: matrix, phi: matrix, rho: [columns; N] }
    }

    /// Adds so many times what others are.
    #[inline(always)]
    pub(super) fn add(&mut self, many: f64, others: &DesignSums<T, N, C>) {
        let many = T::splat(many);
        self.noise = many.fma(others.noise, self.noise);
        add(&mut self.upsilon, many, &others.upsilon);
        add(&mut self.h, many, &others.h);
        for i in 0..N {
            add(&mut self.q[i], many, &others.q[i]);
            add(&mut self.phi[i], many, &others.phi[i]);
            add(&mut self.rho[i], many, &others.rho[i]);
        }
    }
}

impl<T: Lanes, const N: usize, const C: usize> DesignSums<T, N, C> {
    /// Of one test.
    pub(super) fn one(&self) -> DesignSums<f64, N, C> {
        DesignSums {
            noise: self.noise.lane(0),
            upsilon: one(self.upsilon),
            h: one(self.h),
            q: self.q.map(one),
            phi: self.phi.map(one),
            rho: self.rho.map(one),
        }
    }
}

#[inline(always)]
fn add<T: Real, const M: usize>(sum: &mut [T; M], factor: T, others: &[T; M]) {
    for (sum, &other) in sum.iter_mut().zip(others) {
        *sum = factor.fma(other, *sum);
    }
}
