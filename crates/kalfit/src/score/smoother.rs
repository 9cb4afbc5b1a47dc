//! The smoother over the phases of one test (theory §7): what all phases say of each, and what phases say of those before.
//!
//! ```text
//! backward  (R_I, d_I) ──> on x_K: S = I + R EΣE'R' ──> on σ: S = I + R P_K R' ──> folded with the phase's own (R, d)
//! forward   prior of σ_1 ──> given z_1 ──> link ──> prior of σ_2 ──> …
//! together  prior of σ_i and all that phases i, i+1, … say of it
//! ```
//!
//! Roots of covariances and of information only: nothing is inverted but I + AA'. Under the restricted likelihood directions of
//! the mean ride along: E[σ_i | all] moves by M_i when the mean moves by X, and ℓ_R holds -½ X'WX, the quadratic part of ℓ.
#![expect(non_snake_case, reason = "the letters of the theory: R, P, M, N, T")]

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::estimate::{InitialLaw, unpack};
use crate::linalg::{compressed, log_determinant, posterior_root, whitened, whitener};
use crate::reduce::{Inherited, PhaseReduction, Terminal};
use crate::score::moments::Moments;

/// What the passes through one phase begin from.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Smooth {
    /// Moments of its σ given all phases.
    pub(crate) moments: Moments,
    /// What later phases say of its last state; `None` where none follows.
    pub(crate) later: Option<Later>,
    /// Derivatives to what it inherits; `None` for the first phase.
    pub(crate) inherited: Option<InheritedBar>,
}

/// Adjoints of x_K, in the order of the model's states: r (n), ρ (n × columns of the moments), N (n × n).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Later {
    pub(crate) r: DVector<f64>,
    pub(crate) rho: DMatrix<f64>,
    pub(crate) N: DMatrix<f64>,
}

/// ∂ℓ/∂T and ∂ℓ/∂t of σ = [ξ; 0] + T x_K + t.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct InheritedBar {
    /// q × n of the phase before.
    pub(crate) transition: DMatrix<f64>,
    /// q numbers.
    pub(crate) input: DVector<f64>,
}

/// The law of ξ in the phases of one test.
#[derive(Debug, Clone)]
pub(crate) struct PhaseLaws {
    laws: Vec<PhaseLaw>,
}

/// That of one phase: ξ ~ N(μ, FF'), and directions X of μ.
#[derive(Debug, Clone)]
struct PhaseLaw {
    mean: DVector<f64>,
    root: DMatrix<f64>,
    directions: DMatrix<f64>,
}

impl PhaseLaws {
    /// `ranges`: where each phase stands among the elements of μ; `covariates`: of all phases, in a row.
    pub(crate) fn new(law: &InitialLaw, ranges: &[Range<usize>], covariates: &[f64]) -> PhaseLaws {
        let mean = law.mean_of(covariates);
        let extra = law.mean_root_of(covariates).unwrap_or_else(|| DMatrix::zeros(mean.len(), 0));
        let of = |range: &Range<usize>| {
            let rows = law.root.rows_range(range.clone());
            let kept: Vec<usize> = (0..rows.ncols()).filter(|&c| rows.column(c).amax() > 0.0).collect();
            PhaseLaw {
                mean: mean.rows_range(range.clone()).into_owned(),
                root: rows.select_columns(&kept),
                directions: extra.rows_range(range.clone()).into_owned(),
            }
        };
        PhaseLaws { laws: ranges.iter().map(of).collect() }
    }
}

impl PhaseLaw {
    /// E X, with rows for the states that only inherit.
    fn entering(x: &DMatrix<f64>, q: usize) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(q, x.ncols());
        out.rows_mut(0, x.nrows()).copy_from(x);
        out
    }

    fn mean(&self, q: usize) -> DVector<f64> {
        let mut out = DVector::zeros(q);
        out.rows_mut(0, self.mean.len()).copy_from(&self.mean);
        out
    }
}

