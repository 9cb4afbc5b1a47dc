//! The part of the backward pass through equal steps of one scalar measurement that depends on the design alone, on
//! arrays of fixed size: N states that move, and C columns of ΨC. The other states are constant. The data-dependent
//! part is in `data_adjoint`.

use kalfit_lanes::{Lanes, Real};

use crate::score::backward::data_adjoint::{PriorVariances, StepCoefficients, one};

/// P and ΨC before a step and, where ∂ℓ/∂h is wanted, before the measurement of the step.
#[derive(Debug, Clone, Copy)]
pub(super) struct PriorMoments<const N: usize, const C: usize> {
    pub(super) P: PriorVariances<N>,
    pub(super) before_step: [[f64; C]; N],
    pub(super) before_measurement: [[f64; C]; N],
}

/// (1/S, K) and TC of a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gain<const N: usize, const C: usize> {
    pub(super) own: (f64, [f64; N]),
    pub(super) T: [f64; C],
}

/// The adjoints ρ and N of the states that move.
#[derive(Debug, Clone, Copy)]
pub(super) struct DesignAdjoint<T, const N: usize, const C: usize> {
    pub(super) rho: [[T; C]; N],
    pub(super) N: [[T; N]; N],
}

impl<T: Lanes, const N: usize, const C: usize> DesignAdjoint<T, N, C> {
    /// The adjoints of the test in the first lane.
    pub(super) fn one(&self) -> DesignAdjoint<f64, N, C> {
        DesignAdjoint { rho: self.rho.map(one), N: self.N.map(one) }
    }
}

/// The part of the adjoints of the coefficients that depends on the design alone, summed over steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct DesignSums<T, const N: usize, const C: usize> {
    pub(super) noise: T,
    pub(super) upsilon: [T; C],
    pub(super) h: [T; N],
    pub(super) q: [[T; N]; N],
    pub(super) phi: [[T; N]; N],
    /// Sums of ρ of the states after the transitions.
    pub(super) rho: [[T; C]; N],
}

impl<T: Real, const N: usize, const C: usize> DesignSums<T, N, C> {
    #[inline(always)]
    pub(super) fn zeros() -> DesignSums<T, N, C> {
        let zero = T::splat(0.0);
        let (columns, matrix) = ([zero; C], [[zero; N]; N]);
        DesignSums { noise: zero, upsilon: columns, h: [zero; N], q: matrix, phi: matrix, rho: [columns; N] }
    }

    /// Adds `many` times the sums `others`.
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
    /// The sums of the test in the first lane.
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

#[inline(always)]
fn inner_product<T: Real, const M: usize>(a: &[T; M], b: &[T; M]) -> T {
    let mut sum = T::splat(0.0);
    for i in 0..M {
        sum = a[i].fma(b[i], sum);
    }
    sum
}

/// The product φ'X.
#[inline(always)]
fn phi_transposed_times<T: Real, const N: usize, const W: usize>(phi: &[[f64; N]; N], x: &[[T; W]; N]) -> [[T; W]; N] {
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

/// The product Nφ.
#[inline(always)]
fn times_phi<T: Real, const N: usize>(x: &[[T; N]; N], phi: &[[f64; N]; N]) -> [[T; N]; N] {
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

impl<T: Real, const N: usize, const C: usize> DesignAdjoint<T, N, C> {
    /// The backward pass through one step.
    #[inline(always)]
    pub(super) fn back(
        &mut self,
        step: &StepCoefficients<T, N>,
        gain: &Gain<N, C>,
        prior: &PriorMoments<N, C>,
        sums: &mut DesignSums<T, N, C>,
    ) {
        if gain.own.0 != 0.0 {
            self.measured(step, gain, prior, sums);
        }
        if !step.has_transition {
            return;
        }
        let half = T::splat(0.5);
        for i in 0..N {
            for j in 0..=i {
                sums.q[i][j] = half.fma(inner_product(&self.rho[i], &self.rho[j]) - self.N[i][j], sums.q[i][j]);
            }
            for j in 0..C {
                sums.rho[i][j] = sums.rho[i][j] + self.rho[i][j];
            }
        }
        let phi = &step.filter.phi;
        let (Nphi, rho) = (times_phi(&self.N, phi), phi_transposed_times(phi, &self.rho));
        if step.wanted.motion {
            for j in 0..N {
                let (P, mut B) = (prior.P.before_step[j].map(T::splat), prior.before_step[j].map(T::splat));
                for k in 0..N {
                    for l in 0..C {
                        B[l] = P[k].fnma(rho[k][l], B[l]);
                    }
                }
                for i in 0..N {
                    sums.phi[i][j] = sums.phi[i][j] - (inner_product(&self.rho[i], &B) + inner_product(&Nphi[i], &P));
                }
            }
        }
        *self = DesignAdjoint { rho, N: phi_transposed_times(phi, &Nphi) };
    }

    #[inline(always)]
    fn measured(
        &mut self,
        step: &StepCoefficients<T, N>,
        gain: &Gain<N, C>,
        prior: &PriorMoments<N, C>,
        sums: &mut DesignSums<T, N, C>,
    ) {
        let (weight, K) = (T::splat(gain.own.0), gain.own.1.map(T::splat));
        let (h, mut upsilon) = (step.filter.h.map(T::splat), gain.T.map(T::splat));
        for j in 0..C {
            upsilon[j] = upsilon[j] * weight;
            for i in 0..N {
                upsilon[j] = K[i].fnma(self.rho[i][j], upsilon[j]);
            }
        }
        let mut NK = [T::splat(0.0); N];
        for i in 0..N {
            NK[i] = inner_product(&self.N[i], &K);
        }
        let D = weight + inner_product(&NK, &K);
        sums.noise = T::splat(0.5).fma(inner_product(&upsilon, &upsilon) - D, sums.noise);
        for j in 0..C {
            sums.upsilon[j] = sums.upsilon[j] + upsilon[j];
        }
        for i in 0..N {
            for j in 0..C {
                self.rho[i][j] = h[i].fma(upsilon[j], self.rho[i][j]);
            }
        }
        if step.wanted.equation {
            for i in 0..N {
                let mut sum = -inner_product(&upsilon, &prior.before_measurement[i].map(T::splat));
                for j in 0..N {
                    let bar = h[j].fnma(D, inner_product(&upsilon, &self.rho[j]) + NK[j]);
                    sum = T::splat(prior.P.before_measurement[i][j]).fma(bar, sum);
                }
                sums.h[i] = sums.h[i] + sum;
            }
        }
        for i in 0..N {
            for j in 0..N {
                self.N[i][j] = self.N[i][j] + D.fma(h[i] * h[j], -h[i].fma(NK[j], NK[i] * h[j]));
            }
        }
    }

    /// The contribution of one step to the sums while ρ and N are constant.
    #[inline(always)]
    pub(super) fn rested(
        &self,
        step: &StepCoefficients<T, N>,
        gain: &Gain<N, C>,
        prior: &PriorMoments<N, C>,
    ) -> DesignSums<T, N, C> {
        let mut each = DesignSums::zeros();
        self.clone().back(step, gain, prior, &mut each);
        each
    }
}
