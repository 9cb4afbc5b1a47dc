//! The reducer of estimates: from estimates to reductions.
#![expect(non_snake_case, reason = "the letters of the theory: P, S")]

use std::borrow::Cow;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::reduce::Terminal;
use crate::reduce::digest::Digest;
use crate::reduce::error::{ReduceError, ReduceErrorKind, check_shape, finite, refuse};
use crate::reduce::prepare::{Preparer, Workspace};
use crate::reduce::semidefinite::root;
use crate::reduce::shared_store::{SharedStore, StoreEntry as Entry};
use crate::reduce::subject::{Fault, Subject};
use crate::reduce::suboptimal::conditioned::{Conditioned, EstimateStart, ExactCombination};
use crate::reduce::suboptimal::folded::FoldedEstimates;
use kalfit_model::Estimates;
use kalfit_model::Path;
use kalfit_model::Reduction;
use kalfit_model::{Alpha, Phase};

/// Largest number of bytes of cached conditioned designs.
const CLASS_BYTES: usize = 64 << 20;
/// A deviation up to this fraction of an estimate is lost in the rounding of the estimate.
const LOST_IN_ROUNDING: f64 = 1e-12;

/// The quantities on which J and Ψ_K of estimates depend.
#[derive(Debug, Clone, PartialEq)]
struct EstimateClass {
    sensitivities: DMatrix<f64>,
    transition: DMatrix<f64>,
    root: DMatrix<f64>,
    /// F with FF' = P0.
    start: DMatrix<f64>,
}

type EstimateResult = Result<Conditioned, ExactCombination>;
/// a, a root of P0, and covariates.
type StartOfEstimates = (DVector<f64>, DMatrix<f64>, Vec<f64>);

/// Makes reductions of estimates (theory §8), in the entering coordinates σ of the phase, x_0 = a + Eσ + ζ.
///
/// ```text
/// log p(ŝ | σ) = constant - ½ ‖d - Rσ‖²        x_K | ŝ, σ ~ N(x̂_K + Ψ_K σ, P_K)
/// ```
///
/// The density is that of ŝ on the space in which ŝ is random given x_0 (or given σ, where only ζ makes it random),
/// over an orthonormal basis of that space: it depends on units, and is never compared with the density of
/// measurements. A combination of ŝ that is not random must have the only possible value. a, P0 and the covariates are
/// evaluated by the phase's model at α and at the estimates' constants.
#[derive(Debug)]
pub struct EstimateReducer {
    entering: Vec<usize>,
    preparer: Preparer,
    classes: SharedStore<EstimateClass, EstimateResult>,
}

impl EstimateReducer {
    /// A reducer of the phase at α.
    ///
    /// # Errors
    /// Coefficients without a value, whatever the data.
    pub fn new(phase: &Phase, alpha: &Alpha) -> Result<EstimateReducer, ReduceError> {
        let model = phase.entry_model();
        let preparer = Preparer::new(&model, alpha).map_err(|fault| fault.name(&model, None))?;
        Ok(EstimateReducer { entering: model.estimated, preparer, classes: SharedStore::new(CLASS_BYTES) })
    }

    /// The reduction and the last state of a test, the same whatever was reduced before.
    ///
    /// # Errors
    /// Estimates whose shapes do not fit the model or that are not finite; estimates that contradict themselves in a
    /// direction in which the estimates are not random ([`ReduceErrorKind::Inconsistent`]) or that determine a
    /// combination of σ exactly ([`ReduceErrorKind::ExactMeasurement`]); constants that a, P0 or a regression needs and
    /// that are missing.
    pub fn reduce(&self, id: &str, estimates: &Estimates) -> Result<(Reduction, Terminal), ReduceError> {
        self.reduced(id, estimates).map(|(reduction, terminal, _)| (reduction, terminal))
    }

