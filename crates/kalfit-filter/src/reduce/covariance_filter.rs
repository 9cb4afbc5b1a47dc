//! The covariance filter on its way over the steps of a design, or of designs of one shape side by side.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, G = P h, K, T")]

use kalfit_lanes::Lanes;

use crate::reduce::design::{StateFrame, TransitionView};
use crate::reduce::entries::Entries;
use crate::reduce::kernel;
use crate::reduce::kernel::{FilterState, ScalarUpdate};
use crate::reduce::moment_path::MomentPath;
use crate::reduce::sums::InformationSums;

/// P and Ψ, what a measurement finds, and what is added up.
pub(super) struct CovarianceFilter<T> {
    pub(super) P: Vec<T>,
    pub(super) Psi: Vec<T>,
    G: Vec<T>,
    pub(super) K: Vec<T>,
    pub(super) T: Vec<T>,
    /// Work space of the kernels.
    rows: Vec<T>,
    pub(super) sums: InformationSums<T>,
}

impl<T: Lanes> CovarianceFilter<T> {
    /// At the start of a design, `variance` its P0.
    #[inline(always)]
    pub(super) fn new<E: Entries<T>>(frame: &StateFrame, variance: E) -> CovarianceFilter<T> {
        let zero = T::splat(0.0);
        let (mut P, mut Psi) = (vec![zero; frame.r * frame.r], vec![zero; frame.sensitivity.len()]);
        for k in 0..P.len() {
            P[k] = variance.entry(k);
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
            rows: Vec::new(),
            sums: InformationSums::new(frame.p),
        }
    }

    /// P and Ψ as they are now go to the end of a path, if there is one.
    #[inline(always)]
    pub(super) fn note(&self, path: &mut Option<MomentPath>) {
        if let Some(path) = path {
            path.push(self.K.len(), &self.P, &self.Psi);
        }
    }

    /// P and Ψ over a transition.
    #[inline(always)]
    pub(super) fn predict<E: Entries<T>>(&mut self, frame: &StateFrame, transition: TransitionView<'_, E>) {
        kernel::predict(&mut self.P, frame.r, transition, &mut self.rows);
        self.advance(frame, transition);
    }

    /// Ψ alone.
    #[inline(always)]
    pub(super) fn advance<E: Entries<T>>(&mut self, frame: &StateFrame, transition: TransitionView<'_, E>) {
        kernel::advance(&mut self.Psi, frame.p, transition, &mut self.rows);
    }

    /// A scalar measurement (states, h, R): K and T are left.
    #[inline(always)]
    pub(super) fn measure<E: Entries<T>>(&mut self, frame: &StateFrame, line: (&[u32], E, T)) -> ScalarUpdate<T> {
        let of = FilterState { P: &mut self.P, Psi: &mut self.Psi, J: &mut self.sums.J };
        let update = kernel::measure(frame, line, of, (&mut self.G, &mut self.K, &mut self.T));
        self.sums.count(update.S, update.kept);
        update
    }

    /// A scalar measurement (states, h) under gains that are known, `weight` being 1/S: T is left.
    #[inline(always)]
    pub(super) fn measure_again<E: Entries<T>>(&mut self, frame: &StateFrame, terms: (&[u32], E), weight: T) {
        let CovarianceFilter { Psi, K, T, sums, .. } = self;
        kernel::sensitivity(frame, terms, Psi, T);
        kernel::correct(frame.p, K, T, Psi);
        kernel::inform(T, weight, &mut sums.J);
        sums.times_determinant(weight.recip_or_zero());
    }
}
