//! Moments of states and noises, from the adjoints of the backward pass (theory §6).
//!
//! ```text
//! E[x] = x̄ + Pr        Var[x] = P - PNP + BB'        B = ΨC - Pρ
//! E[w] = Qr        E[ww'] = Q + Q(rr' + ρρ' - N)Q        Cov[w, x] = -Q(ρB' + NφP)
//! ```
#![expect(non_snake_case, reason = "the letters of the theory: P, B, N")]

use crate::reduce::{DesignStep, Transition};
use crate::score::backward::filtered::FilterSnapshot;
use crate::score::backward::forward::FilterPosition;
use crate::score::backward::input::BackwardInput;
use crate::score::backward::kernel::{dot, outer_entry, times_phi};
use crate::score::backward::work::{BackwardWork, KnownInnovations};

/// Smoothed moments of a test.
#[derive(Debug)]
pub(crate) struct SmoothedTest {
    /// Moments of x_0, then of the state after each step.
    pub(crate) states: Vec<Smoothed>,
    /// Moments of the noise of the transition to each step; `None` where there is no transition.
    pub(crate) noises: Vec<Option<SmoothedNoise>>,
    /// ∂ℓ/∂a (n).
    pub(crate) mean: Vec<f64>,
    /// ∂ℓ/∂P0 (r × r, entries taken as independent).
    pub(crate) variance: Vec<f64>,
}

/// E\[x\] and Var\[x\] at one time, given all data of the test.
#[derive(Debug, Clone, Default)]
pub struct Smoothed {
    /// E\[x\], n numbers.
    pub mean: Vec<f64>,
    /// Var\[x\], n × n.
    pub variance: Vec<f64>,
}

/// Moments of the noise w of one transition given all data of the test, on the r noise-reachable states.
#[derive(Debug, Clone, Default)]
pub(crate) struct SmoothedNoise {
    /// E[w] (r).
    pub(crate) mean: Vec<f64>,
    /// E[ww'] (r × r).
    pub(crate) second: Vec<f64>,
    /// Cov[w, x] with the state x before the transition (r × n).
    pub(crate) cross: Vec<f64>,
}

impl SmoothedNoise {
    /// Sets E[w] = Qr and E[ww'] = Q + Q(rr' + ρρ' - N)Q, with r, ρ, N of the state after the transition.
    pub(super) fn at(
        &mut self,
        transition: &Transition,
        (adjoint, rho, N): (&[f64], &[f64], &[f64]),
        (r, c): (usize, usize),
    ) {
        let q = transition.dense_noise(r, |i| i);
        let q = q.as_slice(); // symmetric
        self.mean.clear();
        self.mean.extend((0..r).map(|i| dot(&q[i * r..][..r], &adjoint[..r])));
        let g: Vec<f64> = (0..r * r).map(|ij| outer_entry(adjoint, rho, c, ij / r, ij % r) - N[ij]).collect();
        let qg = product(q, &g, r, r);
        self.second = product(&qg, q, r, r);
        self.second.iter_mut().zip(q).for_each(|(second, q)| *second += q);
    }

    /// Sets Cov[w, x] = -Q(ρB' + NφP). `N`: Nφ; `rho`: φ'ρ; `rho_before`: ρ.
    pub(super) fn set_cross_moment(
        &mut self,
        transition: &Transition,
        left: FilterSnapshot<'_>,
        (rho, rho_before): (&[f64], &[f64]),
        (N, r, c): (&[f64], usize, usize),
    ) {
        let n = left.x.len();
        let B = left.smoothed_sensitivity(rho, r, c);
        let mut inner = vec![0.0; r * n];
        for i in 0..r {
            for j in 0..n {
                inner[i * n + j] = -dot(&rho_before[i * c..][..c], &B[j * c..][..c]);
            }
            for j in 0..r {
                inner[i * n + j] -= (0..r).map(|m| N[i * r + m] * left.P[m * r + j]).sum::<f64>();
            }
        }
        self.cross = product(transition.dense_noise(r, |i| i).as_slice(), &inner, r, n);
    }
}

/// AB with A r × r, B r × n.
fn product(a: &[f64], b: &[f64], r: usize, n: usize) -> Vec<f64> {
    let mut out = vec![0.0; r * n];
    for i in 0..r {
        for (k, &a) in a[i * r..][..r].iter().enumerate().filter(|(_, a)| **a != 0.0) {
            out[i * n..][..n].iter_mut().zip(&b[k * n..]).for_each(|(out, b)| *out += a * b);
        }
    }
    out
}