    /// ½ log |Γ| of the estimates, over an orthonormal basis of the space in which the estimates are random given x_0.
    /// The sum of ½ log |Γ| and the reduction's constant gives the density of the estimates in coordinates in which the
    /// estimates have unit covariance given x_0; this density does not depend on units.
    ///
    /// # Errors
    /// As [`EstimateReducer::reduce`].
    pub fn log_volume(&self, id: &str, estimates: &Estimates) -> Result<f64, ReduceError> {
        self.reduced(id, estimates).map(|(.., log_volume)| log_volume)
    }

    fn reduced(&self, id: &str, estimates: &Estimates) -> Result<(Reduction, Terminal, f64), ReduceError> {
        let n = self.preparer.model.states.len();
        let refuse = |what: &str, kind: ReduceErrorKind| refuse(Some(id), what, kind);
        let widths = (self.preparer.model.columns.len(), self.preparer.model.text_columns.len());
        check(estimates, n, widths).map_err(|(what, kind)| refuse(what, kind))?;
        let named = |fault: Box<Fault>| ReduceError {
            test: Some(id.to_owned()),
            ..fault.name(&self.preparer.model, Some(&estimates.constants))
        };
        let estimates = &*without_lost_deviations(estimates);
        let (start, root, covariates) = self.start(estimates).map_err(named)?;
        let (design, class) = self.class(estimates, root);
        let conditioned = class
            .value()
            .as_ref()
            .map_err(|ExactCombination| refuse("estimates", ReduceErrorKind::ExactMeasurement))?;
        let S = &estimates.sensitivities;
        let u = &estimates.estimates - &estimates.offsets - S * &start;
        let terms =
            estimates.estimates.map(f64::abs) + estimates.offsets.map(f64::abs) + S.map(f64::abs) * start.map(f64::abs);
        conditioned
            .check(&u, &terms)
            .map_err(|(residual, allowed)| refuse("estimates", ReduceErrorKind::Inconsistent { residual, allowed }))?;
        let folded = FoldedEstimates::new(conditioned, &u);
        let known = &estimates.transition * &start + &estimates.drift;
        let terminal = folded.terminal(conditioned, known);
        let (constant, data, factor) = folded.reduction(conditioned);
        let sound = terminal.mean.iter().chain(&terminal.sensitivity).chain(&terminal.root).chain(&data);
        if !sound.chain(&factor).chain([&constant]).all(|x| x.is_finite()) {
            return Err(refuse("estimates", ReduceErrorKind::NotFinite));
        }
        let (steps, observations, path) = (estimates.steps, estimates.observations, Path::SquareRoot);
        let reduction = Reduction {
            test: id.to_owned(),
            constant,
            residual: None,
            data,
            factor,
            covariates,
            steps,
            observations,
            path,
            design,
            chain: None,
            exact: None,
        };
        Ok((reduction, terminal, conditioned.log_volume))
    }

    fn start(&self, estimates: &Estimates) -> Result<StartOfEstimates, Box<Fault>> {
        let mut work: Workspace = self.preparer.workspace();
        self.preparer.open(&estimates.constants, &mut work)?;
        let (order, r) = (&self.preparer.order, work.design.frame.r);
        let start = DVector::from_fn(order.states.len(), |state, _| work.data.start[order.place[state]]);
        let U = root(&work.design.variance, r).map_err(|bad| Fault::new(Subject::KnownCovariance, bad))?;
        let kept: Vec<usize> = (0..r).filter(|k| U[k * r..][..r].iter().any(|x| *x != 0.0)).collect();
        let mut start_root = DMatrix::zeros(order.states.len(), kept.len());
        for (column, k) in kept.iter().enumerate() {
            (0..r).for_each(|i| start_root[(order.states[i], column)] = U[k * r + i]);
        }
        Ok((start, start_root, std::mem::take(&mut work.covariates)))
    }