/// ½‖d - Rx‖² of what is known of some x, and R, d of the directions of the mean beside.
#[derive(Debug, Clone)]
struct Known {
    factor: DMatrix<f64>,
    data: DVector<f64>,
    columns: DMatrix<f64>,
}

impl Known {
    /// x = g + Gs + noise of covariance AA', the columns' part of g being `moved`: what is known of s. And log|I + RAA'R'|.
    fn through(
        &self,
        (mean, moved): (&DVector<f64>, &DMatrix<f64>),
        sensitivity: &DMatrix<f64>,
        noise: &DMatrix<f64>,
    ) -> (Known, f64) {
        let lower = whitener(&(&self.factor * noise));
        let whiten = |x: &DMatrix<f64>| whitened(&lower, x);
        let data = &self.data - &self.factor * mean;
        let data = whiten(&DMatrix::from_column_slice(data.len(), 1, data.as_slice()));
        let known = Known {
            factor: whiten(&(&self.factor * sensitivity)),
            data: data.column(0).into_owned(),
            columns: whiten(&(&self.columns - &self.factor * moved)),
        };
        (known, log_determinant(&lower))
    }

    /// Both together, and the squares that are left over.
    fn and(&self, other: &Known) -> (Known, f64) {
        let (q, e) = (self.factor.ncols(), self.columns.ncols());
        let rows = self.factor.nrows() + other.factor.nrows();
        let mut all = DMatrix::zeros(rows.max(q), q + 1 + e);
        let mut first = 0;
        for part in [self, other] {
            let m = part.factor.nrows();
            all.view_mut((first, 0), (m, q)).copy_from(&part.factor);
            all.view_mut((first, q), (m, 1)).copy_from(&part.data);
            all.view_mut((first, q + 1), (m, e)).copy_from(&part.columns);
            first += m;
        }
        let upper = all.qr().r();
        let left: f64 =
            (q..upper.nrows()).flat_map(|i| (q..q + 1 + e).map(move |c| (i, c))).map(|at| upper[at].powi(2)).sum();
        let known = Known {
            factor: upper.view((0, 0), (q, q)).into_owned(),
            data: upper.view((0, q), (q, 1)).column(0).into_owned(),
            columns: upper.view((0, q + 1), (q, e)).into_owned(),
        };
        (known, left)
    }

    /// Mean and root of x given this, from a prior m + Bε; and the directions M of the mean.
    fn posterior(&self, prior: &Prior) -> Prior {
        let root = posterior_root(&self.factor, &prior.root);
        let gain = &root * (root.transpose() * self.factor.transpose());
        let mean = &prior.mean + &gain * (&self.data - &self.factor * &prior.mean);
        let directions = &prior.directions + &gain * (&self.columns - &self.factor * &prior.directions);
        Prior { mean, root, directions }
    }
}

/// Mean m, root B of the covariance, and directions M of the mean.
#[derive(Debug, Clone)]
struct Prior {
    mean: DVector<f64>,
    root: DMatrix<f64>,
    directions: DMatrix<f64>,
}

/// One test in phases under a law.
#[derive(Debug)]
struct Pass<'a> {
    pieces: &'a [PhaseReduction],
    laws: &'a [PhaseLaw],
    own: Vec<Known>,
}