impl FilterSnapshot<'_> {
    /// ΨC - Pρ (n × c): sensitivity of the smoothed state to ξ, times C.
    fn smoothed_sensitivity(&self, rho: &[f64], r: usize, c: usize) -> Vec<f64> {
        let mut B = self.Psi.to_vec();
        for i in 0..r {
            for j in 0..r {
                let P = self.P[i * r + j];
                (0..c).for_each(|k| B[i * c + k] -= P * rho[j * c + k]);
            }
        }
        B
    }

    /// Sets `out` to the moments of the state given all data: x̄ + Pr, and P - PNP + BB'.
    pub(super) fn smooth(&self, adjoint: &[f64], rho: &[f64], (N, r, c): (&[f64], usize, usize), out: &mut Smoothed) {
        let n = self.x.len();
        let B = self.smoothed_sensitivity(rho, r, c);
        out.mean.clear();
        out.mean.extend_from_slice(self.x);
        out.variance.clear();
        out.variance.extend((0..n * n).map(|ij| dot(&B[ij / n * c..][..c], &B[ij % n * c..][..c])));
        let PNP = product(&product(self.P, N, r, r), self.P, r, r);
        for i in 0..r {
            out.mean[i] += dot(&self.P[i * r..][..r], &adjoint[..r]);
            (0..r).for_each(|j| out.variance[i * n + j] += self.P[i * r + j] - PNP[i * r + j]);
        }
    }
}

impl BackwardInput<'_> {
    /// Smoothed moments of the test, step by step, with every state of the forward filter stored. `wanted.motion` must
    /// be set, so that the filter keeps P and ΨC.
    pub(crate) fn smooth(&self, work: &mut BackwardWork) -> SmoothedTest {
        let (r, c) = (self.design.frame.r, self.moments.columns);
        let stride = self.stride();
        let (mut ends, mut left) = (Vec::new(), Vec::new());
        self.forward_storing_all(work, &mut ends, &mut left);
        let BackwardWork { e, adjoint, measured, moved, variance, .. } = work;
        adjoint.begin(&self.posterior(), self.after());
        let seen = |kept: &'_ [f64], at: usize| at * stride..kept.len().min((at + 1) * stride);
        let (mut k, mut transitions) = (self.design.steps(), left.len() / stride.max(1));
        let (mut states, mut noises) = (vec![Smoothed::default(); k + 1], vec![None; k]);
        for step in self.design.each_step().rev() {
            let end = FilterSnapshot::new(&ends[seen(&ends, k)], self.sizes());
            end.smooth(&adjoint.r, &adjoint.rho, (&adjoint.N, r, c), &mut states[k]);
            k -= 1;
            self.measured_back(&step, e.values(), |_| end, (adjoint, measured));
            let Some(transition) = step.transition else { continue };
            transitions -= 1;
            let before = FilterSnapshot::new(&left[seen(&left, transitions)], self.sizes());
            let mut noise = SmoothedNoise::default();
            noise.at(transition, (&adjoint.r, &adjoint.rho, &adjoint.N), (r, c));
            let mut n_phi = adjoint.N.clone();
            times_phi(&mut n_phi, r, transition.view(), &mut Vec::new());
            let rho = adjoint.rho.clone();
            adjoint.moved(&self.posterior(), transition.view(), None, moved);
            noise.set_cross_moment(transition, before, (&adjoint.rho, &rho), (&n_phi, r, c));
            noises[k] = Some(noise);
        }
        let start = FilterSnapshot::new(&ends[seen(&ends, 0)], self.sizes());
        start.smooth(&adjoint.r, &adjoint.rho, (&adjoint.N, r, c), &mut states[0]);
        adjoint.start_covariance_adjoint(&self.posterior(), variance);
        SmoothedTest { states, noises, mean: adjoint.r.clone(), variance: variance.clone() }
    }

    /// Runs the filter at ξ = x̂ step by step, and calls `visit` with the state of the filter before the measurements
    /// of a step (`false`) and after them (`true`). `e`: the innovations from the data pass. `wanted.motion` must be
    /// set.
    pub fn filtered_states(
        &self,
        work: &mut BackwardWork,
        e: &[f64],
        mut visit: impl FnMut(&DesignStep<'_>, bool, FilterSnapshot<'_>),
    ) {
        let BackwardWork { now, .. } = work;
        self.begin(now);
        let mut e = KnownInnovations::all(e.to_vec());
        self.each_position(self.design.each_step(), 0, (now, &mut e), |at, step, now| match at {
            FilterPosition::AfterTransition => visit(step, false, now.seen()),
            FilterPosition::AfterMeasurements => visit(step, true, now.seen()),
            FilterPosition::BeforeTransition | FilterPosition::BeforeMeasurement => {}
        });
    }

    /// Runs the filter at ξ = x̂ and stores the state of the filter at the start and after each step (`ends`), and
    /// before each transition (`left`).
    fn forward_storing_all(&self, work: &mut BackwardWork, ends: &mut Vec<f64>, left: &mut Vec<f64>) {
        let BackwardWork { e, now, .. } = work;
        e.clear(self.values.len());
        self.begin(now);
        now.save(ends);
        self.each_position(self.design.each_step(), 0, (now, e), |at, _, now| match at {
            FilterPosition::BeforeTransition => now.save(left),
            FilterPosition::AfterMeasurements => now.save(ends),
            FilterPosition::AfterTransition | FilterPosition::BeforeMeasurement => {}
        });
    }
}
