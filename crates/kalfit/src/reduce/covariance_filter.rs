//! The covariance filter on its way over the steps of a design, or of designs of one shape side by side.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, G = P h, K, T")]

use kalfit_lanes::Lanes;

use crate::reduce::design::{Design, StateFrame, Transition};
use crate::reduce::kernel::{self, FilterState, ScalarUpdate};
use crate::reduce::moment_path::MomentPath;
use crate::reduce::sums::InformationSums;

/// P and Ψ, what a measurement finds, and what is added up.
pub(super) struct CovarianceFilter<T> {
    pub(super) P: Vec<T>,
    pub(super) Psi: Vec<T>,
    G: Vec<T>,
    pub(super) K: Vec<T>,
    pub(super) T: Vec<T>,
    /// Of the measurement that comes next.
    pub(super) h: Vec<T>,
    /// The one that comes next.
    pub(super) transition: Transition<T>,
    /// Work space of the kernels.
    rows: Vec<T>,
    pub(super) sums: InformationSums<T>,
}

impl<T: Lanes> CovarianceFilter<T> {
    /// At the start of a design; `variance`: entries of P0.
    #[inline(always)]
    pub(super) fn new(design: &Design, variance: impl Fn(usize) -> T) -> CovarianceFilter<T> {
        let (frame, zero) = (&*design.frame, T::splat(0.0));
        let (mut P, mut Psi) = (vec![zero; frame.r * frame.r], vec![zero; frame.sensitivity.len()]);
        for k in 0..P.len() {
            P[k] = variance(k);
        }
        for k in 0..Psi.len() {
            Psi[k] = T::splat(frame.sensitivity[k]);
        }
        CovarianceFilter {
            P,
            Psi,
            G: vec![zero; frame.r],
            K: vec![zero; frame.r],
            T: vec![zero; frame.p],
            h: Vec::new(),
            transition: design.blank_transition(),
            rows: Vec::new(),
            sums: InformationSums::new(frame.p),
        }
    }

    /// Takes the coefficients of a line of a design; its states.
    #[inline(always)]
    pub(super) fn take<'d>(&mut self, design: &'d Design, line: usize) -> &'d [u32] {
        let (states, h) = design.terms(line);
        self.h.clear();
        for &h in h {
            self.h.push(T::splat(h));
        }
        states
    }

    /// P and Ψ as they are now go to the end of a path, if there is one.
    #[inline(always)]
    pub(super) fn note(&self, path: &mut Option<MomentPath>) {
        if let Some(path) = path {
            path.push(self.K.len(), &self.P, &self.Psi);
        }
    }

    /// P and Ψ over the transition.
    #[inline(always)]
    pub(super) fn predict(&mut self, frame: &StateFrame) {
        kernel::predict(&mut self.P, frame.r, &self.transition, &mut self.rows);
        self.advance(frame);
    }

    /// Ψ alone.
    #[inline(always)]
    pub(super) fn advance(&mut self, frame: &StateFrame) {
        kernel::advance(&mut self.Psi, frame.p, &self.transition, &mut self.rows);
    }

    /// A scalar measurement of these states: K and T are left.
    #[inline(always)]
    pub(super) fn measure(&mut self, frame: &StateFrame, (states, noise): (&[u32], T)) -> ScalarUpdate<T> {
        let of = FilterState { P: &mut self.P, Psi: &mut self.Psi, J: &mut self.sums.J };
        let update = kernel::measure(frame, (states, &self.h, noise), of, (&mut self.G, &mut self.K, &mut self.T));
        self.sums.count(update.S, update.kept);
        update
    }

    /// A scalar measurement under gains that are known, `weight` being 1/S: T is left.
    #[inline(always)]
    pub(super) fn measure_again(&mut self, frame: &StateFrame, states: &[u32], weight: T) {
        let CovarianceFilter { Psi, K, T, h, sums, .. } = self;
        kernel::sensitivity(frame, states, h, Psi, T);
        kernel::correct(frame.p, K, T, Psi);
        kernel::inform(T, weight, &mut sums.J);
        sums.scale(weight.recip_or_zero());
    }
}
