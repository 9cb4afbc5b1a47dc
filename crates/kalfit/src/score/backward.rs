//! The backward pass: adjoints of everything a test's likelihood depends on, from its last step to its first (theory §6).
//!
//! ξ is not known but has the posterior mean x̂ and covariance V = CC'. The forward filter runs from x_0 = a + Ax̂, so that
//! its innovations are ē = e - Tx̂ and its states x̄ = x̂_k + Ψx̂; the columns of C ride along as sensitivities. Then
//!
//! ```text
//! u = ē/S - K'r        υ = TC/S - K'ρ        D = 1/S + K'NK
//! ∂ℓ/∂R = ½(u² + υυ' - D)        ∂ℓ/∂d = u
//! ∂ℓ/∂h = u (x̄⁻ + P⁻r) - (Ψ⁻C - P⁻ρ)υ' - P⁻(h/S - (I-Kh')'NK)
//! r ← r + hu        ρ ← ρ + hυ        N ← hh'/S + (I-Kh')'N(I-Kh')
//! ∂ℓ/∂Q = ½(rr' + ρρ' - N)        ∂ℓ/∂b = r
//! ∂ℓ/∂φ = r (x̄ + Pφ'r)' - ρ(ΨC - Pφ'ρ)' - NφP
//! r ← φ'r        ρ ← φ'ρ        N ← φ'Nφ
//! ```
//!
//! with r, ρ, N of later steps on the right, one scalar measurement after the other.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, N, K, T, S, D")]

mod smooth;

use crate::reduce::{Design, Gains, Transition};
use crate::score::moments::Moments;
pub(crate) use smooth::{Driven, Smoothed};

/// What the chain rule asks of a backward pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Wanted {
    /// ∂ℓ/∂φ.
    pub(crate) motion: bool,
    /// ∂ℓ/∂h.
    pub(crate) equation: bool,
    /// Moments of states and noises.
    pub(crate) smooth: bool,
}

/// Adjoints of the scalar measurements of one step, as they stand in the design (whitened).
#[derive(Debug, Clone, Default)]
pub(crate) struct MeasuredBar {
    /// ∂ℓ/∂R.
    pub(crate) noise: Vec<f64>,
    /// ∂ℓ/∂(z - d).
    pub(crate) value: Vec<f64>,
    /// ∂ℓ/∂h over all states, n numbers a measurement; empty when not wanted.
    pub(crate) h: Vec<f64>,
}

/// Adjoints of one transition.
#[derive(Debug, Clone, Default)]
pub(crate) struct MovedBar {
    /// ∂ℓ/∂φ, entry by entry of [`Transition::phi`]; zero when not wanted.
    pub(crate) phi: Vec<f64>,
    /// ∂ℓ/∂Q, entry by entry of [`Transition::q`]: an entry off the diagonal stands for both places.
    pub(crate) q: Vec<f64>,
    /// ∂ℓ/∂b of the driven states.
    pub(crate) input: Vec<f64>,
}

/// Takes adjoints from the last step to the first.
pub(crate) trait Sink {
    /// Why it cannot go on.
    type Error;
    /// Of the measurements of step `k`.
    fn measured(&mut self, k: usize, bar: &MeasuredBar) -> Result<(), Self::Error>;
    /// Of the transition to step `k`.
    fn moved(&mut self, k: usize, bar: &MovedBar) -> Result<(), Self::Error>;
    /// Of a (n) and P0 (r × r, each place by itself).
    fn started(&mut self, mean: &[f64], variance: &[f64]) -> Result<(), Self::Error>;
    /// Moments of x_0 (`k` = 0) or of the state after step `k` - 1, when they are wanted.
    fn smoothed(&mut self, _k: usize, _moments: &Smoothed) {}
    /// Moments of the noise of the transition to step `k`, when they are wanted.
    fn driven(&mut self, _k: usize, _moments: &Driven) {}
}

