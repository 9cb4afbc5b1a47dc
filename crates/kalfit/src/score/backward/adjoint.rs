//! The way back through one step: r, ρ, N and what they say of the coefficients of the step.
#![expect(non_snake_case, reason = "the letters of the theory: P, B, N, K, D")]

use kalfit_lanes::Real;

use crate::reduce::Transition;
use crate::score::backward::filtered::{FilterSnapshot, second};
use crate::score::backward::scalar_measurement::{PosteriorRoot, ScalarMeasurement, dot};
use crate::score::backward::sink::TransitionAdjoint;

/// Adjoints of the state: r (n), ρ (n × c), N (r × r).
#[derive(Debug, Clone)]
pub(super) struct Adjoint<T = f64> {
    pub(super) r: Vec<T>,
    pub(super) rho: Vec<T>,
    pub(super) N: Vec<T>,
    NK: Vec<T>,
    upsilon: Vec<T>,
    /// r and ρ before they move on.
    before: Vec<T>,
    smoothed: Vec<T>,
    rows: Vec<T>,
}

impl<T> Default for Adjoint<T> {
    fn default() -> Adjoint<T> {
        Adjoint {
            r: Vec::new(),
            rho: Vec::new(),
            N: Vec::new(),
            NK: Vec::new(),
            upsilon: Vec::new(),
            before: Vec::new(),
            smoothed: Vec::new(),
            rows: Vec::new(),
        }
    }
}

/// Adjoints of one scalar measurement.
pub(super) struct ScalarAdjoint<'a, T = f64> {
    /// ∂ℓ/∂R.
    pub(super) noise: &'a mut T,
    /// ∂ℓ/∂(z - d).
    pub(super) value: &'a mut T,
    /// ∂ℓ/∂h over all states, and the filter before the measurement, where it is wanted.
    pub(super) h: Option<(&'a mut [T], FilterSnapshot<'a, T>)>,
}

/// One scalar measurement on its way back.
struct Scalar<'a, T> {
    u: T,
    states: &'a [u32],
    h: &'a [T],
    /// 1/S + K'NK.
    D: T,
}

impl<T: Real> Adjoint<T> {
    /// As after the last step: zero, or (r, ρ, N) that later phases say of the state there.
    #[inline(always)]
    pub(super) fn begin(&mut self, unknown: &PosteriorRoot<'_, T>, ending: Option<[&[T]; 3]>) {
        let (n, r, c) = (unknown.frame.n, unknown.frame.r, unknown.columns);
        for (list, size) in [(&mut self.r, n), (&mut self.rho, n * c), (&mut self.N, r * r)] {
            list.clear();
            list.resize(size, T::splat(0.0));
        }
        if let Some([r, rho, N]) = ending {
            self.r.copy_from_slice(r);
            self.rho.copy_from_slice(rho);
            self.N.copy_from_slice(N);
        }
    }

    /// ∂ℓ/∂P0, each place by itself.
    #[inline(always)]
    pub(super) fn variance(&self, unknown: &PosteriorRoot<'_, T>, out: &mut Vec<T>) {
        let (r, c, half) = (unknown.frame.r, unknown.columns, T::splat(0.5));
        out.clear();
        for ij in 0..r * r {
            out.push(half * second(&self.r, &self.rho, c, ij / r, ij % r) - half * self.N[ij]);
        }
    }

    /// A scalar measurement.
    #[inline(always)]
    pub(super) fn measured(
        &mut self,
        line: &ScalarMeasurement<'_, T>,
        e: T,
        unknown: &PosteriorRoot<'_, T>,
        bar: ScalarAdjoint<'_, T>,
    ) {
        let KNK = self.innovation(line, unknown);
        let u = e * line.weight - dot(line.K, &self.r);
        let scalar = Scalar { u, states: line.states, h: line.h, D: line.weight + KNK };
        *bar.noise = T::splat(0.5) * (u.fma(u, dot(&self.upsilon, &self.upsilon)) - scalar.D);
        *bar.value = -u;
        self.row_back(&scalar);
        if let Some((bar, before)) = bar.h {
            self.equation_bar(&scalar, before, bar);
        }
        self.information_back(&scalar);
    }

