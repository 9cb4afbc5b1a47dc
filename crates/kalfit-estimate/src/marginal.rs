//! Each phase by itself: the paper's quick analysis, in information form (theory §7, "Three ways to fit").
//!
//! The least-squares estimate of σ_i from phase i alone, less what the one of σ_{i-1} from phase i-1 alone makes of it, is a
//! difference with the mean Eμ_i and the covariance EΣ_iE' + J_e⁻¹. With S = I + R_iCC'R_i' = U'U for the noise between the phases,
//!
//! ```text
//! J_m = R_i'S⁻¹R_i = (I + J_i CC')⁻¹J_i        J_e = J_m - J_mG (J_{i-1} + G'J_mG)⁺ G'J_m
//! ```
//!
//! which is what is left of the rows [R_{i-1} 0 | d_{i-1}] and U⁻ᵀ[R_iG R_i | d_i - R_ig] once σ_{i-1} is projected out. The paper
//! leaves the correlation of these differences between phases out; what is maximised is the sum of the logarithms of their
//! densities, log N(difference; Eμ_i, EΣ_iE' + J_e⁻¹). Where J_e is singular that is the density of J_e times the difference over its
//! range, in an orthonormal basis: ½ log of the product of the eigenvalues of J_e that are not zero, less ½ rank log 2π.

use nalgebra::{DMatrix, DVector};

use kalfit_algebra::factors::{Factors, Rotations};
use kalfit_algebra::rows::Rows;
use kalfit_filter::reduce::ReductionRef;
use kalfit_model::Path;
use kalfit_model::{Chain, ChainPhase, Link};
use kalfit_model::{Reduction, unpack};

/// Singular values below this part of what the columns were before anything was taken out of them are zero.
const RANK_TOLERANCE: f64 = 1e-12;

/// The reduction of a test whose phases know nothing of each other; `None` where it is not kept phase by phase. `states` are those
/// of all phases of the model.
pub(crate) fn marginal(reduction: ReductionRef<'_>, states: usize) -> Option<Reduction> {
    let chain = reduction.chain?;
    let mut before: Option<&ChainPhase> = None;
    let parts = chain.phases.iter().map(|phase| {
        let part = Difference::of(before, phase).phase(before.map(|phase| phase.own), phase);
        before = Some(phase);
        part
    });
    let chain = Chain { phases: parts.collect() };
    let (data, factor) = side_by_side(&chain, states);
    let constant = chain.phases.iter().map(|phase| phase.constant).sum();
    Some(Reduction { constant, residual: None, data, factor, chain: Some(Box::new(chain)), ..reduction.into() })
}

/// What is known of the σ of a phase apart from the phase before: log density = constant - ½ ‖data - factor σ‖².
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
            (Some(before), Some(link)) => Difference::left(before, link, (own, data)),
            _ => Difference::on_its_range(&own, own.clone(), data),
        }
    }

    /// What is left of both phases' rows once σ of the phase before is projected out.
    fn left(before: &ChainPhase, link: &Link, (own, data): (DMatrix<f64>, DVector<f64>)) -> Difference {
        let (earlier, q) = (unpack(&before.factor, before.data.len()), own.nrows());
        let from = earlier.nrows();
        let spread = Rotations::<f64>::identity_plus(&Rows::from(&(&own * &link.root).transpose()));
        let residual = data - &own * &link.mean;
        let mut rows = DMatrix::zeros(q, from + q + 1);
        rows.view_mut((0, 0), (q, from)).copy_from(&(&own * &link.sensitivity));
        rows.view_mut((0, from), (q, q)).copy_from(&own);
        rows.set_column(from + q, &residual);
        let whitened = Rows::solved_below(&spread, Rows::from(&rows));
        let mut all = DMatrix::zeros(from + q, from + q + 1);
        all.view_mut((0, 0), (from, from)).copy_from(&earlier);
        all.view_mut((0, from + q), (from, 1)).copy_from_slice(&before.data);
        (0..q).for_each(|i| (0..from + q + 1).for_each(|k| all[(from + i, k)] = whitened[(i, k)]));
        let told = all.columns(0, from).clone_owned();
        let range = range(&told, &told);
        let rest = all.columns(from, q + 1).clone_owned();
        let kept = &rest - &range * (range.transpose() * &rest);
        let full = rest.columns(0, q).clone_owned();
        Difference::on_its_range(&full, kept.columns(0, q).clone_owned(), kept.column(q).clone_owned())
    }

    /// The density of what the rows see; parts of the data that they do not explain are no difference. `full`: the rows before
    /// anything was taken out of them.
    fn on_its_range(full: &DMatrix<f64>, factor: DMatrix<f64>, data: DVector<f64>) -> Difference {
        let range = range(&factor, full);
        let rank = range.ncols();
        let mut sizes: Vec<f64> = factor.clone().svd(false, false).singular_values.iter().copied().collect();
        sizes.sort_by(|a, b| b.total_cmp(a));
        let log_det: f64 = sizes[..rank].iter().map(|s| s.ln()).sum();
        let constant = log_det - 0.5 * rank as f64 * std::f64::consts::TAU.ln();
        Difference { factor: range.transpose() * factor, data: range.transpose() * data, constant }
    }

    /// As a phase of its own states: those that only inherit have no part in ξ.
    fn phase(self, before: Option<usize>, like: &ChainPhase) -> ChainPhase {
        let own = like.own;
        let rows = self.factor.nrows();
        let entry = |i: usize, k: usize| if k < own { self.factor[(i, k)] } else { self.data[i] };
        let mut upper = Rows::zeros(own, own + 1);
        let left = Rotations::absorb(&mut upper, Rows::from_fn(rows, own + 1, entry), own);
        let residual: f64 = (0..left.nrows()).map(|i| left[(i, own)].powi(2)).sum();
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

/// An orthonormal basis of the space of the columns, each in units of the one of `full`.
fn range(a: &DMatrix<f64>, full: &DMatrix<f64>) -> DMatrix<f64> {
    let seen: Vec<usize> = (0..a.ncols()).filter(|&k| full.column(k).norm() > 0.0).collect();
    if seen.is_empty() {
        return DMatrix::zeros(a.nrows(), 0);
    }
    let unit = DMatrix::from_fn(a.nrows(), seen.len(), |i, c| a[(i, seen[c])] / full.column(seen[c]).norm());
    let decomposed = unit.svd(true, false);
    let vectors = decomposed.u.expect("asked for");
    let is_kept = |&k: &usize| decomposed.singular_values[k] > RANK_TOLERANCE;
    let kept: Vec<usize> = (0..vectors.ncols()).filter(is_kept).collect();
    vectors.select_columns(&kept)
}

/// d and packed R of all phases, which know nothing of each other.
fn side_by_side(chain: &Chain, states: usize) -> (Vec<f64>, Vec<f64>) {
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
