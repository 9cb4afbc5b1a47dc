//! The way back through one step: r, ρ, N and what they say of the coefficients of the step.

use crate::reduce::{Step, Transition};
use crate::score::backward::filtered::{Seen, second};
use crate::score::backward::{MeasuredBar, MovedBar, Run, dot};

/// Adjoints of the state: r (n), ρ (n × c), N (r × r).
#[derive(Debug, Clone, Default)]
pub(super) struct Adjoint {
    pub(super) r: Vec<f64>,
    pub(super) rho: Vec<f64>,
    pub(super) N: Vec<f64>,
    NK: Vec<f64>,
    upsilon: Vec<f64>,
    /// r and ρ before they move on.
    before: Vec<f64>,
    smoothed: Vec<f64>,
    rows: Vec<f64>,
}

/// One scalar measurement on its way back.
struct Scalar<'a> {
    u: f64,
    states: &'a [u32],
    h: &'a [f64],
    /// 1/S + K'NK.
    D: f64,
}

impl Adjoint {
    /// As after the last step: zero, or what later phases say of the state there.
    pub(super) fn begin(&mut self, run: &Run<'_>) {
        let (n, r, c) = (run.design.frame.n, run.design.frame.r, run.moments.columns);
        for (list, size) in [(&mut self.r, n), (&mut self.rho, n * c), (&mut self.N, r * r)] {
            list.clear();
            list.resize(size, 0.0);
        }
        if let Some(ending) = run.ending {
            self.r.copy_from_slice(&ending.r);
            self.rho.copy_from_slice(&ending.rho);
            self.N.copy_from_slice(&ending.N);
        }
    }

    /// ∂ℓ/∂P0, each place by itself.
    pub(super) fn variance(&self, run: &Run<'_>, out: &mut Vec<f64>) {
        let (r, c) = (run.design.frame.r, run.moments.columns);
        let entry = |ij: usize| 0.5 * second(&self.r, &self.rho, c, ij / r, ij % r) - 0.5 * self.N[ij];
        out.clear();
        out.extend((0..r * r).map(entry));
    }

