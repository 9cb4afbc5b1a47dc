//! The forward filter at ξ = x̂ under the gains of a design, step by step.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, G = P h, K, T, S")]

use kalfit_lanes::Real;
use nalgebra::{DMatrix, DMatrixView};

use crate::reduce::{Entries, TransitionView, advance, correct_mean, innovation, mirror, predict, update};
use crate::score::backward::input::BackwardInput;
use crate::score::backward::scalar_measurement::{PosteriorRoot, ScalarMeasurement};
use crate::score::backward::work::KnownInnovations;

/// x̄ (n) and, where adjoints of φ or h are wanted, P (r × r, both triangles) and ΨC (n × c).
#[derive(Debug, Clone)]
pub(super) struct FilteredMoments<T = f64> {
    pub(super) x: Vec<T>,
    pub(super) P: Vec<T>,
    pub(super) Psi: Vec<T>,
    rows: Vec<T>,
    G: Vec<T>,
    K: Vec<T>,
    T: Vec<T>,
}

impl<T> Default for FilteredMoments<T> {
    fn default() -> FilteredMoments<T> {
        FilteredMoments {
            x: Vec::new(),
            P: Vec::new(),
            Psi: Vec::new(),
            rows: Vec::new(),
            G: Vec::new(),
            K: Vec::new(),
            T: Vec::new(),
        }
    }
}

/// A view of a state written by `FilteredMoments::save`.
#[derive(Debug, Clone, Copy)]
pub struct FilterSnapshot<'a, T = f64> {
    /// State x̄ at ξ = x̂ (n), in kernel order.
    pub x: &'a [T],
    pub(crate) P: &'a [T],
    pub(crate) Psi: &'a [T],
}

impl<'a, T> FilterSnapshot<'a, T> {
    /// A view of a stored state with n states, r of them noisy.
    #[inline(always)]
    pub(super) fn new(kept: &'a [T], (n, r): (usize, usize)) -> FilterSnapshot<'a, T> {
        let (x, rest) = kept.split_at(n);
        let (P, Psi) = rest.split_at(r * r);
        FilterSnapshot { x, P, Psi }
    }
}

impl FilterSnapshot<'_> {
    /// Ψ, n × q.
    pub fn sensitivity(&self) -> DMatrix<f64> {
        let n = self.x.len();
        DMatrix::from_row_slice(n, self.Psi.len() / n.max(1), self.Psi)
    }

    /// Adds P, which is zero beyond the noisy states, to a covariance of all states.
    pub fn add_noise(&self, covariance: &mut DMatrix<f64>) {
        let r = self.P.len().isqrt();
        let mut noisy = covariance.view_mut((0, 0), (r, r));
        noisy += DMatrixView::from_slice(self.P, r, r); // symmetric
    }
}

/// The law of x_0 at ξ = x̂: a (n), P0 (r × r, of which the lower triangle counts), and x̂.
#[derive(Debug, Clone, Copy)]
pub(super) struct InitialState<'a, T, E> {
    pub(super) start: E,
    pub(super) variance: E,
    /// x̂, the posterior mean of ξ.
    pub(super) mean: &'a [T],
}

impl<T: Real> FilteredMoments<T> {
    /// Sets x̄ = a + Ax̂, P = P0 and ΨC = AC.
    #[inline(always)]
    pub(super) fn begin<E: Entries<T>>(&mut self, begin: &InitialState<'_, T, E>, posterior: &PosteriorRoot<'_, T>) {
        let frame = posterior.frame;
        let (n, p, r, c) = (frame.n, frame.p, frame.r, posterior.columns);
        self.x.clear();
        for i in 0..n {
            self.x.push(begin.start.entry(i));
        }
        self.P.clear();
        self.Psi.clear();
        if posterior.needs_covariance() {
            for ij in 0..r * r {
                self.P.push(begin.variance.entry((ij / r).max(ij % r) * r + (ij / r).min(ij % r)));
            }
            self.Psi.resize(n * c, T::splat(0.0));
        }
        for i in 0..n {
            for k in 0..p {
                let a = frame.sensitivity[i * p + k];
                if a == 0.0 {
                    continue;
                }
                let a = T::splat(a);
                self.x[i] = a.fma(begin.mean[k], self.x[i]);
                if posterior.needs_covariance() {
                    let Psi = &mut self.Psi[i * c..][..c];
                    for (Psi, &root) in Psi.iter_mut().zip(&posterior.root[k * c..][..c]) {
                        *Psi = a.fma(root, *Psi);
                    }
                }
            }
        }
    }

