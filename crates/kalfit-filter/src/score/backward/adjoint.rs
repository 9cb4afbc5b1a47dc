//! The backward pass through one step: r, ρ, N, and the adjoints of the step's coefficients.
#![expect(non_snake_case, reason = "the letters of the theory: P, B, N, K, D")]

use kalfit_lanes::Real;

use crate::reduce::{Entries, Pattern, TransitionView};
use crate::score::backward::filtered::FilterSnapshot;
use crate::score::backward::kernel::{absorb, advance_transposed, dot, outer_entry, smoothing_error, times_phi};
use crate::score::backward::scalar_measurement::{PosteriorRoot, ScalarMeasurement};
use crate::score::backward::sink::TransitionAdjoint;

/// Adjoints of the state: r (n), ρ (n × c), N (r × r).
#[derive(Debug, Clone)]
pub(super) struct Adjoint<T = f64> {
    pub(super) r: Vec<T>,
    pub(super) rho: Vec<T>,
    pub(super) N: Vec<T>,
    NK: Vec<T>,
    upsilon: Vec<T>,
    /// r and ρ of the state after a transition, while the transition is passed backward.
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
    /// ∂ℓ/∂h over all states, and the filter before the measurement, where ∂ℓ/∂h is wanted.
    pub(super) h: Option<(&'a mut [T], FilterSnapshot<'a, T>)>,
}

/// One scalar measurement in the backward pass.
struct Scalar<'a, T, E> {
    u: T,
    states: &'a [u32],
    h: E,
    /// 1/S + K'NK.
    D: T,
}

