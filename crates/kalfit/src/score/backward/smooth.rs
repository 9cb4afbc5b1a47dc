//! Moments of states and noises, from the adjoints of the backward pass (theory §6).
//!
//! ```text
//! E[x] = x̄ + Pr        Var[x] = P - PNP + BB'        B = ΨC - Pρ
//! E[w] = Qr        E[ww'] = Q + Q(rr' + ρρ' - N)Q        Cov[w, x] = -Q(ρB' + NφP)
//! ```
#![expect(non_snake_case, reason = "the letters of the theory: P, B, N")]

use crate::reduce::Transition;
use crate::score::backward::{Filtered, dot, second};

/// E[x] and Var[x] at one time, given all data of the test.
#[derive(Debug, Clone, Default)]
pub(crate) struct Smoothed {
    /// n numbers.
    pub(crate) mean: Vec<f64>,
    /// n × n.
    pub(crate) variance: Vec<f64>,
}

/// Moments of the noise w of one transition given all data of the test, on the r noise-reachable states.
#[derive(Debug, Clone, Default)]
pub(crate) struct Driven {
    /// E[w] (r).
    pub(crate) mean: Vec<f64>,
    /// E[ww'] (r × r).
    pub(crate) second: Vec<f64>,
    /// Cov[w, x] with the state x before the transition (r × n).
    pub(crate) cross: Vec<f64>,
}

impl Driven {
    /// E[w] = Qr, E[ww'] = Q + Q(rr' + ρρ' - N)Q, with r, ρ, N before they move on.
    pub(super) fn at(
        &mut self,
        transition: &Transition,
        (adjoint, rho, N): (&[f64], &[f64], &[f64]),
        (r, c): (usize, usize),
    ) {
        let q = full_noise(transition, r);
        self.mean.clear();
        self.mean.extend((0..r).map(|i| dot(&q[i * r..][..r], adjoint)));
        let g: Vec<f64> = (0..r * r).map(|ij| second(adjoint, rho, c, ij / r, ij % r) - N[ij]).collect();
        let qg = product(&q, &g, r, r);
        self.second = product(&qg, &q, r, r);
        self.second.iter_mut().zip(&q).for_each(|(second, q)| *second += q);
    }

    /// Cov[w, x] = -Q(ρB' + NφP), `N` being Nφ, `rho` φ'ρ.
    pub(super) fn across(
        &mut self,
        transition: &Transition,
        left: &Filtered,
        (rho, rho_before): (&[f64], &[f64]),
        (N, r, c): (&[f64], usize, usize),
    ) {
        let n = left.x.len();
        let B = left.unknown_part(rho, r, c);
        let mut inner = vec![0.0; r * n];
        for i in 0..r {
            for j in 0..n {
                inner[i * n + j] = -dot(&rho_before[i * c..][..c], &B[j * c..][..c]);
            }
            for j in 0..r {
                inner[i * n + j] -= (0..r).map(|m| N[i * r + m] * left.P[m * r + j]).sum::<f64>();
            }
        }
        self.cross = product(&full_noise(transition, r), &inner, r, n);
    }
}

/// Q, both triangles, r × r.
fn full_noise(transition: &Transition, r: usize) -> Vec<f64> {
    let mut q = vec![0.0; r * r];
    for (&(i, j), &value) in transition.pattern.pairs.iter().zip(&transition.q) {
        q[i as usize * r + j as usize] = value;
        q[j as usize * r + i as usize] = value;
    }
    q
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

impl Filtered {
    /// ΨC - Pρ (n × c): what the smoothed state owes to ξ.
    fn unknown_part(&self, rho: &[f64], r: usize, c: usize) -> Vec<f64> {
        let mut B = self.Psi.clone();
        for i in 0..r {
            for j in 0..r {
                let P = self.P[i * r + j];
                (0..c).for_each(|k| B[i * c + k] -= P * rho[j * c + k]);
            }
        }
        B
    }

    /// The state given all data: x̄ + Pr, and P - PNP + BB'.
    pub(super) fn smooth(&self, adjoint: &[f64], rho: &[f64], (N, r, c): (&[f64], usize, usize), out: &mut Smoothed) {
        let n = self.x.len();
        let B = self.unknown_part(rho, r, c);
        out.mean.clone_from(&self.x);
        out.variance.clear();
        out.variance.extend((0..n * n).map(|ij| dot(&B[ij / n * c..][..c], &B[ij % n * c..][..c])));
        let PNP = product(&product(&self.P, N, r, r), &self.P, r, r);
        for i in 0..r {
            out.mean[i] += dot(&self.P[i * r..][..r], adjoint);
            (0..r).for_each(|j| out.variance[i * n + j] += self.P[i * r + j] - PNP[i * r + j]);
        }
    }
}