/// What is remembered of the forward pass, and work space.
#[derive(Debug, Clone, Default)]
pub(crate) struct BackwardWork {
    /// ē of each scalar measurement.
    e: Vec<f64>,
    /// TC of each.
    T: Vec<f64>,
    /// x̄, P, ΨC before each scalar measurement (when h is wanted), and before each transition (when φ is).
    before: Vec<Filtered>,
    left: Vec<Filtered>,
    /// The same at the start and after each step, when moments are wanted.
    ends: Vec<Filtered>,
    now: Filtered,
    rows: Vec<f64>,
    r: Vec<f64>,
    rho: Vec<f64>,
    N: Vec<f64>,
    NK: Vec<f64>,
    other: Vec<f64>,
    measured: MeasuredBar,
    moved: MovedBar,
    smoothed: Smoothed,
    driven: Driven,
}

/// State of the forward filter at ξ = x̂: x̄ (n), P (r × r, both triangles), ΨC (n × c).
#[derive(Debug, Clone, Default)]
struct Filtered {
    x: Vec<f64>,
    P: Vec<f64>,
    Psi: Vec<f64>,
}

/// One test as the pass sees it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Run<'a> {
    pub(crate) design: &'a Design,
    pub(crate) gains: &'a Gains,
    pub(crate) start: &'a [f64],
    pub(crate) inputs: &'a [f64],
    pub(crate) values: &'a [f64],
    pub(crate) moments: &'a Moments,
    pub(crate) wanted: Wanted,
}

