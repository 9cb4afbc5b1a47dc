//! The part of the smoother that does not depend on the data.

use nalgebra::DMatrix;

use crate::reduce::same_bits;
use crate::score::smoother::{PhaseLaw, PhaseLaws, inherited, join_columns, terminal};
use kalfit_algebra::{compressed, log_determinant, posterior_root, whitened, whitener};
use kalfit_model::PhaseReduction;
use kalfit_model::unpack;

/// The smoother of the tests of one design under one law.
#[derive(Debug, Clone)]
pub struct SmootherPlan {
    pub(super) phases: Vec<PhasePlan>,
    /// Constant of ℓ: -½ times the sum of the log-determinants and of the squares of the whitened directions of the
    /// mean.
    pub(super) constant: f64,
}

/// The plan of one phase.
#[derive(Debug, Clone)]
pub(super) struct PhasePlan {
    /// R of the phase alone (`own`), and R of this and all later phases (`total`), about σ.
    pub(super) own: DMatrix<f64>,
    pub(super) total: DMatrix<f64>,
    /// L (`prior_lower`) and L⁻¹R (`prior_factor`) of S = LL' = I + R PR', with P the prior covariance of σ and R =
    /// `total`.
    pub(super) prior_lower: DMatrix<f64>,
    pub(super) prior_factor: DMatrix<f64>,
    /// Gains of the mean of σ from the residuals of the phase alone (`own_gain`), and from the residuals of this and
    /// all later phases (`gain`).
    pub(super) own_gain: DMatrix<f64>,
    pub(super) gain: DMatrix<f64>,
    /// Root of Var[σ | all], followed by the directions of E[σ | all] as columns.
    pub(super) root: DMatrix<f64>,
    /// Link to the next phase; `None` for the last phase.
    pub(super) link: Option<LinkPlan>,
    /// Inheritance from the phase before; `None` for the first phase.
    pub(super) inherits: Option<InheritPlan>,
}

/// Information of later phases about the last state x_K of a phase.
#[derive(Debug, Clone)]
pub(super) struct LinkPlan {
    /// L of S = I + R EΣE'R', with R of the next and all later phases.
    pub(super) lower: DMatrix<f64>,
    /// R of later phases in terms of x_K (`factor`), and L of S = LL' = I + R P_K R' (`state_lower`).
    pub(super) factor: DMatrix<f64>,
    pub(super) state_lower: DMatrix<f64>,
    /// L⁻¹R with L = `state_lower` and R = `factor`, and the adjoints ρ and N of x_K, which do not depend on the data.
    pub(super) state_factor: DMatrix<f64>,
    pub(super) rho: DMatrix<f64>,
    pub(super) N: DMatrix<f64>,
    /// Orthogonal matrix that transforms [d of the phase; d of later phases] into [d of this and later phases;
    /// remainder].
    pub(super) rotation: DMatrix<f64>,
}

/// The data-independent part of ∂ℓ/∂T.
#[derive(Debug, Clone)]
pub(super) struct InheritPlan {
    /// PT', n × q, with P the covariance of the last state of the phase before.
    pub(super) cross_covariance: DMatrix<f64>,
    /// -NTP + Σ m(x + PT'm)', q × n, as [`InheritPlan::new`] computes it.
    pub(super) transition: DMatrix<f64>,
}

/// Everything that a plan depends on, except the law.
#[derive(Debug, Clone)]
pub(crate) struct PlanKey {
    phases: Vec<[Vec<f64>; 4]>,
    covariates: Vec<f64>,
}

impl PlanKey {
    pub(crate) fn new(pieces: &[PhaseReduction], laws: &PhaseLaws) -> PlanKey {
        let own = |piece: &PhaseReduction| key_matrices(piece).map(<[f64]>::to_vec);
        PlanKey { phases: pieces.iter().map(own).collect(), covariates: laws.covariates.clone() }
    }

    /// Whether this key equals the key of the phases `pieces` bit for bit.
    pub(crate) fn equals(&self, pieces: &[PhaseReduction], laws: &PhaseLaws) -> bool {
        let phase =
            |(a, b): (&[Vec<f64>; 4], &PhaseReduction)| a.iter().zip(key_matrices(b)).all(|(a, b)| same_bits(a, b));
        self.phases.len() == pieces.len()
            && same_bits(&self.covariates, &laws.covariates)
            && self.phases.iter().zip(pieces).all(phase)
    }
}