impl<'a> Pass<'a> {
    fn new(pieces: &'a [PhaseReduction], laws: &'a PhaseLaws) -> Pass<'a> {
        let laws = &laws.laws[..pieces.len()];
        let own = |(piece, law): (&PhaseReduction, &PhaseLaw)| {
            let q = piece.reduction.data.len();
            Known {
                factor: unpack(&piece.reduction.factor, q),
                data: DVector::from_column_slice(&piece.reduction.data),
                columns: DMatrix::zeros(q, law.directions.ncols()),
            }
        };
        let own = pieces.iter().zip(laws).map(own).collect();
        Pass { pieces, laws, own }
    }

    /// What phase i + 1 and those after it say of the last state of phase i, `total` being what they say of σ_{i+1}; and the
    /// logarithm of the determinant.
    fn on_last_state(&self, i: usize, total: &Known) -> (Known, f64) {
        let (law, inherited) = (&self.laws[i + 1], inherited(&self.pieces[i + 1]));
        let q = inherited.input.len();
        let moved = PhaseLaw::entering(&law.directions, q);
        let mean = law.mean(q) + &inherited.input;
        total.through((&mean, &moved), &inherited.transition, &PhaseLaw::entering(&law.root, q))
    }

    /// What all phases from each on say of its σ, and what later ones say of its last state; and -½ times logarithms of
    /// determinants and squares that are left over.
    fn backward(&self) -> (Vec<Known>, Vec<Option<Known>>, f64) {
        let last = self.pieces.len() - 1;
        let (mut totals, mut laters) = (vec![self.own[last].clone()], vec![None]);
        let mut value = 0.0;
        for i in (0..last).rev() {
            let (later, log) = self.on_last_state(i, &totals[totals.len() - 1]);
            let terminal = terminal(&self.pieces[i]);
            let still = DMatrix::zeros(terminal.mean.len(), later.columns.ncols());
            let (known, log_own) = later.through((&terminal.mean, &still), &terminal.sensitivity, &terminal.root);
            let (total, left) = self.own[i].and(&known);
            value -= 0.5 * (log + log_own + left);
            totals.push(total);
            laters.push(Some(later));
        }
        totals.reverse();
        laters.reverse();
        (totals, laters, value)
    }

    /// Prior of the first σ.
    fn first(&self) -> Prior {
        let (law, q) = (&self.laws[0], self.own[0].data.len());
        Prior {
            mean: law.mean(q),
            root: PhaseLaw::entering(&law.root, q),
            directions: PhaseLaw::entering(&law.directions, q),
        }
    }

    /// Law of the last state of phase i given phases up to it.
    fn filtered(&self, i: usize, prior: &Prior) -> Prior {
        let (own, terminal) = (self.own[i].posterior(prior), terminal(&self.pieces[i]));
        let spread = &terminal.sensitivity * own.root;
        Prior {
            mean: &terminal.mean + &terminal.sensitivity * own.mean,
            root: beside(&spread, &terminal.root),
            directions: &terminal.sensitivity * own.directions,
        }
    }

    /// Prior of σ_i from the last state before.
    fn inherit(&self, i: usize, before: &Prior) -> Prior {
        let (law, inherited) = (&self.laws[i], inherited(&self.pieces[i]));
        let q = inherited.input.len();
        let carried = &inherited.transition * &before.root;
        Prior {
            mean: law.mean(q) + &inherited.input + &inherited.transition * &before.mean,
            root: compressed(&beside(&PhaseLaw::entering(&law.root, q), &carried)),
            directions: PhaseLaw::entering(&law.directions, q) + &inherited.transition * &before.directions,
        }
    }
}

/// The moments of each phase of a test given all of it, what later phases say, and derivatives to what phases inherit.
pub(crate) fn smooth(pieces: &[PhaseReduction], laws: &PhaseLaws) -> Vec<Smooth> {
    let pass = Pass::new(pieces, laws);
    let (totals, laters, _) = pass.backward();
    let mut prior = pass.first();
    let mut before: Option<Prior> = None;
    let mut all = Vec::with_capacity(pieces.len());
    for i in 0..pieces.len() {
        if let Some(before) = &before {
            prior = pass.inherit(i, before);
        }
        let inherited = before
            .as_ref()
            .map(|before| InheritedBar::of(&totals[i], &prior, before, &inherited(&pieces[i]).transition));
        let moments = totals[i].posterior(&prior);
        let columns: Vec<usize> = (0..moments.root.ncols()).filter(|&c| moments.root.column(c).amax() > 0.0).collect();
        let moments = Prior { root: moments.root.select_columns(&columns), ..moments };
        let later = laters[i].as_ref().map(|known| Later::of(known, &pass, i, &moments));
        before = (i + 1 < pieces.len()).then(|| pass.filtered(i, &prior));
        all.push(Smooth {
            moments: Moments::of(&moments.mean, &beside(&moments.root, &moments.directions)),
            later,
            inherited,
        });
    }
    all
}