    /// (digest of the design, conditioned design that all tests of the design share).
    fn class(&self, estimates: &Estimates, start: DMatrix<f64>) -> (u128, Arc<Entry<EstimateClass, EstimateResult>>) {
        let Estimates { sensitivities, transition, root, .. } = estimates;
        let mut digest = Digest::new();
        for matrix in [sensitivities, transition, root, &start] {
            digest.count(matrix.nrows());
            digest.numbers(matrix.as_slice());
        }
        let digest = digest.finish();
        let same = |known: &EstimateClass| {
            let pairs = [(&known.sensitivities, sensitivities), (&known.transition, transition)];
            let root_pairs = [(&known.root, root), (&known.start, &start)];
            pairs.iter().chain(&root_pairs).all(|(a, b)| same_bits(a, b))
        };
        let key = || EstimateClass {
            sensitivities: sensitivities.clone(),
            transition: transition.clone(),
            root: root.clone(),
            start: start.clone(),
        };
        let make = |class: &EstimateClass| {
            let entry = EstimateStart { entering: &self.entering, root: class.start.clone() };
            Conditioned::new(estimates, &entry)
        };
        let size = |class: &EstimateClass, made: &EstimateResult| {
            let key = [&class.sensitivities, &class.transition, &class.root, &class.start];
            8 * key.iter().map(|a| a.len()).sum::<usize>() + made.as_ref().map_or(0, Conditioned::bytes)
        };
        (digest, self.classes.get(digest, same, key, make, size))
    }
}

/// The estimates, where each element whose deviation is lost in the rounding of the value is taken as certain. A gain
/// that is zero up to rounding makes such elements; the remaining deviation has no meaning.
fn without_lost_deviations(estimates: &Estimates) -> Cow<'_, Estimates> {
    let n = estimates.transition.nrows();
    let is_lost = |&i: &usize| {
        let size = estimates.estimates[i].abs().max(estimates.offsets[i].abs());
        let deviation = estimates.root.row(n + i).norm();
        0.0 < deviation && deviation <= LOST_IN_ROUNDING * size
    };
    let rows: Vec<usize> = (0..estimates.estimates.len()).filter(is_lost).collect();
    if rows.is_empty() {
        return Cow::Borrowed(estimates);
    }
    let mut cleared = estimates.clone();
    for i in rows {
        cleared.sensitivities.row_mut(i).fill(0.0);
        cleared.root.row_mut(n + i).fill(0.0);
    }
    Cow::Owned(cleared)
}

fn same_bits(a: &DMatrix<f64>, b: &DMatrix<f64>) -> bool {
    a.shape() == b.shape() && a.iter().zip(b).all(|(x, y)| x.to_bits() == y.to_bits())
}

/// Checks shapes and finiteness. `widths`: (number of numeric columns, number of text columns) of the model.
fn check(estimates: &Estimates, n: usize, widths: (usize, usize)) -> Result<(), (&'static str, ReduceErrorKind)> {
    let m = estimates.estimates.len();
    let Estimates { offsets, sensitivities, transition, drift, root, constants, .. } = estimates;
    let shapes = [
        ("offsets of the estimates", offsets.shape(), (m, 1)),
        ("sensitivities of the estimates", sensitivities.shape(), (m, n)),
        ("transition of the estimates", transition.shape(), (n, n)),
        ("drift of the estimates", drift.shape(), (n, 1)),
        ("root covariance of the estimates", root.shape(), (n + m, root.ncols())),
        ("constants of the estimates", constants.widths(), widths),
    ];
    for (what, found, expected) in shapes {
        check_shape(found, expected).map_err(|kind| (what, kind))?;
    }
    let vectors = [("estimates", &estimates.estimates), (shapes[0].0, offsets), (shapes[3].0, drift)];
    let matrices = [(shapes[1].0, sensitivities), (shapes[2].0, transition), (shapes[4].0, root)];
    let numbers = vectors.map(|(what, vector)| (what, vector.as_slice()));
    for (what, numbers) in numbers.into_iter().chain(matrices.map(|(what, matrix)| (what, matrix.as_slice()))) {
        finite(numbers).map_err(|kind| (what, kind))?;
    }
    Ok(())
}