impl Run<'_> {
    /// The adjoints of the test, into the sink.
    pub(crate) fn backward<S: Sink>(&self, work: &mut BackwardWork, sink: &mut S) -> Result<(), S::Error> {
        self.forward(work);
        let frame = &self.design.frame;
        let (n, r, c) = (frame.n, frame.r, self.moments.columns);
        work.r.clear();
        work.r.resize(n, 0.0);
        work.rho.clear();
        work.rho.resize(n * c, 0.0);
        work.N.clear();
        work.N.resize(r * r, 0.0);
        let mut transitions = self.design.steps.iter().filter(|step| step.transition.is_some()).count();
        for k in (0..self.design.steps.len()).rev() {
            let step = &self.design.steps[k];
            let first = if k == 0 { 0 } else { self.design.steps[k - 1].rows };
            if self.wanted.smooth {
                work.ends[k + 1].smooth(&work.r, &work.rho, (&work.N, r, c), &mut work.smoothed);
                sink.smoothed(k + 1, &work.smoothed);
            }
            if step.rows > first {
                self.measured(first, step.rows, work);
                sink.measured(k, &work.measured)?;
            }
            if let Some(transition) = &step.transition {
                transitions -= 1;
                self.moved(transition, transitions, work);
                sink.moved(k, &work.moved)?;
                if self.wanted.smooth {
                    sink.driven(k, &work.driven);
                }
            }
        }
        if self.wanted.smooth {
            work.ends[0].smooth(&work.r, &work.rho, (&work.N, r, c), &mut work.smoothed);
            sink.smoothed(0, &work.smoothed);
        }
        work.other.clear();
        work.other.extend((0..r * r).map(|ij| {
            let (i, j) = (ij / r, ij % r);
            0.5 * second(&work.r, &work.rho, c, i, j) - 0.5 * work.N[ij]
        }));
        sink.started(&work.r, &work.other)
    }

    /// The filter at ξ = x̂ under the gains of the design.
    fn forward(&self, work: &mut BackwardWork) {
        let frame = &self.design.frame;
        let (n, p, c) = (frame.n, frame.p, self.moments.columns);
        let BackwardWork { e, T, before, left, ends, now, rows, .. } = work;
        ends.clear();
        e.clear();
        T.clear();
        before.clear();
        left.clear();
        now.x.clear();
        now.x.extend_from_slice(self.start);
        now.Psi.clear();
        now.Psi.resize(n * c, 0.0);
        for i in 0..n {
            for k in 0..p {
                let a = frame.sensitivity[i * p + k];
                if a != 0.0 {
                    now.x[i] += a * self.moments.mean[k];
                    (0..c).for_each(|j| now.Psi[i * c + j] += a * self.moments.root[k * c + j]);
                }
            }
        }
        now.P.clear();
        if self.wanted.motion || self.wanted.equation || self.wanted.smooth {
            now.P.extend(full(&self.design.variance, frame.r));
        }
        if self.wanted.smooth {
            ends.push(now.clone());
        }
        let (mut first, mut input) = (0, 0);
        for step in &self.design.steps {
            if let Some(transition) = &step.transition {
                if self.wanted.motion || self.wanted.smooth {
                    left.push(now.clone());
                }
                let driven = &self.inputs[input..input + frame.driven.len()];
                now.advance(transition, (&frame.driven, driven), (frame.r, c), rows);
                input += frame.driven.len();
            }
            for row in first..step.rows {
                if self.wanted.equation {
                    before.push(now.clone());
                }
                self.innovate(row, now, (e, T));
            }
            first = step.rows;
            if self.wanted.smooth {
                ends.push(now.clone());
            }
        }
    }

    fn innovate(&self, row: usize, now: &mut Filtered, (e, T): (&mut Vec<f64>, &mut Vec<f64>)) {
        let (r, c) = (self.design.frame.r, self.moments.columns);
        let (states, h) = self.design.terms(row);
        let (_, K, _) = self.gains.row(r, self.design.frame.p, row);
        let mut innovation = self.values[row];
        let at = T.len();
        T.resize(at + c, 0.0);
        for (&state, &h) in states.iter().zip(h) {
            innovation -= h * now.x[state as usize];
            for (T, Psi) in T[at..].iter_mut().zip(&now.Psi[state as usize * c..]) {
                *T += h * Psi;
            }
        }
        for i in 0..r {
            now.x[i] += K[i] * innovation;
            for (Psi, T) in now.Psi[i * c..][..c].iter_mut().zip(&T[at..]) {
                *Psi -= K[i] * T;
            }
        }
        if !now.P.is_empty() {
            now.joseph(r, (states, h), K, self.design.noise[row]);
        }
        e.push(innovation);
    }

    /// The measurements first..end of one step, the last first.
    fn measured(&self, first: usize, end: usize, work: &mut BackwardWork) {
        let (n, c) = (self.design.frame.n, self.moments.columns);
        let m = end - first;
        let bar = &mut work.measured;
        for (list, size) in
            [(&mut bar.noise, m), (&mut bar.value, m), (&mut bar.h, if self.wanted.equation { m * n } else { 0 })]
        {
            list.clear();
            list.resize(size, 0.0);
        }
        for row in (first..end).rev() {
            self.one(row, row - first, c, work);
        }
    }

    fn one(&self, row: usize, place: usize, c: usize, work: &mut BackwardWork) {
        let (n, r) = (self.design.frame.n, self.design.frame.r);
        let (states, h) = self.design.terms(row);
        let (weight, K, _) = self.gains.row(r, self.design.frame.p, row);
        if weight == 0.0 {
            return; // it can only be what it is: K and T are zero
        }
        let BackwardWork { e, T, before, r: adjoint, rho, N, NK, other, measured, .. } = work;
        let T = &T[row * c..][..c];
        let u = e[row] * weight - dot(K, adjoint);
        other.clear(); // υ
        other.extend((0..c).map(|j| T[j] * weight - (0..r).map(|i| K[i] * rho[i * c + j]).sum::<f64>()));
        NK.clear();
        NK.extend((0..r).map(|i| dot(&N[i * r..][..r], K)));
        let KNK = dot(NK, K);
        measured.noise[place] = 0.5 * (u * u + dot(other, other) - weight - KNK);
        measured.value[place] = -u;
        for (&state, &h) in states.iter().zip(h) {
            adjoint[state as usize] += h * u;
            for (rho, upsilon) in rho[state as usize * c..][..c].iter_mut().zip(other.iter()) {
                *rho += h * upsilon;
            }
        }
        if self.wanted.equation {
            let bar = &mut measured.h[place * n..][..n];
            before[row].equation_bar((u, other), (adjoint, rho), (states, h), (weight, KNK, NK), bar);
        }
        // N ← hh'/S + (I-Kh')'N(I-Kh') = N - h(NK)' - (NK)h' + (1/S + K'NK) hh'
        let reach = states.partition_point(|&state| (state as usize) < r);
        let D = weight + KNK;
        for (&a, &ha) in states[..reach].iter().zip(h) {
            let a = a as usize;
            for i in 0..r {
                N[a * r + i] -= ha * NK[i];
                N[i * r + a] -= ha * NK[i];
            }
            for (&b, &hb) in states[..reach].iter().zip(h) {
                N[a * r + b as usize] += D * ha * hb;
            }
        }
    }

    /// One transition; `number` counts transitions from the first.
    fn moved(&self, transition: &Transition, number: usize, work: &mut BackwardWork) {
        let frame = &self.design.frame;
        let (r, c) = (frame.r, self.moments.columns);
        let BackwardWork { left, r: adjoint, rho, N, NK, other, moved, driven, .. } = work;
        let pattern = &transition.pattern;
        moved.input.clear();
        moved.input.extend(frame.driven.iter().map(|&state| adjoint[state as usize]));
        moved.q.clear();
        moved.q.extend(pattern.pairs.iter().map(|&(i, j)| {
            let (i, j) = (i as usize, j as usize);
            let one = 0.5 * (second(adjoint, rho, c, i, j) - N[i * r + j]);
            if i == j { one } else { 2.0 * one }
        }));
        moved.phi.clear();
        moved.phi.resize(transition.phi.len(), 0.0);
        if self.wanted.smooth {
            driven.at(transition, (adjoint, rho, N), (r, c));
        }
        if self.wanted.motion || self.wanted.smooth {
            // the first factors of the products in ∂ℓ/∂φ, before r and ρ move on
            NK.clear();
            NK.extend_from_slice(adjoint);
            NK.extend_from_slice(rho);
        }
        back(adjoint, 1, transition, other);
        back(rho, c, transition, other);
        columns(N, r, transition, other); // Nφ
        if self.wanted.motion {
            let (adjoint_before, rho_before) = NK.split_at(frame.n);
            left[number].motion_bar(
                (adjoint, rho),
                (adjoint_before, rho_before),
                (N, r, c),
                transition,
                &mut moved.phi,
            );
        }
        if self.wanted.smooth {
            let rho_before = &NK[frame.n..];
            driven.across(transition, &left[number], (rho, rho_before), (N, r, c));
        }
        back(N, r, transition, other);
    }
}

