//! All of the smoother that does not depend on the data.

use nalgebra::DMatrix;

use crate::reduce::same_bits;
use crate::score::smoother::{PhaseLaw, PhaseLaws, beside, inherited, terminal};
use kalfit_algebra::{compressed, log_determinant, posterior_root, whitened, whitener};
use kalfit_model::PhaseReduction;
use kalfit_model::unpack;

/// The smoother of the tests of one design under one law.
#[derive(Debug, Clone)]
pub struct SmootherPlan {
    pub(super) phases: Vec<PhasePlan>,
    /// -½ times logarithms of determinants, and squares of the directions of the mean.
    pub(super) constant: f64,
}

/// That of one phase.
#[derive(Debug, Clone)]
pub(super) struct PhasePlan {
    /// R of the phase by itself, and of all phases from it on.
    pub(super) own: DMatrix<f64>,
    pub(super) total: DMatrix<f64>,
    /// S of the prior, S = LL' = I + R PR' with R of all phases from this one on: L, and L⁻¹R.
    pub(super) prior_lower: DMatrix<f64>,
    pub(super) prior_factor: DMatrix<f64>,
    /// Of the mean of σ, from the residuals of the phase's own data and of all.
    pub(super) own_gain: DMatrix<f64>,
    pub(super) gain: DMatrix<f64>,
    /// Root of Var[σ | all], directions of E[σ | all] beside it.
    pub(super) root: DMatrix<f64>,
    /// To the next phase, if there is one.
    pub(super) link: Option<LinkPlan>,
    /// From the phase before, if there is one.
    pub(super) inherits: Option<InheritPlan>,
}

/// What later phases say of the last state of a phase.
#[derive(Debug, Clone)]
pub(super) struct LinkPlan {
    /// L of S = I + R EΣE'R', R that of the next phase and all after it.
    pub(super) lower: DMatrix<f64>,
    /// R on x_K, and L of S = I + R P_K R'.
    pub(super) factor: DMatrix<f64>,
    pub(super) state_lower: DMatrix<f64>,
    /// L⁻¹R of the same, and what is fixed of the adjoints of x_K.
    pub(super) state_factor: DMatrix<f64>,
    pub(super) rho: DMatrix<f64>,
    pub(super) N: DMatrix<f64>,
    /// Turns the phase's own d and the one from later into d of both, and what is left over.
    pub(super) fold: DMatrix<f64>,
}

/// What is fixed of the derivatives to T.
#[derive(Debug, Clone)]
pub(super) struct InheritPlan {
    /// PT' of the last state before.
    pub(super) carried: DMatrix<f64>,
    /// -NTP, and the directions of the mean.
    pub(super) transition: DMatrix<f64>,
}

/// What a plan depends on, the law apart.
#[derive(Debug, Clone)]
pub(crate) struct PlanKey {
    phases: Vec<[Vec<f64>; 4]>,
    covariates: Vec<f64>,
}

impl PlanKey {
    pub(crate) fn new(pieces: &[PhaseReduction], laws: &PhaseLaws) -> PlanKey {
        let own = |piece: &PhaseReduction| parts(piece).map(<[f64]>::to_vec);
        PlanKey { phases: pieces.iter().map(own).collect(), covariates: laws.covariates.clone() }
    }

    /// Equal bit for bit.
    pub(crate) fn same(&self, pieces: &[PhaseReduction], laws: &PhaseLaws) -> bool {
        let phase = |(a, b): (&[Vec<f64>; 4], &PhaseReduction)| a.iter().zip(parts(b)).all(|(a, b)| same_bits(a, b));
        self.phases.len() == pieces.len()
            && same_bits(&self.covariates, &laws.covariates)
            && self.phases.iter().zip(pieces).all(phase)
    }
}

/// R, Ψ_K, a root of P_K, T.
fn parts(piece: &PhaseReduction) -> [&[f64]; 4] {
    let [sensitivity, root] = match &piece.terminal {
        Some(terminal) => [terminal.sensitivity.as_slice(), terminal.root.as_slice()],
        None => [&[][..]; 2],
    };
    let transition = piece.inherited.as_ref().map_or(&[][..], |inherited| inherited.transition.as_slice());
    [&piece.reduction.factor, sensitivity, root, transition]
}