    /// υ and NK of a measurement; returns K'NK.
    #[inline(always)]
    fn innovation(&mut self, line: &ScalarMeasurement<'_, T>, unknown: &PosteriorRoot<'_, T>) -> T {
        let (r, c) = (unknown.frame.r, unknown.columns);
        let Adjoint { rho, N, NK, upsilon, .. } = self;
        unknown.times_root(line.T, upsilon);
        for upsilon in upsilon.iter_mut() {
            *upsilon = *upsilon * line.weight;
        }
        for (i, &K) in line.K.iter().enumerate() {
            for k in 0..c {
                upsilon[k] = K.fnma(rho[i * c + k], upsilon[k]);
            }
        }
        NK.clear();
        for i in 0..r {
            NK.push(dot(&N[i * r..][..r], line.K));
        }
        dot(NK, line.K)
    }

    /// r ← r + hu, ρ ← ρ + hυ.
    #[inline(always)]
    fn row_back(&mut self, scalar: &Scalar<'_, T>) {
        let c = self.upsilon.len();
        for (&state, &h) in scalar.states.iter().zip(scalar.h) {
            let state = state as usize;
            self.r[state] = h.fma(scalar.u, self.r[state]);
            for k in 0..c {
                self.rho[state * c + k] = h.fma(self.upsilon[k], self.rho[state * c + k]);
            }
        }
    }

    /// N ← hh'/S + (I-Kh')'N(I-Kh') = N - h(NK)' - (NK)h' + (1/S + K'NK) hh'.
    #[inline(always)]
    fn information_back(&mut self, scalar: &Scalar<'_, T>) {
        let Adjoint { N, NK, .. } = self;
        let r = NK.len();
        let reach = scalar.states.partition_point(|&state| (state as usize) < r);
        for (&a, &ha) in scalar.states[..reach].iter().zip(scalar.h) {
            let a = a as usize;
            for i in 0..r {
                N[a * r + i] = ha.fnma(NK[i], N[a * r + i]);
                N[i * r + a] = ha.fnma(NK[i], N[i * r + a]);
            }
            for (&b, &hb) in scalar.states[..reach].iter().zip(scalar.h) {
                let at = a * r + b as usize;
                N[at] = (scalar.D * ha).fma(hb, N[at]);
            }
        }
    }

    /// ∂ℓ/∂h; r and ρ are those after the line.
    #[inline(always)]
    fn equation_bar(&mut self, scalar: &Scalar<'_, T>, before: FilterSnapshot<'_, T>, bar: &mut [T]) {
        let Adjoint { r: adjoint, rho, NK, upsilon, smoothed, .. } = self;
        let (r, c) = (NK.len(), upsilon.len());
        for (i, bar) in bar.iter_mut().enumerate() {
            *bar = scalar.u * before.x[i] - dot(upsilon, &before.Psi[i * c..][..c]);
        }
        // ur + ρυ' - (h/S - (I-Kh')'NK), where that is h (1/S + K'NK) - NK
        smoothed.clear();
        for j in 0..r {
            smoothed.push(scalar.u.fma(adjoint[j], dot(upsilon, &rho[j * c..][..c])) + NK[j]);
        }
        let reach = scalar.states.partition_point(|&state| (state as usize) < r);
        for (&state, &h) in scalar.states[..reach].iter().zip(scalar.h) {
            smoothed[state as usize] = h.fnma(scalar.D, smoothed[state as usize]);
        }
        for i in 0..r {
            bar[i] = bar[i] + dot(&before.P[i * r..][..r], smoothed);
        }
    }

    /// One transition. `left`: the filter before it, where adjoints of φ are wanted.
    #[inline(always)]
    pub(super) fn moved(
        &mut self,
        unknown: &PosteriorRoot<'_, T>,
        transition: &Transition<T>,
        left: Option<FilterSnapshot<'_, T>>,
        bar: &mut TransitionAdjoint<T>,
    ) {
        let (r, c) = (unknown.frame.r, unknown.columns);
        let (Adjoint { r: adjoint, rho, N, before, rows, .. }, pattern) = (&mut *self, &transition.pattern);
        bar.input.clear();
        for &state in &unknown.frame.driven {
            bar.input.push(adjoint[state as usize]);
        }
        bar.q.clear();
        for &(i, j) in &pattern.pairs {
            let (i, j) = (i as usize, j as usize);
            let both = second(adjoint, rho, c, i, j) - N[i * r + j];
            bar.q.push(if i == j { T::splat(0.5) * both } else { both });
        }
        bar.phi.clear();
        bar.phi.resize(transition.phi.len(), T::splat(0.0));
        if left.is_some() {
            before.clear();
            before.extend_from_slice(adjoint);
            before.extend_from_slice(rho);
        }
        let n = adjoint.len();
        back(adjoint, (n, 1), transition, rows);
        back(rho, (n, c), transition, rows);
        columns(N, r, transition, rows);
        if let Some(left) = left {
            self.motion_bar(transition, left, (r, c), &mut bar.phi);
        }
        back(&mut self.N, (r, r), transition, &mut self.rows);
    }