impl Filtered {
    fn advance(
        &mut self,
        transition: &Transition,
        (driven, inputs): (&[u32], &[f64]),
        (r, c): (usize, usize),
        rows: &mut Vec<f64>,
    ) {
        crate::reduce::advance(&mut self.x, 1, transition, rows);
        for (&state, input) in driven.iter().zip(inputs) {
            self.x[state as usize] += input;
        }
        crate::reduce::advance(&mut self.Psi, c, transition, rows);
        if !self.P.is_empty() {
            forth(&mut self.P, r, transition, rows);
            for (&(i, j), &q) in transition.pattern.pairs.iter().zip(&transition.q) {
                let (i, j) = (i as usize, j as usize);
                self.P[i * r + j] += q;
                if i != j {
                    self.P[j * r + i] += q;
                }
            }
        }
    }

    /// P ← (I-Kh')P(I-Kh')' + KRK'.
    fn joseph(&mut self, r: usize, (states, h): (&[u32], &[f64]), K: &[f64], noise: f64) {
        let reach = states.partition_point(|&state| (state as usize) < r);
        let G: Vec<f64> = (0..r)
            .map(|i| states[..reach].iter().zip(h).map(|(&s, &h)| h * self.P[i * r + s as usize]).sum())
            .collect();
        let S = noise + states[..reach].iter().zip(h).map(|(&s, &h)| h * G[s as usize]).sum::<f64>();
        for i in 0..r {
            for j in 0..r {
                self.P[i * r + j] += S * K[i] * K[j] - K[i] * G[j] - G[i] * K[j];
            }
        }
    }