/// Root of a covariance, and directions of the mean.
#[derive(Debug, Clone)]
struct PriorRoot {
    root: DMatrix<f64>,
    directions: DMatrix<f64>,
}

/// What phases from some one on say: R, and D of the directions of the mean.
#[derive(Debug, Clone)]
struct LaterInformation {
    factor: DMatrix<f64>,
    columns: DMatrix<f64>,
}

impl LaterInformation {
    /// Gain of the mean, and what is left of the spread.
    fn posterior(&self, prior: &PriorRoot) -> (DMatrix<f64>, PriorRoot) {
        let root = posterior_root(&self.factor, &prior.root);
        let gain = &root * (root.transpose() * self.factor.transpose());
        let directions = &prior.directions + &gain * (&self.columns - &self.factor * &prior.directions);
        (gain, PriorRoot { root, directions })
    }
}

impl SmootherPlan {
    pub fn new(pieces: &[PhaseReduction], laws: &PhaseLaws) -> SmootherPlan {
        let laws = &laws.laws[..pieces.len()];
        let own = |piece: &PhaseReduction| unpack(&piece.reduction.factor, piece.reduction.data.len());
        let own: Vec<DMatrix<f64>> = pieces.iter().map(own).collect();
        let mut plan = SmootherPlan { phases: Vec::with_capacity(pieces.len()), constant: 0.0 };
        let (totals, links) = plan.backward(pieces, laws, &own);
        let mut prior = spread(&laws[0], own[0].ncols());
        let mut before: Option<PriorRoot> = None;
        for (i, (link, own)) in links.into_iter().zip(own).enumerate() {
            if let Some(before) = &before {
                prior = inherit(&laws[i], &pieces[i], before);
            }
            let columns = DMatrix::zeros(own.nrows(), prior.directions.ncols());
            let (own_gain, own_spread) = LaterInformation { factor: own.clone(), columns }.posterior(&prior);
            let (gain, mut all) = totals[i].posterior(&prior);
            let kept: Vec<usize> = (0..all.root.ncols()).filter(|&c| all.root.column(c).amax() > 0.0).collect();
            all.root = all.root.select_columns(&kept);
            let link = link.map(|(link, later)| link.about(&later, &pieces[i], &all));
            let prior_lower = whitener(&(&totals[i].factor * &prior.root));
            let prior_factor = whitened(&prior_lower, &totals[i].factor);
            let left = whitened(&prior_lower, &(&totals[i].columns - &totals[i].factor * &prior.directions));
            let inherits = before.as_ref().map(|before| InheritPlan::new(&pieces[i], before, (&prior_factor, &left)));
            if i == 0 {
                plan.constant -= 0.5 * (log_determinant(&prior_lower) + left.norm_squared());
            }
            before = link.is_some().then(|| filtered(&pieces[i], &own_spread));
            let (total, root) = (totals[i].factor.clone(), beside(&all.root, &all.directions));
            plan.phases.push(PhasePlan { own, total, prior_lower, prior_factor, own_gain, gain, root, link, inherits });
        }
        plan
    }

    /// What phases from each on say of its σ, and what later ones say of its last state.
    fn backward(
        &mut self,
        pieces: &[PhaseReduction],
        laws: &[PhaseLaw],
        own: &[DMatrix<f64>],
    ) -> (Vec<LaterInformation>, Vec<Option<(LinkPlan, LaterInformation)>>) {
        let last = pieces.len() - 1;
        let nothing = |i: usize| DMatrix::zeros(own[i].nrows(), laws[i].directions.ncols());
        let mut totals = vec![LaterInformation { factor: own[last].clone(), columns: nothing(last) }];
        let mut links = vec![None];
        for i in (0..last).rev() {
            let (link, later, total, lost) =
                LinkPlan::new((&pieces[i], &own[i]), (&pieces[i + 1], &laws[i + 1]), &totals[totals.len() - 1]);
            self.constant -= 0.5 * lost;
            totals.push(total);
            links.push(Some((link, later)));
        }
        totals.reverse();
        links.reverse();
        (totals, links)
    }

    /// Bytes it occupies, nearly.
    pub(crate) fn bytes(&self) -> usize {
        self.phases.iter().map(|phase| 8 * 16 * phase.own.len().max(16)).sum()
    }
}