impl<T: Real> Adjoint<T> {
    /// Sets r, ρ and N after the last step: to zero, or to `ending` = [r, ρ, N] from later phases.
    #[inline(always)]
    pub(super) fn begin(&mut self, posterior: &PosteriorRoot<'_, T>, ending: Option<[&[T]; 3]>) {
        let (n, r, c) = (posterior.frame.n, posterior.frame.r, posterior.columns);
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

    /// Sets `out` to ∂ℓ/∂P0, r × r, with the entries of P0 taken as independent.
    #[inline(always)]
    pub(super) fn start_covariance_adjoint(&self, posterior: &PosteriorRoot<'_, T>, out: &mut Vec<T>) {
        let (r, c, half) = (posterior.frame.r, posterior.columns, T::splat(0.5));
        out.clear();
        for ij in 0..r * r {
            out.push(half * outer_entry(&self.r, &self.rho, c, ij / r, ij % r) - half * self.N[ij]);
        }
    }

    /// The backward pass through a scalar measurement, whose adjoints go to `bar`.
    #[inline(always)]
    pub(super) fn measured<E: Entries<T>>(
        &mut self,
        line: &ScalarMeasurement<'_, T, E>,
        e: T,
        posterior: &PosteriorRoot<'_, T>,
        bar: ScalarAdjoint<'_, T>,
    ) {
        let KNK = self.gain_terms(line, posterior);
        let u = smoothing_error(e, (line.weight, line.K), &self.r[..posterior.frame.r]);
        let scalar = Scalar { u, states: line.states, h: line.h, D: line.weight + KNK };
        *bar.noise = T::splat(0.5) * (u.fma(u, dot(&*self.upsilon, &self.upsilon)) - scalar.D);
        *bar.value = -u;
        absorb((scalar.states, scalar.h), &[u], &mut self.r);
        absorb((scalar.states, scalar.h), &self.upsilon, &mut self.rho);
        if let Some((bar, before)) = bar.h {
            self.h_adjoint(&scalar, before, bar);
        }
        self.information_back(&scalar);
    }

    /// υ and NK of a measurement; returns K'NK.
    #[inline(always)]
    fn gain_terms<E: Entries<T>>(&mut self, line: &ScalarMeasurement<'_, T, E>, posterior: &PosteriorRoot<'_, T>) -> T {
        let (r, c) = (posterior.frame.r, posterior.columns);
        let Adjoint { rho, N, NK, upsilon, .. } = self;
        posterior.times_root(line.T, upsilon);
        for upsilon in upsilon.iter_mut() {
            *upsilon = *upsilon * line.weight;
        }
        for i in 0..r {
            let K = line.K.entry(i);
            for k in 0..c {
                upsilon[k] = K.fnma(rho[i * c + k], upsilon[k]);
            }
        }
        NK.clear();
        for i in 0..r {
            NK.push(dot(line.K, &N[i * r..][..r]));
        }
        dot(line.K, NK)
    }

    /// N ← hh'/S + (I-Kh')'N(I-Kh') = N - h(NK)' - (NK)h' + (1/S + K'NK) hh'.
    #[inline(always)]
    fn information_back<E: Entries<T>>(&mut self, scalar: &Scalar<'_, T, E>) {
        let (Adjoint { N, NK, .. }, Scalar { states, h, D, .. }) = (self, scalar);
        let r = NK.len();
        let reached = &states[..states.partition_point(|&state| (state as usize) < r)];
        for (k, &a) in reached.iter().enumerate() {
            let (a, ha) = (a as usize, h.entry(k));
            for i in 0..r {
                N[a * r + i] = ha.fnma(NK[i], N[a * r + i]);
                N[i * r + a] = ha.fnma(NK[i], N[i * r + a]);
            }
            for (k, &b) in reached.iter().enumerate() {
                let at = a * r + b as usize;
                N[at] = (*D * ha).fma(h.entry(k), N[at]);
            }
        }
    }

    /// ∂ℓ/∂h; r and ρ already include this measurement, N does not.
    #[inline(always)]
    fn h_adjoint<E: Entries<T>>(&mut self, scalar: &Scalar<'_, T, E>, before: FilterSnapshot<'_, T>, bar: &mut [T]) {
        let Adjoint { r: adjoint, rho, NK, upsilon, smoothed, .. } = self;
        let (r, c) = (NK.len(), upsilon.len());
        for (i, bar) in bar.iter_mut().enumerate() {
            *bar = scalar.u * before.x[i] - dot(&**upsilon, &before.Psi[i * c..][..c]);
        }
        // ur + ρυ' - (h/S - (I-Kh')'NK), where the parenthesis equals h (1/S + K'NK) - NK
        smoothed.clear();
        for j in 0..r {
            smoothed.push(scalar.u.fma(adjoint[j], dot(&**upsilon, &rho[j * c..][..c])) + NK[j]);
        }
        let reach = scalar.states.partition_point(|&state| (state as usize) < r);
        for (k, &state) in scalar.states[..reach].iter().enumerate() {
            smoothed[state as usize] = scalar.h.entry(k).fnma(scalar.D, smoothed[state as usize]);
        }
        for i in 0..r {
            bar[i] = bar[i] + dot(&before.P[i * r..][..r], smoothed);
        }
    }

    /// The backward pass through a transition, whose adjoints go to `bar`. `before_transition`: the state of the filter
    /// before the transition, where adjoints of φ are wanted.
    #[inline(always)]
    pub(super) fn moved<E: Entries<T>>(
        &mut self,
        posterior: &PosteriorRoot<'_, T>,
        transition: TransitionView<'_, E>,
        before_transition: Option<FilterSnapshot<'_, T>>,
        bar: &mut TransitionAdjoint<T>,
    ) {
        let (r, c) = (posterior.frame.r, posterior.columns);
        let (Adjoint { r: adjoint, rho, N, before, rows, .. }, pattern) = (&mut *self, transition.pattern);
        bar.input.clear();
        for &state in &posterior.frame.driven {
            bar.input.push(adjoint[state as usize]);
        }
        bar.q.clear();
        for &(i, j) in &pattern.pairs {
            let (i, j) = (i as usize, j as usize);
            let both = outer_entry(adjoint, rho, c, i, j) - N[i * r + j];
            bar.q.push(if i == j { T::splat(0.5) * both } else { both });
        }
        bar.phi.clear();
        bar.phi.resize(pattern.columns.len(), T::splat(0.0));
        if before_transition.is_some() {
            before.clear();
            before.extend_from_slice(adjoint);
            before.extend_from_slice(rho);
        }
        let n = adjoint.len();
        advance_transposed(adjoint, (n, 1), transition, rows);
        advance_transposed(rho, (n, c), transition, rows);
        times_phi(N, r, transition, rows);
        if let Some(before_transition) = before_transition {
            self.phi_adjoint(pattern, before_transition, (r, c), &mut bar.phi);
        }
        advance_transposed(&mut self.N, (r, r), transition, &mut self.rows);
    }

    /// ∂ℓ/∂φ, after r and ρ have become φ'r and φ'ρ, and N has become Nφ.
    #[inline(always)]
    fn phi_adjoint(
        &mut self,
        pattern: &Pattern,
        before_transition: FilterSnapshot<'_, T>,
        (r, c): (usize, usize),
        bar: &mut [T],
    ) {
        let Adjoint { r: adjoint, rho, N, before, smoothed, .. } = self;
        let (adjoint_before, rho_before) = before.split_at(adjoint.len());
        // x̄ + Pφ'r and ΨC - Pφ'ρ of the noisy states; for all other states, x̄ and ΨC are not changed
        smoothed.clear();
        for i in 0..r {
            let P = &before_transition.P[i * r..][..r];
            smoothed.push(before_transition.x[i] + dot(P, &adjoint[..r]));
            let row = smoothed.len();
            smoothed.extend_from_slice(&before_transition.Psi[i * c..][..c]);
            for (j, &P) in P.iter().enumerate() {
                for k in 0..c {
                    smoothed[row + k] = P.fnma(rho[j * c + k], smoothed[row + k]);
                }
            }
        }
        for row in &pattern.moved {
            let i = row.state as usize;
            let rho_before = &rho_before[i * c..][..c];
            for k in row.start as usize..row.end as usize {
                let j = pattern.columns[k] as usize;
                let (x, B) = match smoothed.get(j * (1 + c)..(j + 1) * (1 + c)) {
                    Some(smoothed) => (smoothed[0], &smoothed[1..]),
                    None => (before_transition.x[j], &before_transition.Psi[j * c..][..c]),
                };
                bar[k] = adjoint_before[i] * x - dot(rho_before, B);
                if i < r && j < r {
                    // P is symmetric
                    bar[k] = bar[k] - dot(&N[i * r..][..r], &before_transition.P[j * r..][..r]);
                }
            }
        }
    }
}