    /// ∂ℓ/∂h before a measurement; `adjoint`, `rho` are those after its line.
    fn equation_bar(
        &self,
        (u, upsilon): (f64, &[f64]),
        (adjoint, rho): (&[f64], &[f64]),
        (states, h): (&[u32], &[f64]),
        (weight, KNK, NK): (f64, f64, &[f64]),
        bar: &mut [f64],
    ) {
        let (r, c) = (NK.len(), upsilon.len());
        // h/S - (I-Kh')'NK = h (1/S + K'NK) - NK on the noisy states
        let mut rest: Vec<f64> = NK.iter().map(|x| -x).collect();
        for (&state, &h) in states.iter().zip(h).filter(|(state, _)| (**state as usize) < r) {
            rest[state as usize] += h * (weight + KNK);
        }
        for (i, bar) in bar.iter_mut().enumerate() {
            *bar = u * self.x[i] - dot(upsilon, &self.Psi[i * c..][..c]);
        }
        for i in 0..r {
            for j in 0..r {
                let P = self.P[i * r + j];
                bar[i] += P * (u * adjoint[j] + dot(upsilon, &rho[j * c..][..c]) - rest[j]);
            }
        }
    }

    /// ∂ℓ/∂φ of the transition that follows; `adjoint`, `rho` are φ'r and φ'ρ, `before` r and ρ, `N` is Nφ.
    fn motion_bar(
        &self,
        (adjoint, rho): (&[f64], &[f64]),
        (before, rho_before): (&[f64], &[f64]),
        (N, r, c): (&[f64], usize, usize),
        transition: &Transition,
        bar: &mut [f64],
    ) {
        let n = self.x.len();
        let (mut x, mut B) = (self.x.clone(), self.Psi.clone()); // smoothed
        for i in 0..r {
            for j in 0..r {
                let P = self.P[i * r + j];
                x[i] += P * adjoint[j];
                (0..c).for_each(|k| B[i * c + k] -= P * rho[j * c + k]);
            }
        }
        debug_assert_eq!(n * c, B.len(), "ΨC is n × c");
        for row in &transition.pattern.moved {
            let i = row.state as usize;
            for k in row.start as usize..row.end as usize {
                let j = transition.pattern.columns[k] as usize;
                let mut sum = before[i] * x[j] - dot(&rho_before[i * c..][..c], &B[j * c..][..c]);
                if i < r && j < r {
                    sum -= (0..r).map(|m| N[i * r + m] * self.P[m * r + j]).sum::<f64>();
                }
                bar[k] = sum;
            }
        }
    }
}