    /// The measurements of one step, the last first. `before`: the filter before a measurement with this place in the step.
    pub(super) fn measured<'s>(
        &mut self,
        run: &Run<'_>,
        step: &Step<'_>,
        e: &[f64],
        before: impl Fn(usize) -> Seen<'s>,
        bar: &mut MeasuredBar,
    ) {
        let (n, m) = (run.design.frame.n, step.rows.len());
        let equations = if run.wanted.equation { m * n } else { 0 };
        for (list, size) in [(&mut bar.noise, m), (&mut bar.value, m), (&mut bar.h, equations)] {
            list.clear();
            list.resize(size, 0.0);
        }
        for (place, (line, row)) in step.lines.clone().zip(step.rows.clone()).enumerate().rev() {
            let (weight, K, T) = run.gains.row(row);
            if weight == 0.0 {
                continue; // it can only be what it is: K and T are zero
            }
            let (states, h) = run.design.terms(line);
            let KNK = self.innovation(run, (weight, K, T));
            let u = e[row] * weight - dot(K, &self.r);
            let scalar = Scalar { u, states, h, D: weight + KNK };
            bar.noise[place] = 0.5 * (u * u + dot(&self.upsilon, &self.upsilon) - scalar.D);
            bar.value[place] = -u;
            self.row_back(&scalar);
            if run.wanted.equation {
                self.equation_bar(&scalar, before(place), &mut bar.h[place * n..][..n]);
            }
            self.information_back(&scalar);
        }
    }

    /// υ and NK of a measurement; returns K'NK.
    fn innovation(&mut self, run: &Run<'_>, (weight, K, T): (f64, &[f64], &[f64])) -> f64 {
        let (r, c) = (run.design.frame.r, run.moments.columns);
        let Adjoint { rho, N, NK, upsilon, .. } = self;
        run.times_root(T, upsilon);
        upsilon.iter_mut().for_each(|upsilon| *upsilon *= weight);
        for (K, rho) in K.iter().zip(rho.chunks_exact(c.max(1))) {
            upsilon.iter_mut().zip(rho).for_each(|(upsilon, rho)| *upsilon -= K * rho);
        }
        NK.clear();
        NK.extend(N.chunks_exact(r.max(1)).map(|row| dot(row, K)));
        dot(NK, K)
    }

    /// r ← r + hu, ρ ← ρ + hυ.
    fn row_back(&mut self, scalar: &Scalar<'_>) {
        let c = self.upsilon.len();
        for (&state, &h) in scalar.states.iter().zip(scalar.h) {
            self.r[state as usize] += h * scalar.u;
            let rho = &mut self.rho[state as usize * c..][..c];
            rho.iter_mut().zip(&self.upsilon).for_each(|(rho, upsilon)| *rho += h * upsilon);
        }
    }

    /// N ← hh'/S + (I-Kh')'N(I-Kh') = N - h(NK)' - (NK)h' + (1/S + K'NK) hh'.
    fn information_back(&mut self, scalar: &Scalar<'_>) {
        let Adjoint { N, NK, .. } = self;
        let r = NK.len();
        let reach = scalar.states.partition_point(|&state| (state as usize) < r);
        let terms = || scalar.states[..reach].iter().map(|&state| state as usize).zip(scalar.h);
        for (a, &ha) in terms() {
            for i in 0..r {
                N[a * r + i] -= ha * NK[i];
                N[i * r + a] -= ha * NK[i];
            }
            for (b, &hb) in terms() {
                N[a * r + b] += scalar.D * ha * hb;
            }
        }
    }

    /// ∂ℓ/∂h; r and ρ are those after the line.
    fn equation_bar(&mut self, scalar: &Scalar<'_>, before: Seen<'_>, bar: &mut [f64]) {
        let Adjoint { r: adjoint, rho, NK, upsilon, smoothed, .. } = self;
        let (r, c) = (NK.len(), upsilon.len());
        for (i, bar) in bar.iter_mut().enumerate() {
            *bar = scalar.u * before.x[i] - dot(upsilon, &before.Psi[i * c..][..c]);
        }
        // ur + ρυ' - (h/S - (I-Kh')'NK), where that is h (1/S + K'NK) - NK
        smoothed.clear();
        smoothed.extend((0..r).map(|j| scalar.u * adjoint[j] + dot(upsilon, &rho[j * c..][..c]) + NK[j]));
        let reach = scalar.states.partition_point(|&state| (state as usize) < r);
        for (&state, &h) in scalar.states[..reach].iter().zip(scalar.h) {
            smoothed[state as usize] -= h * scalar.D;
        }
        for i in 0..r {
            bar[i] += dot(&before.P[i * r..][..r], smoothed);
        }
    }

    /// One transition. `left`: the filter before it, where adjoints of φ are wanted.
    pub(super) fn moved(&mut self, run: &Run<'_>, transition: &Transition, left: Option<Seen<'_>>, bar: &mut MovedBar) {
        let (r, c) = (run.design.frame.r, run.moments.columns);
        let (Adjoint { r: adjoint, rho, N, before, rows, .. }, pattern) = (&mut *self, &transition.pattern);
        bar.input.clear();
        bar.input.extend(run.design.frame.driven.iter().map(|&state| adjoint[state as usize]));
        bar.q.clear();
        bar.q.extend(pattern.pairs.iter().map(|&(i, j)| {
            let (i, j) = (i as usize, j as usize);
            let one = 0.5 * (second(adjoint, rho, c, i, j) - N[i * r + j]);
            if i == j { one } else { 2.0 * one }
        }));
        bar.phi.clear();
        bar.phi.resize(transition.phi.len(), 0.0);
        if left.is_some() {
            before.clear();
            before.extend_from_slice(adjoint);
            before.extend_from_slice(rho);
        }
        back(adjoint, 1, transition, rows);
        back(rho, c, transition, rows);
        columns(N, r, transition, rows);
        if let Some(left) = left {
            self.motion_bar(transition, left, (r, c), &mut bar.phi);
        }
        back(&mut self.N, r, transition, &mut self.rows);
    }

    /// ∂ℓ/∂φ; r and ρ are φ'r and φ'ρ, N is Nφ.
    fn motion_bar(&mut self, transition: &Transition, left: Seen<'_>, (r, c): (usize, usize), bar: &mut [f64]) {
        let Adjoint { r: adjoint, rho, N, before, smoothed, .. } = self;
        let (adjoint_before, rho_before) = before.split_at(adjoint.len());
        // x̄ + Pφ'r and ΨC - Pφ'ρ of the noisy states; the others are as they were
        smoothed.clear();
        for i in 0..r {
            let P = &left.P[i * r..][..r];
            smoothed.push(left.x[i] + dot(P, adjoint));
            let row = smoothed.len();
            smoothed.extend_from_slice(&left.Psi[i * c..][..c]);
            for (P, rho) in P.iter().zip(rho.chunks_exact(c.max(1))) {
                smoothed[row..].iter_mut().zip(rho).for_each(|(B, rho)| *B -= P * rho);
            }
        }
        for row in &transition.pattern.moved {
            let i = row.state as usize;
            let rho_before = &rho_before[i * c..][..c];
            for k in row.start as usize..row.end as usize {
                let j = transition.pattern.columns[k] as usize;
                let (x, B) = match smoothed.get(j * (1 + c)..(j + 1) * (1 + c)) {
                    Some(smoothed) => (smoothed[0], &smoothed[1..]),
                    None => (left.x[j], &left.Psi[j * c..][..c]),
                };
                bar[k] = adjoint_before[i] * x - dot(rho_before, B);
                if i < r && j < r {
                    // P is symmetric
                    bar[k] -= dot(&N[i * r..][..r], &left.P[j * r..][..r]);
                }
            }
        }
    }
}

/// X ← φ'X over the first rows of φ that X has. Shape: `x` rows × width; rows of φ beyond X are left out.
fn back(x: &mut [f64], width: usize, transition: &Transition, work: &mut Vec<f64>) {
    let rows = x.len().checked_div(width).unwrap_or(0);
    let moved = transition.pattern.moved.partition_point(|row| (row.state as usize) < rows);
    let moved = &transition.pattern.moved[..moved];
    work.clear();
    for row in moved {
        let own = &mut x[row.state as usize * width..][..width];
        work.extend_from_slice(own);
        own.fill(0.0);
    }
    for (row, own) in moved.iter().zip(work.chunks_exact(width.max(1))) {
        for k in row.start as usize..row.end as usize {
            let column = transition.pattern.columns[k] as usize;
            if column < rows {
                let phi = transition.phi[k];
                x[column * width..][..width].iter_mut().zip(own).for_each(|(x, own)| *x += phi * own);
            }
        }
    }
}

/// N ← Nφ on the r noisy states.
pub(super) fn columns(N: &mut [f64], r: usize, transition: &Transition, work: &mut Vec<f64>) {
    let moved = transition.pattern.moved.partition_point(|row| (row.state as usize) < r);
    let moved = &transition.pattern.moved[..moved];
    for line in N.chunks_exact_mut(r.max(1)) {
        work.clear();
        for row in moved {
            work.push(std::mem::take(&mut line[row.state as usize]));
        }
        for (row, &own) in moved.iter().zip(work.iter()) {
            for k in row.start as usize..row.reach as usize {
                line[transition.pattern.columns[k] as usize] += transition.phi[k] * own;
            }
        }
    }
}
