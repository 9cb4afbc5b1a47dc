//! One step of the filter and its way back on arrays of known size: one scalar measurement of the N
//! states that move; those that rest are constants. Of the adjoints the data's part has a file of its own
//! ([`DataAdjoint`]); the rest is the design's.

use kalfit_lanes::Real;

use crate::reduce::{Stretch, mirror, update};
use crate::score::backward::data_adjoint::{DataAdjoint, PriorVariances};
use crate::score::backward::design_sums::{DesignAdjoint, DesignSums, FilterCovariance, Gain};
use crate::score::backward::filtered::FilteredMoments;
use crate::score::backward::run::{AdjointsWanted, BackwardInput};

/// The coefficients of a step. C: columns of ΨC.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepCoefficients<const N: usize, const C: usize> {
    pub(super) data: DataAdjoint<f64, N>,
    Q: [[f64; N]; N],
    /// What the states that rest add to φΨC.
    c: [[f64; C]; N],
    noise: f64,
    moves: bool,
    wanted: AdjointsWanted,
}

fn inner<const M: usize>(a: &[f64; M], b: &[f64; M]) -> f64 {
    let mut sum = 0.0;
    for i in 0..M {
        sum += a[i] * b[i];
    }
    sum
}

/// φ'X.
#[inline(always)]
fn transposed<const N: usize, const W: usize>(phi: &[[f64; N]; N], x: &[[f64; W]; N]) -> [[f64; W]; N] {
    let mut out = [[0.0; W]; N];
    for k in 0..N {
        for i in 0..N {
            for j in 0..W {
                out[i][j] += phi[k][i] * x[k][j];
            }
        }
    }
    out
}

/// XY.
#[inline(always)]
fn product<const N: usize, const W: usize>(x: &[[f64; N]; N], y: &[[f64; W]; N]) -> [[f64; W]; N] {
    let mut out = [[0.0; W]; N];
    for i in 0..N {
        for k in 0..N {
            for j in 0..W {
                out[i][j] += x[i][k] * y[k][j];
            }
        }
    }
    out
}

impl<const N: usize, const C: usize> StepCoefficients<N, C> {
    pub(super) fn new(run: &BackwardInput<'_>, stretch: &Stretch<'_>, now: &FilteredMoments) -> StepCoefficients<N, C> {
        let (mut Q, mut c) = ([[0.0; N]; N], [[0.0; C]; N]);
        if let Some(transition) = stretch.transition {
            for (&(i, j), &q) in transition.pattern.pairs.iter().zip(&transition.q) {
                (Q[i as usize][j as usize], Q[j as usize][i as usize]) = (q, q);
            }
            let resting = |(_, j, _): &(usize, usize, f64)| *j >= N && !now.Psi.is_empty();
            for (i, j, phi) in transition.entries().filter(resting) {
                (0..C).for_each(|l| c[i][l] = phi.fma(now.Psi[j * C + l], c[i][l]));
            }
        }
        StepCoefficients {
            data: DataAdjoint::new(run, stretch, &now.x),
            Q,
            c,
            noise: run.design.noise[stretch.lines.start],
            moves: stretch.transition.is_some(),
            wanted: run.wanted,
        }
    }

    /// φΨC.
    #[inline(always)]
    fn advanced(&self, Psi: &[[f64; C]; N]) -> [[f64; C]; N] {
        let (phi, mut moved) = (&self.data.filter.phi, self.c);
        for i in 0..N {
            for k in 0..N {
                for j in 0..C {
                    moved[i][j] = phi[i][k].fma(Psi[k][j], moved[i][j]);
                }
            }
        }
        moved
    }

    /// φPφ' + Q.
    #[inline(always)]
    fn predicted(&self, P: &[[f64; N]; N]) -> [[f64; N]; N] {
        let (phi, mut moved) = (&self.data.filter.phi, self.Q);
        let mut phiP = [[0.0; N]; N];
        for i in 0..N {
            for k in 0..N {
                for j in 0..N {
                    phiP[i][j] = phi[i][k].fma(P[k][j], phiP[i][j]);
                }
            }
        }
        for i in 0..N {
            for j in 0..=i {
                let mut sum = 0.0;
                for k in 0..N {
                    sum = phi[j][k].fma(phiP[i][k], sum);
                }
                moved[i][j] += sum;
                moved[j][i] = moved[i][j];
            }
        }
        moved
    }

    /// P before a step and, if it is wanted there, before its measurement.
    #[inline(always)]
    pub(super) fn ahead(&self, P: &[[f64; N]; N]) -> PriorVariances<N> {
        PriorVariances { left: *P, arrived: if self.wanted.equation { self.predicted(P) } else { *P } }
    }