impl LinkPlan {
    /// The link, what later phases say of x_K, what all of them say of σ; and logarithms and squares.
    fn new(
        (piece, own): (&PhaseReduction, &DMatrix<f64>),
        (next, law): (&PhaseReduction, &PhaseLaw),
        total: &LaterInformation,
    ) -> (LinkPlan, LaterInformation, LaterInformation, f64) {
        let (inherited, terminal, q) = (inherited(next), terminal(piece), total.factor.ncols());
        let prior = spread(law, q);
        let lower = whitener(&(&total.factor * &prior.root));
        let factor = whitened(&lower, &(&total.factor * &inherited.transition));
        let columns = whitened(&lower, &(&total.columns - &total.factor * &prior.directions));
        let state_lower = whitener(&(&factor * &terminal.root));
        let state_factor = whitened(&state_lower, &factor);
        let (rows, m) = (own.nrows(), state_factor.nrows());
        let mut both = DMatrix::zeros(rows + m, own.ncols());
        both.rows_mut(0, rows).copy_from(own);
        both.rows_mut(rows, m).copy_from(&(&state_factor * &terminal.sensitivity));
        // Q whole: what is left over counts too
        let mut fold = DMatrix::identity(rows + m, rows + m);
        let qr = both.qr();
        qr.q_tr_mul(&mut fold);
        let mut turned = DMatrix::zeros(rows + m, columns.ncols());
        turned.rows_mut(rows, m).copy_from(&whitened(&state_lower, &columns));
        let turned = &fold * turned;
        let left = turned.rows(rows, m).norm_squared();
        let all = LaterInformation { factor: qr.r(), columns: turned.rows(0, rows).into_owned() };
        let lost = log_determinant(&lower) + log_determinant(&state_lower) + left;
        let later = LaterInformation { factor: factor.clone(), columns };
        let (rho, N) = (DMatrix::zeros(0, 0), state_factor.transpose() * &state_factor);
        (LinkPlan { lower, factor, state_lower, state_factor, rho, N, fold }, later, all, lost)
    }

    /// ρ = R'S⁻¹(RΨ_KC - D), with D of the directions of the mean.
    fn about(mut self, later: &LaterInformation, piece: &PhaseReduction, all: &PriorRoot) -> LinkPlan {
        let spread = &self.factor * &terminal(piece).sensitivity;
        let rho = beside(&(&spread * &all.root), &(&spread * &all.directions - &later.columns));
        self.rho = self.state_factor.transpose() * whitened(&self.state_lower, &rho);
        self
    }
}

impl InheritPlan {
    /// -NTP + Σ m(x + PT'm)' over the directions m of r, x those of the last state before.
    fn new(piece: &PhaseReduction, before: &PriorRoot, (factor, left): (&DMatrix<f64>, &DMatrix<f64>)) -> InheritPlan {
        let T = &inherited(piece).transition;
        let carried = &before.root * (T * &before.root).transpose();
        let directions = factor.transpose() * left;
        let mut transition = -(factor.transpose() * factor) * carried.transpose();
        transition += &directions * (&before.directions + &carried * &directions).transpose();
        InheritPlan { carried, transition }
    }
}

/// That of a phase's own ξ, in its entering coordinates.
fn spread(law: &PhaseLaw, q: usize) -> PriorRoot {
    PriorRoot { root: PhaseLaw::entering(&law.root, q), directions: PhaseLaw::entering(&law.directions, q) }
}

/// That of the last state of a phase, from that of its σ given it and those before.
fn filtered(piece: &PhaseReduction, own: &PriorRoot) -> PriorRoot {
    let terminal = terminal(piece);
    PriorRoot {
        root: beside(&(&terminal.sensitivity * &own.root), &terminal.root),
        directions: &terminal.sensitivity * &own.directions,
    }
}

/// That of σ from the last state before.
fn inherit(law: &PhaseLaw, piece: &PhaseReduction, before: &PriorRoot) -> PriorRoot {
    let T = &inherited(piece).transition;
    let own = spread(law, T.nrows());
    PriorRoot {
        root: compressed(&beside(&own.root, &(T * &before.root))),
        directions: own.directions + T * &before.directions,
    }
}