    /// A view of the filter's state.
    pub(super) fn seen(&self) -> FilterSnapshot<'_, T> {
        FilterSnapshot { x: &self.x, P: &self.P, Psi: &self.Psi }
    }

    #[inline(always)]
    pub(super) fn save(&self, out: &mut Vec<T>) {
        out.extend_from_slice(&self.x);
        out.extend_from_slice(&self.P);
        out.extend_from_slice(&self.Psi);
    }

    /// Reads a state written by [`FilteredMoments::save`].
    #[inline(always)]
    pub(super) fn load(&mut self, kept: &[T], sizes: (usize, usize)) {
        let seen = FilterSnapshot::new(kept, sizes);
        for (own, seen) in [(&mut self.x, seen.x), (&mut self.P, seen.P), (&mut self.Psi, seen.Psi)] {
            own.clear();
            own.extend_from_slice(seen);
        }
    }

    /// Advances x̄, ΨC and P over a transition; `inputs`: b of the driven states.
    #[inline(always)]
    pub(super) fn advance<E: Entries<T>>(
        &mut self,
        transition: TransitionView<'_, E>,
        inputs: E,
        posterior: &PosteriorRoot<'_, T>,
    ) {
        let (r, c) = (posterior.frame.r, posterior.columns);
        advance(&mut self.x, 1, transition, &mut self.rows);
        for (k, &state) in posterior.frame.driven.iter().enumerate() {
            self.x[state as usize] = self.x[state as usize] + inputs.entry(k);
        }
        if !self.Psi.is_empty() {
            advance(&mut self.Psi, c, transition, &mut self.rows);
        }
        if !self.P.is_empty() {
            predict(&mut self.P, r, transition, &mut self.rows);
            mirror(&mut self.P, r);
        }
    }

    /// Updates x̄, ΨC and P by a measurement with innovation `e`.
    #[inline(always)]
    pub(super) fn measure<E: Entries<T>>(
        &mut self,
        line: &ScalarMeasurement<'_, T, E>,
        e: T,
        posterior: &PosteriorRoot<'_, T>,
    ) {
        let (r, c) = (posterior.frame.r, posterior.columns);
        correct_mean(line.K, e, &mut self.x[..r]);
        if !self.Psi.is_empty() {
            posterior.times_root(line.T, &mut self.T);
            for i in 0..r {
                let K = line.K.entry(i);
                for k in 0..c {
                    self.Psi[i * c + k] = K.fnma(self.T[k], self.Psi[i * c + k]);
                }
            }
        }
        if !self.P.is_empty() {
            self.update_covariance(r, line);
        }
    }

    /// Updates P by gains computed from P: the gains of the design may come from square-root arrays or, once constant,
    /// from other steps, and would let P drift from the true value.
    #[inline(always)]
    fn update_covariance<E: Entries<T>>(&mut self, r: usize, line: &ScalarMeasurement<'_, T, E>) {
        let FilteredMoments { P, G, K, .. } = self;
        for own in [&mut *G, &mut *K] {
            own.clear();
            own.resize(r, T::splat(0.0));
        }
        update(r, (line.states, line.h), line.noise, P, (G, K));
        mirror(P, r);
    }
}

impl BackwardInput<'_> {
    /// Sets the filter to the start of the test.
    pub(super) fn begin(&self, now: &mut FilteredMoments) {
        let begin = InitialState { start: self.start, variance: &*self.design.variance, mean: &self.moments.mean };
        now.begin(&begin, &self.posterior());
    }

    /// Updates the filter by the measurement of a row. The innovation is computed and appended to `e` unless `e`
    /// already contains the innovation of this row.
    pub(super) fn measure(&self, now: &mut FilteredMoments, (line, row): (usize, usize), e: &mut KnownInnovations) {
        let line = self.line((line, row));
        if row == e.known() {
            e.next(1)[0] = innovation(&now.x, (line.states, line.h), self.values[row]);
        }
        if line.weight == 0.0 {
            return; // no information
        }
        now.measure(&line, e.values()[row], &self.posterior());
    }

    /// (n, r), which [`FilterSnapshot::new`] needs to read a stored state.
    pub(super) fn sizes(&self) -> (usize, usize) {
        let frame = &self.design.frame;
        (frame.n, frame.r)
    }
}
