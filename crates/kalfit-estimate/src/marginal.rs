//! Phases treated as independent: the paper's quick analysis, in information form (theory §7, "Three ways to fit").
//!
//! The least-squares estimate of σ_i from phase i alone, less its prediction from the estimate of σ_{i-1} by phase i-1
//! alone, is a difference with the mean Eμ_i and the covariance EΣ_iE' + J_e⁻¹. With S = I + R_iCC'R_i' = U'U for the
//! noise between the phases,
//!
//! ```text
//! J_m = R_i'S⁻¹R_i = (I + J_i CC')⁻¹J_i        J_e = J_m - J_mG (J_{i-1} + G'J_mG)⁺ G'J_m
//! ```
//!
//! which is what remains of the rows [R_{i-1} 0 | d_{i-1}] and U⁻ᵀ[R_iG R_i | d_i - R_ig] once σ_{i-1} is projected
//! out. The paper ignores the correlation of these differences between phases and maximises the sum of the logarithms
//! of their densities, log N(difference; Eμ_i, EΣ_iE' + J_e⁻¹). Where J_e is singular, the density is that of J_e times
//! the difference over the range of J_e, in an orthonormal basis: ½ log of the product of the non-zero eigenvalues of
//! J_e, less ½ rank log 2π.

use nalgebra::{DMatrix, DVector};

use kalfit_algebra::factors::{Factors, Rotations};
use kalfit_algebra::rows::Rows;
use kalfit_filter::reduce::ReductionRef;
use kalfit_model::Path;
use kalfit_model::{Chain, ChainPhase, Link};
use kalfit_model::{Reduction, unpack};

/// Singular values below this count as zero, with each column in units of its norm before the projection.
const RANK_TOLERANCE: f64 = 1e-12;

/// The reduction of a test with the phases treated as independent; `None` where the reduction is not stored phase by
/// phase. `states`: number of states of all phases of the model.
pub(crate) fn marginal(reduction: ReductionRef<'_>, states: usize) -> Option<Reduction> {
    let chain = reduction.chain?;
    let mut before: Option<&ChainPhase> = None;
    let parts = chain.phases.iter().map(|phase| {
        let part = Difference::of(before, phase).phase(before.map(|phase| phase.own), phase);
        before = Some(phase);
        part
    });
    let chain = Chain { phases: parts.collect() };
    let (data, factor) = block_diagonal(&chain, states);
    let constant = chain.phases.iter().map(|phase| phase.constant).sum();
    Some(Reduction { constant, residual: None, data, factor, chain: Some(Box::new(chain)), ..reduction.into() })
}

/// The density of a phase's difference, as a function of the phase's σ: log density = constant - ½ ‖data - factor σ‖².
struct Difference {
    factor: DMatrix<f64>,
    data: DVector<f64>,
    constant: f64,
}

impl Difference {
    fn of(before: Option<&ChainPhase>, phase: &ChainPhase) -> Difference {
        let own = unpack(&phase.factor, phase.data.len());
        let data = DVector::from_column_slice(&phase.data);
        match (before, &phase.link) {
            (Some(before), Some(link)) => Difference::remainder(before, link, (own, data)),
            _ => Difference::on_its_range(&own, own.clone(), data),
        }
    }

    /// The difference, from the rows of both phases with σ of the phase before projected out.
    fn remainder(before: &ChainPhase, link: &Link, (own, data): (DMatrix<f64>, DVector<f64>)) -> Difference {
        let (earlier, q) = (unpack(&before.factor, before.data.len()), own.nrows());
        let from = earlier.nrows();
        let noise_factor = Rotations::<f64>::identity_plus(&Rows::from(&(&own * &link.root).transpose()));
        let residual = data - &own * &link.mean;
        let mut rows = DMatrix::zeros(q, from + q + 1);
        rows.view_mut((0, 0), (q, from)).copy_from(&(&own * &link.sensitivity));
        rows.view_mut((0, from), (q, q)).copy_from(&own);
        rows.set_column(from + q, &residual);
        let whitened = Rows::solved_transposed(&noise_factor, Rows::from(&rows));
        let mut stacked_rows = DMatrix::zeros(from + q, from + q + 1);
        stacked_rows.view_mut((0, 0), (from, from)).copy_from(&earlier);
        stacked_rows.view_mut((0, from + q), (from, 1)).copy_from_slice(&before.data);
        (0..q).for_each(|i| (0..from + q + 1).for_each(|k| stacked_rows[(from + i, k)] = whitened[(i, k)]));
        let earlier_columns = stacked_rows.columns(0, from).clone_owned();
        let range = range(&earlier_columns, &earlier_columns);
        let rest = stacked_rows.columns(from, q + 1).clone_owned();
        let kept = &rest - &range * (range.transpose() * &rest);
        let full = rest.columns(0, q).clone_owned();
        Difference::on_its_range(&full, kept.columns(0, q).clone_owned(), kept.column(q).clone_owned())
    }