    /// ∂ℓ/∂φ; r and ρ are φ'r and φ'ρ, N is Nφ.
    #[inline(always)]
    fn motion_bar(
        &mut self,
        transition: &Transition<T>,
        left: FilterSnapshot<'_, T>,
        (r, c): (usize, usize),
        bar: &mut [T],
    ) {
        let Adjoint { r: adjoint, rho, N, before, smoothed, .. } = self;
        let (adjoint_before, rho_before) = before.split_at(adjoint.len());
        // x̄ + Pφ'r and ΨC - Pφ'ρ of the noisy states; the others are as they were
        smoothed.clear();
        for i in 0..r {
            let P = &left.P[i * r..][..r];
            smoothed.push(left.x[i] + dot(P, adjoint));
            let row = smoothed.len();
            smoothed.extend_from_slice(&left.Psi[i * c..][..c]);
            for (j, &P) in P.iter().enumerate() {
                for k in 0..c {
                    smoothed[row + k] = P.fnma(rho[j * c + k], smoothed[row + k]);
                }
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
                    bar[k] = bar[k] - dot(&N[i * r..][..r], &left.P[j * r..][..r]);
                }
            }
        }
    }
}

/// X ← φ'X over the first rows of φ that X has. Shape: `x` rows × width; rows of φ beyond X are left out.
#[inline(always)]
fn back<T: Real>(x: &mut [T], (rows, width): (usize, usize), transition: &Transition<T>, work: &mut Vec<T>) {
    if let Some(factors) = transition.factors() {
        for (state, phi) in factors.take_while(|(state, _)| *state < rows) {
            for x in &mut x[state * width..][..width] {
                *x = phi * *x;
            }
        }
        return;
    }
    let moved = transition.pattern.moved.partition_point(|row| (row.state as usize) < rows);
    let moved = &transition.pattern.moved[..moved];
    work.clear();
    for row in moved {
        let own = &mut x[row.state as usize * width..][..width];
        work.extend_from_slice(own);
        own.fill(T::splat(0.0));
    }
    for (m, row) in moved.iter().enumerate() {
        let own = &work[m * width..][..width];
        for k in row.start as usize..row.end as usize {
            let column = transition.pattern.columns[k] as usize;
            if column < rows {
                let phi = transition.phi[k];
                for (x, &own) in x[column * width..][..width].iter_mut().zip(own) {
                    *x = phi.fma(own, *x);
                }
            }
        }
    }
}

/// N ← Nφ on the r noisy states.
#[inline(always)]
pub(super) fn columns<T: Real>(N: &mut [T], r: usize, transition: &Transition<T>, work: &mut Vec<T>) {
    if let Some(factors) = transition.factors() {
        for (state, phi) in factors.take_while(|(state, _)| *state < r) {
            for i in 0..r {
                N[i * r + state] = phi * N[i * r + state];
            }
        }
        return;
    }
    let moved = transition.pattern.moved.partition_point(|row| (row.state as usize) < r);
    let moved = &transition.pattern.moved[..moved];
    for i in 0..r {
        let line = &mut N[i * r..][..r];
        work.clear();
        for row in moved {
            work.push(std::mem::replace(&mut line[row.state as usize], T::splat(0.0)));
        }
        for (row, &own) in moved.iter().zip(work.iter()) {
            for k in row.start as usize..row.reach as usize {
                let column = transition.pattern.columns[k] as usize;
                line[column] = transition.phi[k].fma(own, line[column]);
            }
        }
    }
}
