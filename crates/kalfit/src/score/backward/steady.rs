//! One step of the filter and its way back on arrays of known size, which stay in registers: one scalar measurement of the N
//! states that move; those that rest are constants.

use crate::reduce::{self, Motion, Stretch, mirror, update};
use crate::score::backward::bars::{Bars, Gain, Rest, Spread, Sums};
use crate::score::backward::filtered::Filtered;
use crate::score::backward::run::Run;

/// The coefficients of a step. C: columns of ΨC.
#[derive(Debug, Clone, Copy)]
pub(super) struct Steady<const N: usize, const C: usize> {
    pub(super) filter: reduce::Steady<N>,
    /// With ΨC for Ψ.
    motion: Motion<f64, N, C>,
    noise: f64,
    moves: bool,
    pub(super) equation: bool,
    motion_wanted: bool,
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

impl<const N: usize, const C: usize> Steady<N, C> {
    pub(super) fn new(run: &Run<'_>, stretch: &Stretch<'_>, now: &Filtered) -> Steady<N, C> {
        Steady {
            filter: reduce::Steady::new(run.design, stretch, &now.x),
            motion: Motion::new(stretch.transition.map(|transition| &**transition), &now.Psi),
            noise: run.design.noise[stretch.lines.start],
            moves: stretch.transition.is_some(),
            equation: run.wanted.equation,
            motion_wanted: run.wanted.motion,
        }
    }

    /// φΨC, and φPφ' + Q.
    #[inline(always)]
    fn spread(&self, from: &Spread<N, C>) -> Spread<N, C> {
        Spread { P: self.motion.predict(&from.P), Psi: self.motion.advance(&from.Psi) }
    }

    /// P and ΨC after the step. Where gains rest (`P` false), P does too.
    #[inline(always)]
    pub(super) fn advance(&self, from: &Spread<N, C>, gain: &Gain<N, C>, P: bool) -> Spread<N, C> {
        let K = &gain.K;
        if !P {
            let mut Psi = self.motion.advance(&from.Psi);
            for i in 0..N {
                for j in 0..C {
                    Psi[i][j] -= K[i] * gain.T[j];
                }
            }
            return Spread { P: from.P, Psi };
        }
        let mut to = self.spread(from);
        if gain.weight != 0.0 {
            let (states, P) = (std::array::from_fn::<u32, N, _>(|i| i as u32), to.P.as_flattened_mut());
            update(N, &states, &self.filter.h, self.noise, P, &mut [0.0; N], &mut [0.0; N]);
            mirror(P, N);
        }
        for i in 0..N {
            for j in 0..C {
                to.Psi[i][j] -= K[i] * gain.T[j];
            }
        }
        to
    }

    /// Back through one step; x̄, P, ΨC are those before it.
    #[inline(always)]
    pub(super) fn back(
        &self,
        bars: &mut Bars<N, C>,
        gain: &Gain<N, C>,
        e: f64,
        (x, spread): (&[f64; N], &Spread<N, C>),
        sums: &mut Sums<N, C>,
    ) {
        if gain.weight != 0.0 {
            self.measured(bars, gain, e, (x, spread), sums);
        }
        if !self.moves {
            return;
        }
        for i in 0..N {
            for j in 0..=i {
                let squares = bars.r[i] * bars.r[j] + inner(&bars.rho[i], &bars.rho[j]);
                sums.q[i][j] += 0.5 * (squares - bars.N[i][j]);
            }
            sums.r[i] += bars.r[i];
            for j in 0..C {
                sums.rho[i][j] += bars.rho[i][j];
            }
        }
        let Nphi = product(&bars.N, &self.filter.phi);
        let (r, rho) = (self.adjoint(&bars.r), transposed(&self.filter.phi, &bars.rho));
        if self.motion_wanted {
            for j in 0..N {
                let mut smoothed = x[j];
                let mut B = spread.Psi[j];
                for k in 0..N {
                    smoothed += spread.P[j][k] * r[k];
                    for l in 0..C {
                        B[l] -= spread.P[j][k] * rho[k][l];
                    }
                }
                for i in 0..N {
                    let taken = inner(&bars.rho[i], &B) + inner(&Nphi[i], &spread.P[j]);
                    sums.phi[i][j] += bars.r[i] * smoothed - taken;
                }
            }
        }
        *bars = Bars { r, rho, N: transposed(&self.filter.phi, &Nphi) };
    }