    /// P and ΨC after the step. Where gains rest (`P` false), P does too.
    #[inline(always)]
    pub(super) fn advance(&self, from: &FilterCovariance<N, C>, gain: &Gain<N, C>, P: bool) -> FilterCovariance<N, C> {
        let mut Psi = self.advanced(&from.Psi);
        for i in 0..N {
            for j in 0..C {
                Psi[i][j] -= gain.K[i] * gain.T[j];
            }
        }
        FilterCovariance { P: if P { self.updated(&from.P, gain.weight) } else { from.P }, Psi }
    }

    /// P after the step.
    #[inline(always)]
    pub(super) fn updated(&self, P: &[[f64; N]; N], weight: f64) -> [[f64; N]; N] {
        let mut to = self.predicted(P);
        if weight != 0.0 {
            let (states, P) = (std::array::from_fn::<u32, N, _>(|i| i as u32), to.as_flattened_mut());
            update(N, &states, &self.data.filter.h, self.noise, P, &mut [0.0; N], &mut [0.0; N]);
            mirror(P, N);
        }
        to
    }

    /// The design's part of the way back through one step; P and ΨC are those before it.
    #[inline(always)]
    pub(super) fn back(
        &self,
        bars: &mut DesignAdjoint<N, C>,
        gain: &Gain<N, C>,
        (spread, ahead): (&FilterCovariance<N, C>, &PriorVariances<N>),
        sums: &mut DesignSums<N, C>,
    ) {
        if gain.weight != 0.0 {
            self.measured(bars, gain, (spread, ahead), sums);
        }
        if !self.moves {
            return;
        }
        for i in 0..N {
            for j in 0..=i {
                sums.q[i][j] += 0.5 * (inner(&bars.rho[i], &bars.rho[j]) - bars.N[i][j]);
            }
            for j in 0..C {
                sums.rho[i][j] += bars.rho[i][j];
            }
        }
        let phi = &self.data.filter.phi;
        let (Nphi, rho) = (product(&bars.N, phi), transposed(phi, &bars.rho));
        if self.wanted.motion {
            for j in 0..N {
                let mut B = spread.Psi[j];
                for k in 0..N {
                    for l in 0..C {
                        B[l] -= spread.P[j][k] * rho[k][l];
                    }
                }
                for i in 0..N {
                    sums.phi[i][j] -= inner(&bars.rho[i], &B) + inner(&Nphi[i], &spread.P[j]);
                }
            }
        }
        *bars = DesignAdjoint { rho, N: transposed(phi, &Nphi) };
    }

    #[inline(always)]
    fn measured(
        &self,
        bars: &mut DesignAdjoint<N, C>,
        gain: &Gain<N, C>,
        (spread, ahead): (&FilterCovariance<N, C>, &PriorVariances<N>),
        sums: &mut DesignSums<N, C>,
    ) {
        let (weight, K, h) = (gain.weight, &gain.K, &self.data.filter.h);
        let mut upsilon = gain.T;
        for j in 0..C {
            upsilon[j] *= weight;
            for i in 0..N {
                upsilon[j] -= K[i] * bars.rho[i][j];
            }
        }
        let mut NK = [0.0; N];
        for i in 0..N {
            NK[i] = inner(&bars.N[i], K);
        }
        let D = weight + inner(&NK, K);
        sums.noise += 0.5 * (inner(&upsilon, &upsilon) - D);
        for j in 0..C {
            sums.upsilon[j] += upsilon[j];
        }
        for i in 0..N {
            for j in 0..C {
                bars.rho[i][j] += h[i] * upsilon[j];
            }
        }
        if self.wanted.equation {
            let Psi = self.advanced(&spread.Psi);
            for i in 0..N {
                let mut sum = -inner(&upsilon, &Psi[i]);
                for j in 0..N {
                    sum += ahead.arrived[i][j] * (inner(&upsilon, &bars.rho[j]) + NK[j] - h[j] * D);
                }
                sums.h[i] += sum;
            }
        }
        for i in 0..N {
            for j in 0..N {
                bars.N[i][j] += D * (h[i] * h[j]) - (h[i] * NK[j] + NK[i] * h[j]);
            }
        }
    }

    /// The design's part of one step where ρ and N rest.
    pub(super) fn rested(
        &self,
        bars: &DesignAdjoint<N, C>,
        gain: &Gain<N, C>,
        spread: &FilterCovariance<N, C>,
    ) -> DesignSums<N, C> {
        let mut each = DesignSums::ZERO;
        self.back(&mut bars.clone(), gain, (spread, &self.ahead(&spread.P)), &mut each);
        each
    }
}
