//! The smoother over the phases of one test (theory §7): the moments of each phase given all phases, and the adjoints
//! that later phases give to earlier ones.
//!
//! ```text
//! backward  (R_I, d_I) ──> on x_K: S = I + R EΣE'R' ──> on σ: S = I + R P_K R' ──> folded with the phase's own (R, d)
//! forward   prior of σ_1 ──> given z_1 ──> link ──> prior of σ_2 ──> …
//! together  prior of σ_i and all that phases i, i+1, … say of it
//! ```
//!
//! The smoother uses roots of covariances and of information only, and inverts nothing but I + AA'. The part that does
//! not depend on the data is a [`SmootherPlan`], which tests of one design share; each test then costs only products of
//! matrices with vectors.
//!
//! Under the restricted likelihood the directions of the mean are smoothed too: E[σ_i | all] moves by M_i when the mean
//! moves by X, and ℓ_R contains -½ X'WX, the quadratic part of ℓ.
#![expect(non_snake_case, reason = "the letters of the theory: R, P, M, N, T")]

mod plan;
mod values;

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::reduce::Terminal;
use crate::score::InitialLaw;
use crate::score::moments::Moments;
use kalfit_model::{Inherited, PhaseReduction};

pub(crate) use plan::PlanKey;
pub use plan::SmootherPlan;

/// Results of the smoother for one phase, from which the backward pass over the phase starts.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct SmoothedPhase {
    /// Moments of σ of the phase, given the data of all phases.
    pub(crate) moments: Moments,
    /// Adjoints of the last state of the phase, from later phases; `None` for the last phase.
    pub(crate) later: Option<LaterAdjoint>,
    /// Adjoints of T and t of the inheritance; `None` for the first phase.
    pub(crate) inherited: Option<InheritanceAdjoint>,
}

/// Adjoints of x_K, in the order of the model's states: r (n), ρ (n × columns of the moments), N (n × n).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LaterAdjoint {
    pub(crate) r: DVector<f64>,
    pub(crate) rho: DMatrix<f64>,
    pub(crate) N: DMatrix<f64>,
}

/// ∂ℓ/∂T and ∂ℓ/∂t of σ = [ξ; 0] + T x_K + t.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct InheritanceAdjoint {
    /// ∂ℓ/∂T, q × n, with n the number of states of the phase before.
    pub(crate) transition: DMatrix<f64>,
    /// ∂ℓ/∂t, q values.
    pub(crate) input: DVector<f64>,
}

/// The law of ξ in the phases of one test.
#[derive(Debug, Clone)]
pub struct PhaseLaws {
    laws: Vec<PhaseLaw>,
    /// Covariates on which the directions of the mean depend; tests with other covariates do not share a plan.
    covariates: Vec<f64>,
}

/// The law of ξ in one phase: ξ ~ N(μ, FF'), and directions X of μ.
#[derive(Debug, Clone)]
struct PhaseLaw {
    mean: DVector<f64>,
    root: DMatrix<f64>,
    directions: DMatrix<f64>,
}

impl PhaseLaws {
    /// `ranges`: the elements of μ that belong to each phase; `covariates`: the covariates of all phases, concatenated.
    pub fn new(law: &InitialLaw, ranges: &[Range<usize>], covariates: &[f64]) -> PhaseLaws {
        let mean = law.mean_of(covariates);
        let extra = law.mean_root_of(covariates);
        let covariates = if extra.is_some() { covariates.to_vec() } else { Vec::new() };
        let extra = extra.unwrap_or_else(|| DMatrix::zeros(mean.len(), 0));
        let of = |range: &Range<usize>| {
            let rows = law.root.rows_range(range.clone());
            let kept: Vec<usize> = (0..rows.ncols()).filter(|&c| rows.column(c).amax() > 0.0).collect();
            PhaseLaw {
                mean: mean.rows_range(range.clone()).into_owned(),
                root: rows.select_columns(&kept),
                directions: extra.rows_range(range.clone()).into_owned(),
            }
        };
        PhaseLaws { laws: ranges.iter().map(of).collect(), covariates }
    }
}

impl PhaseLaw {
    /// EX, q rows: X followed by zero rows for the states that only inherit.
    fn entering(x: &DMatrix<f64>, q: usize) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(q, x.ncols());
        out.rows_mut(0, x.nrows()).copy_from(x);
        out
    }

    /// Eμ + t, q values, with t zero where nothing is inherited.
    fn mean(&self, q: usize, input: Option<&DVector<f64>>) -> DVector<f64> {
        let mut out = input.cloned().unwrap_or_else(|| DVector::zeros(q));
        out.rows_mut(0, self.mean.len()).zip_apply(&self.mean, |out, mean| *out += mean);
        out
    }
}

fn terminal(piece: &PhaseReduction) -> &Terminal {
    piece.terminal.as_ref().expect("a phase that others follow has a last state")
}

fn inherited(piece: &PhaseReduction) -> &Inherited {
    piece.inherited.as_ref().expect("a phase that follows another inherits")
}

/// The block matrix [A B].
fn join_columns(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let mut both = DMatrix::zeros(a.nrows(), a.ncols() + b.ncols());
    both.columns_mut(0, a.ncols()).copy_from(a);
    both.columns_mut(a.ncols(), b.ncols()).copy_from(b);
    both
}