    /// φ'r.
    #[inline(always)]
    fn adjoint(&self, r: &[f64; N]) -> [f64; N] {
        let mut out = [0.0; N];
        for k in 0..N {
            for i in 0..N {
                out[i] += self.filter.phi[k][i] * r[k];
            }
        }
        out
    }

    #[inline(always)]
    fn measured(
        &self,
        bars: &mut Bars<N, C>,
        gain: &Gain<N, C>,
        e: f64,
        (x, spread): (&[f64; N], &Spread<N, C>),
        sums: &mut Sums<N, C>,
    ) {
        let (weight, K, h) = (gain.weight, &gain.K, &self.filter.h);
        let u = e * weight - inner(K, &bars.r);
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
        sums.noise += 0.5 * (u * u + inner(&upsilon, &upsilon) - D);
        sums.u += u;
        for j in 0..C {
            sums.upsilon[j] += upsilon[j];
        }
        for i in 0..N {
            bars.r[i] += h[i] * u;
            for j in 0..C {
                bars.rho[i][j] += h[i] * upsilon[j];
            }
        }
        if self.equation {
            let (x, spread) = (self.filter.predicted(x), self.spread(spread));
            for i in 0..N {
                let mut sum = u * x[i] - inner(&upsilon, &spread.Psi[i]);
                for j in 0..N {
                    let rest = u * bars.r[j] + inner(&upsilon, &bars.rho[j]) + NK[j] - h[j] * D;
                    sum += spread.P[i][j] * rest;
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

    /// Back through one step where N and ρ rest: what changes is summed.
    #[inline(always)]
    pub(super) fn rest_back(&self, r: &mut [f64; N], gain: &Gain<N, C>, e: f64, x: &[f64; N], rest: &mut Rest<N>) {
        let u = e * gain.weight - inner(&gain.K, r);
        rest.u += u;
        rest.uu += u * u;
        for i in 0..N {
            r[i] += self.filter.h[i] * u;
        }
        for i in 0..N {
            if self.equation {
                rest.ux[i] += u * x[i];
                rest.ur[i] += u * r[i];
            }
            rest.r[i] += r[i];
            for j in 0..=i {
                rest.rr[i][j] += r[i] * r[j];
            }
            if self.motion_wanted {
                for j in 0..N {
                    rest.rx[i][j] += r[i] * x[j];
                }
            }
        }
        if self.moves {
            *r = self.adjoint(r);
        }
    }

    /// Adds what has been summed while N and ρ rested.
    pub(super) fn rested(
        &self,
        bars: &Bars<N, C>,
        gain: &Gain<N, C>,
        spread: &Spread<N, C>,
        rest: &Rest<N>,
        sums: &mut Sums<N, C>,
    ) {
        // What every step adds: that of a step with e = r = 0.
        let (mut each, mut still) = (Sums::ZERO, Bars { r: [0.0; N], ..*bars });
        self.back(&mut still, gain, 0.0, (&[0.0; N], spread), &mut each);
        let many = rest.count as f64;
        let before = self.spread(spread);
        sums.noise += many * each.noise + 0.5 * rest.uu;
        sums.u += rest.u;
        for j in 0..C {
            sums.upsilon[j] += many * each.upsilon[j];
        }
        for i in 0..N {
            sums.h[i] += many * each.h[i] + inner(&self.filter.phi[i], &rest.ux) + self.filter.c[i] * rest.u;
            sums.h[i] += inner(&before.P[i], &rest.ur);
        }
        if !self.moves {
            return;
        }
        let rr = |i: usize, j: usize| rest.rr[i.max(j)][i.min(j)];
        for i in 0..N {
            sums.r[i] += rest.r[i];
            for j in 0..C {
                sums.rho[i][j] += many * each.rho[i][j];
            }
            for j in 0..=i {
                sums.q[i][j] += many * each.q[i][j] + 0.5 * rest.rr[i][j];
            }
            for j in 0..N {
                sums.phi[i][j] += many * each.phi[i][j] + rest.rx[i][j];
                for l in 0..N {
                    let moved: f64 = (0..N).map(|m| self.filter.phi[m][l] * rr(i, m)).sum();
                    sums.phi[i][j] += spread.P[j][l] * moved;
                }
            }
        }
    }
}