/// ℓ of a test, with -½ X'WX of the directions of the mean.
pub(crate) fn likelihood(pieces: &[PhaseReduction], laws: &PhaseLaws) -> f64 {
    let pass = Pass::new(pieces, laws);
    let (totals, _, value) = pass.backward();
    let first = pass.first();
    let nowhere = DMatrix::zeros(first.mean.len(), 0);
    let (left, log) = totals[0].through((&first.mean, &first.directions), &nowhere, &first.root);
    let constants: f64 = pieces.iter().map(|piece| piece.reduction.constant).sum();
    constants + value - 0.5 * (log + left.data.norm_squared() + left.columns.norm_squared())
}

impl Later {
    /// r = R'S⁻¹(d - R x̄_K), ρ = R'S⁻¹(RΨ_KC - D), N = R'S⁻¹R with S = I + RP_KR' and D of the directions of the mean.
    fn of(known: &Known, pass: &Pass<'_>, i: usize, moments: &Prior) -> Later {
        let terminal = terminal(&pass.pieces[i]);
        let lower = whitener(&(&known.factor * &terminal.root));
        let R = whitened(&lower, &known.factor);
        let mean = &terminal.mean + &terminal.sensitivity * &moments.mean;
        let residual = &known.data - &known.factor * mean;
        let residual = whitened(&lower, &DMatrix::from_column_slice(residual.len(), 1, residual.as_slice()));
        let spread = &known.factor * &terminal.sensitivity;
        let mut rho = beside(&(&spread * &moments.root), &(&spread * &moments.directions - &known.columns));
        rho = whitened(&lower, &rho);
        Later { r: (R.transpose() * residual).column(0).into_owned(), rho: R.transpose() * rho, N: R.transpose() * &R }
    }
}

impl InheritedBar {
    /// ∂ℓ/∂t = r, ∂ℓ/∂T = r (x + PT'r)' - NTP, with r and N those of the prior of σ and x, P those of the last state before.
    fn of(total: &Known, prior: &Prior, before: &Prior, T: &DMatrix<f64>) -> InheritedBar {
        let lower = whitener(&(&total.factor * &prior.root));
        let R = whitened(&lower, &total.factor);
        let residual = &total.data - &total.factor * &prior.mean;
        let residual = DMatrix::from_column_slice(residual.len(), 1, residual.as_slice());
        let r = R.transpose() * whitened(&lower, &residual);
        let directions = R.transpose() * whitened(&lower, &(&total.columns - &total.factor * &prior.directions));
        let carried = &before.root * (T * &before.root).transpose(); // PT'
        let mut transition = -(R.transpose() * &R) * carried.transpose();
        transition +=
            &r * (DMatrix::from_column_slice(before.mean.len(), 1, before.mean.as_slice()) + &carried * &r).transpose();
        transition += &directions * (&before.directions + &carried * &directions).transpose();
        InheritedBar { transition, input: r.column(0).into_owned() }
    }
}

fn terminal(piece: &PhaseReduction) -> &Terminal {
    piece.terminal.as_ref().expect("a phase that others follow has a last state")
}

fn inherited(piece: &PhaseReduction) -> &Inherited {
    piece.inherited.as_ref().expect("a phase that follows another inherits")
}

/// [A B].
fn beside(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let mut both = DMatrix::zeros(a.nrows(), a.ncols() + b.ncols());
    both.columns_mut(0, a.ncols()).copy_from(a);
    both.columns_mut(a.ncols(), b.ncols()).copy_from(b);
    both
}