/// [R, Ψ_K, root of P_K, T] of a phase; a matrix that the phase does not have is empty.
fn key_matrices(piece: &PhaseReduction) -> [&[f64]; 4] {
    let [sensitivity, root] = match &piece.terminal {
        Some(terminal) => [terminal.sensitivity.as_slice(), terminal.root.as_slice()],
        None => [&[][..]; 2],
    };
    let transition = piece.inherited.as_ref().map_or(&[][..], |inherited| inherited.transition.as_slice());
    [&piece.reduction.factor, sensitivity, root, transition]
}

/// Root of a prior covariance, and directions of the prior mean.
#[derive(Debug, Clone)]
struct PriorRoot {
    root: DMatrix<f64>,
    directions: DMatrix<f64>,
}

/// Information of one phase or of several: R, and D, the columns of d that stand for the directions of the mean.
#[derive(Debug, Clone)]
struct LaterInformation {
    factor: DMatrix<f64>,
    columns: DMatrix<f64>,
}

impl LaterInformation {
    /// Gain of the mean, and the root and directions after the update by this information.
    fn posterior(&self, prior: &PriorRoot) -> (DMatrix<f64>, PriorRoot) {
        let root = posterior_root(&self.factor, &prior.root);
        let gain = &root * (root.transpose() * self.factor.transpose());
        let directions = &prior.directions + &gain * (&self.columns - &self.factor * &prior.directions);
        (gain, PriorRoot { root, directions })
    }
}

impl SmootherPlan {
    /// The smoother for the phases `pieces` of a test under the laws of ξ in the phases.
    pub fn new(pieces: &[PhaseReduction], laws: &PhaseLaws) -> SmootherPlan {
        let laws = &laws.laws[..pieces.len()];
        let own = |piece: &PhaseReduction| unpack(&piece.reduction.factor, piece.reduction.data.len());
        let own: Vec<DMatrix<f64>> = pieces.iter().map(own).collect();
        let mut plan = SmootherPlan { phases: Vec::with_capacity(pieces.len()), constant: 0.0 };
        let (totals, links) = plan.backward(pieces, laws, &own);
        let mut prior = spread(&laws[0], own[0].ncols());
        let mut previous_state: Option<PriorRoot> = None;
        for (i, (link, own)) in links.into_iter().zip(own).enumerate() {
            if let Some(previous_state) = &previous_state {
                prior = inherit(&laws[i], &pieces[i], previous_state);
            }
            let columns = DMatrix::zeros(own.nrows(), prior.directions.ncols());
            let (own_gain, own_spread) = LaterInformation { factor: own.clone(), columns }.posterior(&prior);
            let (gain, mut all) = totals[i].posterior(&prior);
            let kept: Vec<usize> = (0..all.root.ncols()).filter(|&c| all.root.column(c).amax() > 0.0).collect();
            all.root = all.root.select_columns(&kept);
            let link = link.map(|(link, later)| link.with_rho(&later, &pieces[i], &all));
            let prior_lower = whitener(&(&totals[i].factor * &prior.root));
            let prior_factor = whitened(&prior_lower, &totals[i].factor);
            let left = whitened(&prior_lower, &(&totals[i].columns - &totals[i].factor * &prior.directions));
            let inherits = previous_state
                .as_ref()
                .map(|previous_state| InheritPlan::new(&pieces[i], previous_state, (&prior_factor, &left)));
            if i == 0 {
                plan.constant -= 0.5 * (log_determinant(&prior_lower) + left.norm_squared());
            }
            previous_state = link.is_some().then(|| terminal_root(&pieces[i], &own_spread));
            let (total, root) = (totals[i].factor.clone(), join_columns(&all.root, &all.directions));
            plan.phases.push(PhasePlan { own, total, prior_lower, prior_factor, own_gain, gain, root, link, inherits });
        }
        plan
    }