/// r_i r_j + (ρρ')_ij.
fn second(adjoint: &[f64], rho: &[f64], c: usize, i: usize, j: usize) -> f64 {
    adjoint[i] * adjoint[j] + dot(&rho[i * c..][..c], &rho[j * c..][..c])
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Both triangles from the lower one.
fn full(lower: &[f64], r: usize) -> impl Iterator<Item = f64> {
    (0..r * r).map(move |ij| lower[(ij / r).max(ij % r) * r + (ij / r).min(ij % r)])
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
fn columns(N: &mut [f64], r: usize, transition: &Transition, work: &mut Vec<f64>) {
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

/// P ← φPφ' on the r noisy states, both triangles.
fn forth(P: &mut [f64], r: usize, transition: &Transition, work: &mut Vec<f64>) {
    let moved = transition.pattern.moved.partition_point(|row| (row.state as usize) < r);
    let moved = &transition.pattern.moved[..moved];
    for side in 0..2 {
        work.clear();
        for row in moved {
            for j in 0..r {
                let terms = row.start as usize..row.reach as usize;
                let at = |column: usize| if side == 0 { P[column * r + j] } else { P[j * r + column] };
                work.push(terms.map(|k| transition.phi[k] * at(transition.pattern.columns[k] as usize)).sum());
            }
        }
        for (row, new) in moved.iter().zip(work.chunks_exact(r.max(1))) {
            let i = row.state as usize;
            for (j, &value) in new.iter().enumerate() {
                P[if side == 0 { i * r + j } else { j * r + i }] = value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::estimate::InitialLaw;
    use crate::reduce::{
        DENSE, Data, DataWork, Frame, GainsWork, Path, Pattern, Reduction, Step, information_gains, outcome,
    };
    use crate::score::moments::moments;

    /// A test by hand: four states, the first two noisy, three unknowns; every number of it is its own.
    #[derive(Debug, Clone)]
    struct Numbers {
        phi: Vec<Vec<f64>>,
        q: Vec<Vec<f64>>,
        h: Vec<f64>,
        noise: Vec<f64>,
        values: Vec<f64>,
        inputs: Vec<f64>,
        start: Vec<f64>,
        variance: Vec<f64>,
    }

    const STEPS: usize = 5;

    fn design(numbers: &Numbers) -> (Design, Data) {
        let mut pattern = Pattern::default();
        pattern.push(0, 2, [0, 1, 3].into_iter());
        pattern.push(1, 2, [0, 1].into_iter());
        pattern.push(2, 2, [2, 3].into_iter());
        pattern.pairs = vec![(0, 0), (1, 0), (1, 1)];
        let pattern = Arc::new(pattern.seal());
        let mut sensitivity = vec![0.0; 12];
        sensitivity[0] = 1.0;
        sensitivity[2 * 3 + 1] = 1.0;
        sensitivity[3 * 3 + 2] = 1.0;
        let frame = Frame { n: 4, p: 3, r: 2, rows: vec![DENSE; 4], sensitivity, driven: vec![0, 2], digest: 0 };
        let mut design = Design::new(Arc::new(frame.seal()));
        design.variance.copy_from_slice(&numbers.variance);
        for k in 0..STEPS {
            let (phi, q) = (numbers.phi[k].clone(), numbers.q[k].clone());
            let transition = (k > 0).then(|| Arc::new(Transition::new(pattern.clone(), phi, q)));
            for row in 2 * k..2 * k + 2 {
                design.states.extend(if row % 2 == 0 { vec![0, 1, 2] } else { vec![0, 3] });
                design.rows.push(design.states.len());
            }
            design.steps.push(Step { transition, rows: 2 * k + 2 });
        }
        design.h.clone_from(&numbers.h);
        design.noise.clone_from(&numbers.noise);
        let sizes = vec![1.0; numbers.values.len()];
        (
            design,
            Data {
                start: numbers.start.clone(),
                inputs: numbers.inputs[2..].to_vec(),
                values: numbers.values.clone(),
                sizes,
            },
        )
    }

    fn reduced(numbers: &Numbers) -> (Design, Data, Gains, Reduction) {
        let (design, data) = design(numbers);
        let gains = information_gains(&design, &mut GainsWork::default()).expect("well conditioned");
        let found = outcome(&design, &gains, &data, &mut DataWork::default()).expect("possible");
        let reduction = Reduction {
            test: String::new(),
            constant: found.constant,
            data: found.data,
            factor: gains.factor.clone(),
            covariates: Vec::new(),
            steps: STEPS,
            observations: 10,
            path: Path::Information,
            design: 0,
        };
        (design, data, gains, reduction)
    }

    fn prior() -> (DVector<f64>, DMatrix<f64>) {
        let root = DMatrix::from_row_slice(3, 2, &[0.8, 0.1, -0.3, 0.9, 0.4, 0.2]);
        (DVector::from_vec(vec![0.3, -0.2, 0.5]), root)
    }

    /// ℓ = log ∫ p(z | ξ) N(ξ; μ, FF') dξ, densely.
    fn likelihood(numbers: &Numbers) -> f64 {
        let (_, _, _, reduction) = reduced(numbers);
        let (mean, root) = prior();
        let factor = crate::estimate::unpack(&reduction.factor, 3);
        let residual = DVector::from_vec(reduction.data) - &factor * mean;
        let rf = factor * root;
        let spread = DMatrix::identity(3, 3) + &rf * rf.transpose();
        let cholesky = spread.cholesky().expect("positive definite");
        reduction.constant - 0.5 * cholesky.determinant().ln() - 0.5 * residual.dot(&cholesky.solve(&residual))
    }

    #[derive(Default)]
    struct Kept {
        noise: Vec<(usize, f64)>,
        value: Vec<(usize, f64)>,
        h: Vec<(usize, Vec<f64>)>,
        moved: Vec<(usize, MovedBar)>,
        mean: Vec<f64>,
        variance: Vec<f64>,
    }

    impl Sink for Kept {
        type Error = std::convert::Infallible;
        fn measured(&mut self, k: usize, bar: &MeasuredBar) -> Result<(), Self::Error> {
            for i in 0..2 {
                self.noise.push((2 * k + i, bar.noise[i]));
                self.value.push((2 * k + i, bar.value[i]));
                self.h.push((2 * k + i, bar.h[i * 4..][..4].to_vec()));
            }
            Ok(())
        }
        fn moved(&mut self, k: usize, bar: &MovedBar) -> Result<(), Self::Error> {
            self.moved.push((k, bar.clone()));
            Ok(())
        }
        fn started(&mut self, mean: &[f64], variance: &[f64]) -> Result<(), Self::Error> {
            (self.mean, self.variance) = (mean.to_vec(), variance.to_vec());
            Ok(())
        }
    }

    fn numbers() -> Numbers {
        let mut seed = 7u64;
        let mut next = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f64 / f64::from(1 << 24) - 0.5
        };
        let mut list = |n: usize| (0..n).map(|_| next()).collect::<Vec<f64>>();
        Numbers {
            phi: (0..STEPS).map(|_| list(7)).collect(),
            q: (0..STEPS).map(|_| list(3).iter().zip([1.0, 0.1, 1.0]).map(|(x, m)| m * (x + 0.8)).collect()).collect(),
            h: list(5 * STEPS),
            noise: list(2 * STEPS).iter().map(|x| x + 0.7).collect(),
            values: list(2 * STEPS),
            inputs: list(2 * STEPS),
            start: list(4),
            variance: vec![0.5, 0.0, 0.1, 0.4],
        }
    }

    #[test]
    fn adjoints_equal_differences_of_the_likelihood() {
        let all = numbers();
        let (design, data, gains, reduction) = reduced(&all);
        let (mean, root) = prior();
        let moments = moments(&reduction, &InitialLaw::known(mean, root));
        let wanted = Wanted { motion: true, equation: true, smooth: false };
        let run = Run {
            design: &design,
            gains: &gains,
            start: &data.start,
            inputs: &data.inputs,
            values: &data.values,
            moments: &moments,
            wanted,
        };
        let mut kept = Kept::default();
        let Ok(()) = run.backward(&mut BackwardWork::default(), &mut kept);
        let check = |what: &str, found: f64, change: &dyn Fn(&mut Numbers, f64)| {
            let at = |x: f64| {
                let mut moved = all.clone();
                change(&mut moved, x);
                likelihood(&moved)
            };
            let h = 1e-4;
            let expected = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
            assert!((found - expected).abs() <= 2e-9 * (1.0 + expected.abs()), "{what}: {found} against {expected}");
        };
        for &(row, bar) in &kept.noise {
            check(&format!("R of {row}"), bar, &|n, x| n.noise[row] += x);
        }
        for &(row, bar) in &kept.value {
            check(&format!("z of {row}"), bar, &|n, x| n.values[row] += x);
        }
        for (row, bar) in &kept.h {
            let (states, _) = design.terms(*row);
            let first = design.rows[*row] - states.len();
            for (i, &state) in states.iter().enumerate() {
                check(&format!("h of {row} on {state}"), bar[state as usize], &|n, x| n.h[first + i] += x);
            }
        }
        for (k, bar) in &kept.moved {
            for (i, &phi) in bar.phi.iter().enumerate() {
                check(&format!("φ {i} of step {k}"), phi, &|n, x| n.phi[*k][i] += x);
            }
            for (i, &q) in bar.q.iter().enumerate() {
                check(&format!("Q {i} of step {k}"), q, &|n, x| n.q[*k][i] += x);
            }
            for (i, &b) in bar.input.iter().enumerate() {
                check(&format!("b {i} of step {k}"), b, &|n, x| n.inputs[2 * k + i] += x);
            }
        }
        for (i, &a) in kept.mean.iter().enumerate() {
            check(&format!("a {i}"), a, &|n, x| n.start[i] += x);
        }
        for (i, j) in [(0, 0), (1, 0), (1, 1)] {
            let both = if i == j { kept.variance[i * 2 + j] } else { 2.0 * kept.variance[i * 2 + j] };
            check(&format!("P0 {i} {j}"), both, &|n, x| n.variance[i * 2 + j] += x);
        }
    }
}
