//! The data-dependent part of the smoother of one test, computed by the plan of the design.

use nalgebra::{DMatrix, DVector};

use crate::score::moments::Moments;
use crate::score::smoother::plan::{InheritPlan, LinkPlan, SmootherPlan};
use crate::score::smoother::{InheritanceAdjoint, LaterAdjoint, PhaseLaws, SmoothedPhase, inherited, terminal};
use kalfit_model::PhaseReduction;

/// d of the information about each phase: of this and all later phases about σ (`totals`), and of later phases about
/// the last state x_K (`laters`).
struct PhaseData {
    totals: Vec<DVector<f64>>,
    laters: Vec<Option<DVector<f64>>>,
    /// Sum of the squares of the remainders.
    remainder: f64,
}

impl SmootherPlan {
    /// For each phase of a test: the moments of σ given all data, the adjoints of the last state from later phases, and
    /// the adjoints of the inheritance.
    pub(crate) fn smooth(&self, pieces: &[PhaseReduction], laws: &PhaseLaws) -> Vec<SmoothedPhase> {
        let data = self.phase_data(pieces, laws);
        let mut prior = self.first_prior(laws);
        let mut before: Option<DVector<f64>> = None;
        let mut all = Vec::with_capacity(pieces.len());
        for (i, (piece, plan)) in pieces.iter().zip(&self.phases).enumerate() {
            if let Some(before) = &before {
                let inherited = inherited(piece);
                prior = laws.laws[i].mean(prior_size(piece), Some(&inherited.input)) + &inherited.transition * before;
            }
            let residual = &data.totals[i] - &plan.total * &prior;
            let mean = &prior + &plan.gain * &residual;
            let inherited = plan.inherits.as_ref().zip(before.as_ref());
            let inherited = inherited.map(|(inherits, before)| {
                let r = plan.prior_factor.tr_mul(&solved(&plan.prior_lower, residual));
                inherits.bar(before, r)
            });
            let later = plan.link.as_ref().zip(data.laters[i].as_ref()).map(|(link, d)| link.later(piece, d, &mean));
            before = plan.link.as_ref().map(|_| {
                let own = DVector::from_column_slice(&piece.reduction.data) - &plan.own * &prior;
                let terminal = terminal(piece);
                &terminal.mean + &terminal.sensitivity * (&prior + &plan.own_gain * own)
            });
            all.push(SmoothedPhase { moments: Moments::of(&mean, &plan.root), later, inherited });
        }
        all
    }

    /// ℓ of a test, including -½ X'WX of the directions of the mean.
    pub fn likelihood(&self, pieces: &[PhaseReduction], laws: &PhaseLaws) -> f64 {
        let (data, plan) = (self.phase_data(pieces, laws), &self.phases[0]);
        let residual = &data.totals[0] - &plan.total * self.first_prior(laws);
        let squares = solved(&plan.prior_lower, residual).norm_squared();
        let constants: f64 = pieces.iter().map(|piece| piece.reduction.constant).sum();
        constants + self.constant - 0.5 * (data.remainder + squares)
    }

    fn first_prior(&self, laws: &PhaseLaws) -> DVector<f64> {
        laws.laws[0].mean(self.phases[0].own.ncols(), None)
    }

    fn phase_data(&self, pieces: &[PhaseReduction], laws: &PhaseLaws) -> PhaseData {
        let own = |piece: &PhaseReduction| DVector::from_column_slice(&piece.reduction.data);
        let last = pieces.len() - 1;
        let mut data = PhaseData { totals: vec![own(&pieces[last])], laters: vec![None], remainder: 0.0 };
        for i in (0..last).rev() {
            let (next, link) = (&pieces[i + 1], self.phases[i].link.as_ref().expect("a phase follows"));
            let mean = laws.laws[i + 1].mean(prior_size(next), Some(&inherited(next).input));
            let total = &data.totals[data.totals.len() - 1];
            let later = solved(&link.lower, total - &self.phases[i + 1].total * mean);
            let state = solved(&link.state_lower, &later - &link.factor * &terminal(&pieces[i]).mean);
            let own = &pieces[i].reduction.data;
            let both = DVector::from_iterator(own.len() + state.len(), own.iter().chain(state.iter()).copied());
            let rotated = &link.rotation * both;
            data.remainder += rotated.rows(own.len(), state.len()).norm_squared();
            data.totals.push(rotated.rows(0, own.len()).into_owned());
            data.laters.push(Some(later));
        }
        data.totals.reverse();
        data.laters.reverse();
        data
    }
}

impl LinkPlan {
    /// r = R'S⁻¹(d - R x̄_K), with x̄_K at the mean of σ given all data.
    fn later(&self, piece: &PhaseReduction, d: &DVector<f64>, mean: &DVector<f64>) -> LaterAdjoint {
        let terminal = terminal(piece);
        let state = &terminal.mean + &terminal.sensitivity * mean;
        let residual = solved(&self.state_lower, d - &self.factor * state);
        LaterAdjoint { r: self.state_factor.tr_mul(&residual), rho: self.rho.clone(), N: self.N.clone() }
    }
}

impl InheritPlan {
    /// ∂ℓ/∂t = r, ∂ℓ/∂T = r (x + PT'r)' - NTP, with r and N of the prior of σ, and x and P the mean and covariance of
    /// the last state of the phase before.
    fn bar(&self, before: &DVector<f64>, r: DVector<f64>) -> InheritanceAdjoint {
        let smoothed = before + &self.cross_covariance * &r;
        InheritanceAdjoint { transition: &self.transition + &r * smoothed.transpose(), input: r }
    }
}

/// q of a phase, the length of σ.
fn prior_size(piece: &PhaseReduction) -> usize {
    piece.reduction.data.len()
}

/// The solution L⁻¹x of a triangular system.
fn solved(lower: &DMatrix<f64>, mut x: DVector<f64>) -> DVector<f64> {
    let solved = lower.solve_lower_triangular_mut(&mut x);
    debug_assert!(solved, "its diagonal is at least one");
    x
}