    /// The density over the range of the rows; parts of the data outside that range are dropped. `full` holds the rows
    /// before the projection.
    fn on_its_range(full: &DMatrix<f64>, factor: DMatrix<f64>, data: DVector<f64>) -> Difference {
        let range = range(&factor, full);
        let rank = range.ncols();
        let mut sizes: Vec<f64> = factor.clone().svd(false, false).singular_values.iter().copied().collect();
        sizes.sort_by(|a, b| b.total_cmp(a));
        let log_det: f64 = sizes[..rank].iter().map(|s| s.ln()).sum();
        let constant = log_det - 0.5 * rank as f64 * std::f64::consts::TAU.ln();
        Difference { factor: range.transpose() * factor, data: range.transpose() * data, constant }
    }

    /// The difference as an independent phase of the states that belong to ξ; states that are only inherited are no
    /// part of ξ and are dropped.
    fn phase(self, before: Option<usize>, like: &ChainPhase) -> ChainPhase {
        let own = like.own;
        let rows = self.factor.nrows();
        let entry = |i: usize, k: usize| if k < own { self.factor[(i, k)] } else { self.data[i] };
        let mut upper = Rows::zeros(own, own + 1);
        let remainder = Rotations::absorb(&mut upper, Rows::from_fn(rows, own + 1, entry), own);
        let residual: f64 = (0..remainder.nrows()).map(|i| remainder[(i, own)].powi(2)).sum();
        let places = (0..own).flat_map(|k| (0..=k).map(move |i| (i, k)));
        let nothing = |from: usize| Link {
            mean: DVector::zeros(own),
            sensitivity: DMatrix::zeros(own, from),
            root: DMatrix::zeros(own, 0),
        };
        ChainPhase {
            own,
            constant: self.constant - 0.5 * residual,
            data: (0..own).map(|i| upper[(i, own)]).collect(),
            factor: places.map(|at| upper[at]).collect(),
            path: Path::Information,
            link: before.map(nothing),
        }
    }
}

/// An orthonormal basis of the column space of `a`; the rank refers to columns divided by the norms of the columns of
/// `full`.
fn range(a: &DMatrix<f64>, full: &DMatrix<f64>) -> DMatrix<f64> {
    let nonzero: Vec<usize> = (0..a.ncols()).filter(|&k| full.column(k).norm() > 0.0).collect();
    if nonzero.is_empty() {
        return DMatrix::zeros(a.nrows(), 0);
    }
    let unit = DMatrix::from_fn(a.nrows(), nonzero.len(), |i, c| a[(i, nonzero[c])] / full.column(nonzero[c]).norm());
    let decomposed = unit.svd(true, false);
    let vectors = decomposed.u.expect("asked for");
    let is_kept = |&k: &usize| decomposed.singular_values[k] > RANK_TOLERANCE;
    let kept: Vec<usize> = (0..vectors.ncols()).filter(is_kept).collect();
    vectors.select_columns(&kept)
}

/// d and packed R of all phases together, with zeros between phases.
fn block_diagonal(chain: &Chain, states: usize) -> (Vec<f64>, Vec<f64>) {
    let mut data: Vec<f64> = chain.phases.iter().flat_map(|phase| phase.data.iter().copied()).collect();
    data.resize(states, 0.0);
    let mut factor = vec![0.0; states * (states + 1) / 2];
    let mut start = 0;
    for phase in &chain.phases {
        for k in 0..phase.own {
            let column = &phase.factor[k * (k + 1) / 2..][..=k];
            let at = start + (start + k) * (start + k + 1) / 2;
            factor[at..=at + k].copy_from_slice(column);
        }
        start += phase.own;
    }
    (data, factor)
}