    /// For each phase: the information of this and all later phases about σ, and the link to the next phase with the
    /// information of later phases about the last state x_K.
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
            let (link, later, total, log_terms) =
                LinkPlan::new((&pieces[i], &own[i]), (&pieces[i + 1], &laws[i + 1]), &totals[totals.len() - 1]);
            self.constant -= 0.5 * log_terms;
            totals.push(total);
            links.push(Some((link, later)));
        }
        totals.reverse();
        links.reverse();
        (totals, links)
    }

    /// Approximate size in bytes.
    pub(crate) fn bytes(&self) -> usize {
        self.phases.iter().map(|phase| 8 * 16 * phase.own.len().max(16)).sum()
    }
}

impl LinkPlan {
    /// (the link, the information of later phases about x_K, the information of this and later phases about σ, the sum
    /// of the log-determinants and squares for the constant).
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
        // the full orthogonal factor of the QR decomposition: the remainder counts too
        let mut rotation = DMatrix::identity(rows + m, rows + m);
        let qr = both.qr();
        qr.q_tr_mul(&mut rotation);
        let mut rotated = DMatrix::zeros(rows + m, columns.ncols());
        rotated.rows_mut(rows, m).copy_from(&whitened(&state_lower, &columns));
        let rotated = &rotation * rotated;
        let left = rotated.rows(rows, m).norm_squared();
        let all = LaterInformation { factor: qr.r(), columns: rotated.rows(0, rows).into_owned() };
        let log_terms = log_determinant(&lower) + log_determinant(&state_lower) + left;
        let later = LaterInformation { factor: factor.clone(), columns };
        let (rho, N) = (DMatrix::zeros(0, 0), state_factor.transpose() * &state_factor);
        (LinkPlan { lower, factor, state_lower, state_factor, rho, N, rotation }, later, all, log_terms)
    }

    /// Sets ρ = R'S⁻¹(RΨ_KC - D), with D the columns of d for the directions of the mean.
    fn with_rho(mut self, later: &LaterInformation, piece: &PhaseReduction, all: &PriorRoot) -> LinkPlan {
        let spread = &self.factor * &terminal(piece).sensitivity;
        let rho = join_columns(&(&spread * &all.root), &(&spread * &all.directions - &later.columns));
        self.rho = self.state_factor.transpose() * whitened(&self.state_lower, &rho);
        self
    }
}

impl InheritPlan {
    /// Computes -NTP + Σ m(x + PT'm)', with N = R'S⁻¹R of the prior of σ, over the directions m of r and x of the last
    /// state of the phase before.
    fn new(
        piece: &PhaseReduction,
        previous_state: &PriorRoot,
        (factor, left): (&DMatrix<f64>, &DMatrix<f64>),
    ) -> InheritPlan {
        let T = &inherited(piece).transition;
        let cross_covariance = &previous_state.root * (T * &previous_state.root).transpose();
        let directions = factor.transpose() * left;
        let mut transition = -(factor.transpose() * factor) * cross_covariance.transpose();
        transition += &directions * (&previous_state.directions + &cross_covariance * &directions).transpose();
        InheritPlan { cross_covariance, transition }
    }
}

/// Root and directions of ξ of a phase, in the entering coordinates σ of the phase.
fn spread(law: &PhaseLaw, q: usize) -> PriorRoot {
    PriorRoot { root: PhaseLaw::entering(&law.root, q), directions: PhaseLaw::entering(&law.directions, q) }
}

/// Root and directions of the last state of a phase, from the root and directions of σ given this and earlier phases.
fn terminal_root(piece: &PhaseReduction, own: &PriorRoot) -> PriorRoot {
    let terminal = terminal(piece);
    PriorRoot {
        root: join_columns(&(&terminal.sensitivity * &own.root), &terminal.root),
        directions: &terminal.sensitivity * &own.directions,
    }
}

/// Root and directions of σ, from the root and directions of the last state of the phase before.
fn inherit(law: &PhaseLaw, piece: &PhaseReduction, previous_state: &PriorRoot) -> PriorRoot {
    let T = &inherited(piece).transition;
    let own = spread(law, T.nrows());
    PriorRoot {
        root: compressed(&join_columns(&own.root, &(T * &previous_state.root))),
        directions: own.directions + T * &previous_state.directions,
    }
}
