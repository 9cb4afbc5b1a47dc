//! The covariance filter over the steps of a design, or of designs of one shape in lanes.
#![expect(non_snake_case, reason = "the letters of the theory: P, Psi, G = P h, K, T")]

use kalfit_lanes::Lanes;

use crate::reduce::design::{StateFrame, TransitionView};
use crate::reduce::entries::Entries;
use crate::reduce::kernel;
use crate::reduce::kernel::{FilterState, ScalarUpdate};
use crate::reduce::moment_path::MomentPath;
use crate::reduce::sums::InformationSums;

/// P and Ψ, the results K and T of the last measurement, and the sums over all measurements.
pub(super) struct CovarianceFilter<T> {
    pub(super) P: Vec<T>,
    pub(super) Psi: Vec<T>,
    G: Vec<T>,
    pub(super) K: Vec<T>,
    pub(super) T: Vec<T>,
    /// Work space of the kernels.
    work: Vec<T>,
    pub(super) sums: InformationSums<T>,
}

impl<T: Lanes> CovarianceFilter<T> {
    /// The filter at the start of a design; `variance`: P0.
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
            work: Vec::new(),
            sums: InformationSums::new(frame.p),
        }
    }

    /// Appends the current P and Ψ to `path`, unless `path` is `None`.
    #[inline(always)]
    pub(super) fn note(&self, path: &mut Option<MomentPath>) {
        if let Some(path) = path {
            path.push(self.K.len(), &self.P, &self.Psi);
        }
    }

    /// Predicts P and Ψ over a transition.
    #[inline(always)]
    pub(super) fn predict<E: Entries<T>>(&mut self, frame: &StateFrame, transition: TransitionView<'_, E>) {
        kernel::predict(&mut self.P, frame.r, transition, &mut self.work);
        self.advance(frame, transition);
    }

    /// Predicts Ψ, without P, over a transition.
    #[inline(always)]
    pub(super) fn advance<E: Entries<T>>(&mut self, frame: &StateFrame, transition: TransitionView<'_, E>) {
        kernel::advance(&mut self.Psi, frame.p, transition, &mut self.work);
    }

    /// Takes a scalar measurement (states, h, R) into P, Ψ and the sums; stores K and T.
    #[inline(always)]
    pub(super) fn measure<E: Entries<T>>(&mut self, frame: &StateFrame, line: (&[u32], E, T)) -> ScalarUpdate<T> {
        let filter_state = FilterState { P: &mut self.P, Psi: &mut self.Psi, J: &mut self.sums.J };
        let update = kernel::measure(frame, line, filter_state, (&mut self.G, &mut self.K, &mut self.T));
        self.sums.count(update.S, update.margin);
        update
    }

    /// Takes a scalar measurement (states, h) with known K and `weight` = 1/S into Ψ and the sums; stores T.
    #[inline(always)]
    pub(super) fn measure_with_gains<E: Entries<T>>(&mut self, frame: &StateFrame, terms: (&[u32], E), weight: T) {
        let CovarianceFilter { Psi, K, T, sums, .. } = self;
        kernel::sensitivity(frame, terms, Psi, T);
        kernel::correct(frame.p, K, T, Psi);
        kernel::add_information(T, weight, &mut sums.J);
        sums.times_determinant(weight.recip_or_zero());
    }
}
