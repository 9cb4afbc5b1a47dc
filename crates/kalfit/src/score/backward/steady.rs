//! The design's part of the way back through one of many equal steps, on arrays of known size: one scalar measurement of the N
//! states that move; those that rest are constants. The data's part has a file of its own ([`DataAdjoint`]).

use kalfit_lanes::Real;

use crate::reduce::Stretch;
use crate::score::backward::data_adjoint::DataAdjoint;
use crate::score::backward::design_sums::{DesignAdjoint, DesignSums, Gain, PriorMoments};
use crate::score::backward::run::{AdjointsWanted, BackwardInput};

/// The coefficients of a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepCoefficients<T, const N: usize> {
    pub(super) data: DataAdjoint<T, N>,
    moves: bool,
    wanted: AdjointsWanted,
}

#[inline(always)]
fn inner<T: Real, const M: usize>(a: &[T; M], b: &[T; M]) -> T {
    let mut sum = T::splat(0.0);
    for i in 0..M {
        sum = a[i].fma(b[i], sum);
    }
    sum
}

/// φ'X.
#[inline(always)]
fn transposed<T: Real, const N: usize, const W: usize>(phi: &[[f64; N]; N], x: &[[T; W]; N]) -> [[T; W]; N] {
    let mut out = [[T::splat(0.0); W]; N];
    for k in 0..N {
        for i in 0..N {
            for j in 0..W {
                out[i][j] = T::splat(phi[k][i]).fma(x[k][j], out[i][j]);
            }
        }
    }
    out
}

/// Nφ.
#[inline(always)]
fn product<T: Real, const N: usize>(x: &[[T; N]; N], phi: &[[f64; N]; N]) -> [[T; N]; N] {
    let mut out = [[T::splat(0.0); N]; N];
    for i in 0..N {
        for k in 0..N {
            for j in 0..N {
                out[i][j] = T::splat(phi[k][j]).fma(x[i][k], out[i][j]);
            }
        }
    }
    out
}

impl<T: Real, const N: usize> StepCoefficients<T, N> {
    /// `now`: the filter before the steps.
    #[inline(always)]
    pub(super) fn new(run: &BackwardInput<'_>, stretch: &Stretch<'_>, now: &[T]) -> StepCoefficients<T, N> {
        let data = DataAdjoint::new(run, stretch, now);
        StepCoefficients { data, moves: stretch.transition.is_some(), wanted: run.wanted }
    }

    /// Back through one step.
    #[inline(always)]
    pub(super) fn back<const C: usize>(
        &self,
        bars: &mut DesignAdjoint<T, N, C>,
        gain: &Gain<N, C>,
        prior: &PriorMoments<N, C>,
        sums: &mut DesignSums<T, N, C>,
    ) {
        if gain.own.0 != 0.0 {
            self.measured(bars, gain, prior, sums);
        }
        if !self.moves {
            return;
        }
        let half = T::splat(0.5);
        for i in 0..N {
            for j in 0..=i {
                sums.q[i][j] = half.fma(inner(&bars.rho[i], &bars.rho[j]) - bars.N[i][j], sums.q[i][j]);
            }
            for j in 0..C {
                sums.rho[i][j] = sums.rho[i][j] + bars.rho[i][j];
            }
        }
        let phi = &self.data.filter.phi;
        let (Nphi, rho) = (product(&bars.N, phi), transposed(phi, &bars.rho));
        if self.wanted.motion {
            for j in 0..N {
                let (P, mut B) = (prior.P.left[j].map(T::splat), prior.left[j].map(T::splat));
                for k in 0..N {
                    for l in 0..C {
                        B[l] = P[k].fnma(rho[k][l], B[l]);
                    }
                }
                for i in 0..N {
                    sums.phi[i][j] = sums.phi[i][j] - (inner(&bars.rho[i], &B) + inner(&Nphi[i], &P));
                }
            }
        }
        *bars = DesignAdjoint { rho, N: transposed(phi, &Nphi) };
    }

    #[inline(always)]
    fn measured<const C: usize>(
        &self,
        bars: &mut DesignAdjoint<T, N, C>,
        gain: &Gain<N, C>,
        prior: &PriorMoments<N, C>,
        sums: &mut DesignSums<T, N, C>,
    ) {
        let (weight, K) = (T::splat(gain.own.0), gain.own.1.map(T::splat));
        let (h, mut upsilon) = (self.data.filter.h.map(T::splat), gain.T.map(T::splat));
        for j in 0..C {
            upsilon[j] = upsilon[j] * weight;
            for i in 0..N {
                upsilon[j] = K[i].fnma(bars.rho[i][j], upsilon[j]);
            }
        }
        let mut NK = [T::splat(0.0); N];
        for i in 0..N {
            NK[i] = inner(&bars.N[i], &K);
        }
        let D = weight + inner(&NK, &K);
        sums.noise = T::splat(0.5).fma(inner(&upsilon, &upsilon) - D, sums.noise);
        for j in 0..C {
            sums.upsilon[j] = sums.upsilon[j] + upsilon[j];
        }
        for i in 0..N {
            for j in 0..C {
                bars.rho[i][j] = h[i].fma(upsilon[j], bars.rho[i][j]);
            }
        }
        if self.wanted.equation {
            for i in 0..N {
                let mut sum = -inner(&upsilon, &prior.arrived[i].map(T::splat));
                for j in 0..N {
                    let bar = h[j].fnma(D, inner(&upsilon, &bars.rho[j]) + NK[j]);
                    sum = T::splat(prior.P.arrived[i][j]).fma(bar, sum);
                }
                sums.h[i] = sums.h[i] + sum;
            }
        }
        for i in 0..N {
            for j in 0..N {
                bars.N[i][j] = bars.N[i][j] + D.fma(h[i] * h[j], -h[i].fma(NK[j], NK[i] * h[j]));
            }
        }
    }

    /// The design's part of one step where ρ and N rest.
    #[inline(always)]
    pub(super) fn rested<const C: usize>(
        &self,
        bars: &DesignAdjoint<T, N, C>,
        gain: &Gain<N, C>,
        prior: &PriorMoments<N, C>,
    ) -> DesignSums<T, N, C> {
        let mut each = DesignSums::none();
        self.back(&mut bars.clone(), gain, prior, &mut each);
        each
    }
}
