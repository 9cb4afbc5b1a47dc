//! Splits the results of all phases into the record of each.

use nalgebra::DMatrix;

use crate::cut::{BlockCut, phases_of};
use crate::{
    BoundaryRecord, CoefficientLawRecord, CovarianceRecord, FactorRecord, FilterRecord, FitRecord,
    InformationLostRecord, InformationRecord, LevelRecord, MatrixRecord, MeanLawRecord, MeanRecord,
    ObservabilityRecord, PhaseRecord, RegressionRecord, ScaleRecord, SlotRecord, UnidentifiedRecord, VectorRecord,
    WeakRecord,
};
use kalfit_algebra::elements::Element;
use kalfit_apply::plan::Quantity;
use kalfit_apply::plan::{InformationLost, StdErrorRatio};
use kalfit_estimate::Estimate;
use kalfit_filter::reduce::Reductions;
use kalfit_infer::Interval;
use kalfit_infer::{Boundary, Inference, MeanTest};
use kalfit_model::{CovarianceKind, MeanElement, MeanStructure, Membership, PhasedModel, Regression};

/// Name of the level of the tests themselves.
const TESTS: &str = "tests";

/// The only kind of filter there is.
const KALMAN_SCHMIDT: &str = "kalman-schmidt";

/// Results of each phase, of each level of groups, the outermost level first and the level of the tests last, and of each
/// crossed factor.
pub(super) fn phases_and_levels(
    model: &PhasedModel,
    estimate: &Estimate,
    inference: &Inference,
    reductions: &Reductions,
) -> (Vec<PhaseRecord>, Vec<LevelRecord>, Vec<FactorRecord>) {
    let mut blocks = blocks(model, estimate, inference, reductions);
    let levels = blocks.split_off(model.phases.len());
    if estimate.grouping().is_none() {
        return (blocks, Vec::new(), Vec::new());
    }
    let count = |block: usize| estimate.state.problem.classes.present[block] as usize;
    let one = |(level, block): (usize, PhaseRecord)| {
        let own = model.levels.iter().rev().nth(level).expect("a level for each block");
        let column = Some(model.shared().text_columns[own.column].name.clone());
        let slot = |member: &Membership| SlotRecord {
            slot: member.slot.clone(),
            column: model.shared().text_columns[member.column].name.clone(),
        };
        let slots = own.members.iter().map(slot).collect();
        LevelRecord { slots, ..LevelRecord::new(own.name.clone(), column, count(level + 1), &block) }
    };
    let mut factors: Vec<LevelRecord> = levels.into_iter().enumerate().map(one).rev().collect();
    let mut levels = factors.split_off(model.factors().len());
    levels.push(LevelRecord::new(TESTS.to_owned(), None, count(0), &blocks[0]));
    let factor = |level: LevelRecord| FactorRecord { level, effects: Vec::new() };
    (blocks, levels, factors.into_iter().map(factor).collect())
}

fn blocks(
    model: &PhasedModel,
    estimate: &Estimate,
    inference: &Inference,
    reductions: &Reductions,
) -> Vec<PhaseRecord> {
    let Inference { unidentified, explanations, observability, .. } = inference;
    let mut unidentified = UnidentifiedRecord::by_phase(model, unidentified, explanations).into_iter();
    let mut seen = ObservabilityRecord::by_phase(model, observability).into_iter();
    let mut weak = WeakRecord::by_phase(model, observability).into_iter();
    let mut information = InformationRecord::by_phase(model, &inference.phases).into_iter();
    let record = |cut: BlockCut<'_>| PhaseRecord {
        unidentified: unidentified.next().unwrap_or_default(),
        observability: seen.next().unwrap_or_default(),
        weakly_determined: weak.next().unwrap_or_default(),
        information: information.next().flatten(),
        tests: Some(tests_of(&cut, (estimate, reductions), model)),
        ..phase(&cut, estimate, inference)
    };
    BlockCut::blocks(model).into_iter().map(record).collect()
}

/// Number of tests that have a phase.
fn tests_of(cut: &BlockCut<'_>, (estimate, reductions): (&Estimate, &Reductions), model: &PhasedModel) -> usize {
    let present = &estimate.state.problem.classes.present;
    match cut.level {
        Some(_) => present[0] as usize,
        None if reductions.remote().is_some() => present[cut.index] as usize,
        None => reductions.iter().filter(|r| phases_of(*r, model) > cut.index).count(),
    }
}

fn phase(cut: &BlockCut<'_>, estimate: &Estimate, inference: &Inference) -> PhaseRecord {
    let (model, states) = (&cut.phase.model, cut.states());
    let (uncertainty, intervals) = (&inference.uncertainty, &inference.intervals);
    let deviations = estimate.covariance.diagonal().map(|v| v.max(0.0).sqrt());
    PhaseRecord {
        name: cut.name().to_owned(),
        units: model.estimated.iter().map(|&s| model.states[s].unit.clone()).collect(),
        mean: mean(cut, estimate, inference),
        covariance: covariance(cut, estimate, inference),
        std_dev: VectorRecord {
            estimate: cut.list(deviations.as_slice()),
            std_error: cut.list(&uncertainty.errors.std_dev),
            interval95: cut.list(&intervals.ends.std_dev),
        },
        correlation: MatrixRecord {
            estimate: cut.square(&correlations(&estimate.covariance)),
            std_error: cut.square(&uncertainty.errors.correlation),
            interval95: cut.square(&intervals.ends.correlation),
        },
        boundary: uncertainty.boundary.iter().filter_map(|b| boundary(cut, &states, b)).collect(),
        unidentified: Vec::new(),
        observability: Vec::new(),
        weakly_determined: Vec::new(),
        tests: None,
        information: None,
        filter: filter(cut),
        states,
    }
}

/// The record of a singular block of Σ; `None` if the block is of another phase.
fn boundary(cut: &BlockCut<'_>, states: &[String], found: &Boundary) -> Option<BoundaryRecord> {
    let names = |of: &[usize]| of.iter().filter_map(|&i| Some(states[cut.element(i)?].clone())).collect::<Vec<_>>();
    let own = names(&found.states);
    (!own.is_empty()).then(|| BoundaryRecord {
        what: "covariance".to_owned(),
        rank: found.rank,
        of: found.states.len(),
        states: own,
        zero_variances: names(&found.zero_variances),
    })
}

fn filter(cut: &BlockCut<'_>) -> Option<FilterRecord> {
    cut.phase.filter.as_ref().map(|filter| FilterRecord {
        kind: KALMAN_SCHMIDT.to_owned(),
        consider: filter.consider.iter().map(|&state| cut.phase.model.states[state].name.clone()).collect(),
        information_lost: None,
    })
}

impl InformationLostRecord {
    /// Information lost on the quantities of one phase; the determinant is of all phases together.
    pub fn new(model: &PhasedModel, phase: usize, lost: &InformationLost) -> InformationLostRecord {
        let range = &model.ranges()[phase];
        let p = range.len();
        let mut record = InformationLostRecord {
            mean_std_error_ratio: vec![None; p],
            covariance_std_error_ratio: vec![vec![None; p]; p],
            log_det_ratio: lost.log_determinant,
        };
        for StdErrorRatio { quantity, ratio } in &lost.std_errors {
            match quantity {
                Quantity::Mean(i) if range.contains(i) => {
                    record.mean_std_error_ratio[i - range.start] = Some(*ratio);
                }
                Quantity::Covariance(i, j) if range.contains(i) && range.contains(j) => {
                    let (i, j) = (i - range.start, j - range.start);
                    record.covariance_std_error_ratio[i][j] = Some(*ratio);
                    record.covariance_std_error_ratio[j][i] = Some(*ratio);
                }
                _ => {}
            }
        }
        record
    }
}

impl FitRecord {
    /// Sets the information that the filter of a phase lost; does nothing where the phase has no filter.
    pub fn add_information_lost(&mut self, phase: usize, lost: InformationLostRecord) {
        if let Some(filter) = self.phases.get_mut(phase).and_then(|phase| phase.filter.as_mut()) {
            filter.information_lost = Some(lost);
        }
    }
}

fn mean(cut: &BlockCut<'_>, estimate: &Estimate, inference: &Inference) -> MeanRecord {
    let model = &cut.phase.model;
    let structure = if cut.level.is_some() { &MeanStructure::zero(cut.elements.len()) } else { &model.mean };
    let estimates = cut.list(&estimate.mean);
    let errors = cut.list(&inference.uncertainty.errors.mean);
    let intervals = cut.list(&inference.intervals.ends.mean);
    let proportional = structure.elements.iter().enumerate().find_map(|(i, e)| match e {
        MeanElement::Proportional(weight) if *weight != 0.0 => Some((i, *weight)),
        _ => None,
    });
    let regression = |(c, r): (usize, &Regression)| RegressionRecord {
        state: model.states[model.estimated[r.element]].name.clone(),
        column: model.columns[r.column].name.clone(),
        estimate: estimate.coefficients[c],
        std_error: inference.uncertainty.errors.coefficients[c],
        interval95: inference.intervals.ends.coefficients[c],
        few_tests: few_tests_of_coefficient(inference, c),
    };
    MeanRecord {
        fixed: structure.elements.iter().map(|e| matches!(e, MeanElement::Fixed(_))).collect(),
        scale: proportional.map(|(i, weight)| ScaleRecord {
            estimate: estimates[i] / weight,
            std_error: errors[i].map(|e| e / weight.abs()),
            interval95: intervals[i].map(|ends| scaled(ends, weight.recip())),
        }),
        regression: cut.regressions.clone().zip(&structure.regression).map(regression).collect(),
        estimate: estimates,
        std_error: errors,
        interval95: intervals,
        few_tests: few_tests(cut, inference),
    }
}

/// Tests of the means of a phase with few tests; empty for a level of groups, whose mean is zero.
fn few_tests(cut: &BlockCut<'_>, inference: &Inference) -> MeanLawRecord {
    let Some(Ok(found)) = inference.few_tests.as_ref().filter(|_| cut.level.is_none()) else {
        return MeanLawRecord::default();
    };
    let list =
        |of: &dyn Fn(&MeanTest) -> Option<f64>| cut.list(&found.mean).iter().map(|own| of(own.as_ref()?)).collect();
    MeanLawRecord {
        std_error_plain: list(&|own| Some(own.std_error_plain)),
        df: list(&|own| own.df),
        df_face: list(&|own| own.df_face),
        statistic: list(&|own| Some(own.statistic)),
        p_value: list(&|own| Some(own.p_value)),
    }
}

fn few_tests_of_coefficient(inference: &Inference, c: usize) -> CoefficientLawRecord {
    let found = inference.few_tests.as_ref().and_then(|found| found.as_ref().ok());
    let Some(own) = found.and_then(|found| found.coefficients[c].as_ref()) else {
        return CoefficientLawRecord::default();
    };
    CoefficientLawRecord {
        std_error_plain: Some(own.std_error_plain),
        df: own.df,
        df_face: own.df_face,
        statistic: Some(own.statistic),
        p_value: Some(own.p_value),
    }
}

fn covariance(cut: &BlockCut<'_>, estimate: &Estimate, inference: &Inference) -> CovarianceRecord {
    let p = cut.elements.len();
    let mut fixed = vec![vec![false; p]; p];
    for sensitivity in &inference.sensitivities {
        if let Element::Covariance(i, j) = sensitivity.element
            && let (Some(i), Some(j)) = (cut.element(i), cut.element(j))
        {
            fixed[i][j] = true;
            fixed[j][i] = true;
        }
    }
    let proportional = matches!(cut.structure().kind, CovarianceKind::Proportional(_));
    let scale = proportional.then(|| estimate.covariance_scale(cut.index));
    CovarianceRecord {
        estimate: cut.block(&estimate.covariance),
        std_error: cut.square(&inference.uncertainty.errors.covariance),
        interval95: cut.square(&inference.intervals.ends.covariance),
        fixed,
        scale: scale.map(|beta| ScaleRecord {
            estimate: beta,
            std_error: inference.uncertainty.scale[cut.index].map(|relative| relative * beta),
            interval95: scale_interval(cut, estimate, inference, beta),
        }),
    }
}

/// Interval of β: the interval of the largest variance times β over the variance.
fn scale_interval(cut: &BlockCut<'_>, estimate: &Estimate, inference: &Inference, beta: f64) -> Interval {
    let variance = |i: usize| estimate.covariance[(i, i)];
    let i = cut.elements.clone().max_by(|&a, &b| variance(a).total_cmp(&variance(b)))?;
    let ends = inference.intervals.ends.covariance[i][i]?;
    (variance(i) > 0.0).then(|| scaled(ends, beta / variance(i)))
}

/// Both ends times a factor, the lower end first.
fn scaled(ends: [Option<f64>; 2], factor: f64) -> [Option<f64>; 2] {
    let [a, b] = ends.map(|end| end.map(|x| x * factor));
    if factor < 0.0 { [b, a] } else { [a, b] }
}

fn correlations(sigma: &DMatrix<f64>) -> Vec<Vec<Option<f64>>> {
    let p = sigma.nrows();
    let entry = |i: usize, j: usize| {
        let unit = (sigma[(i, i)] * sigma[(j, j)]).sqrt();
        let inside = |r: f64| r.clamp(-1.0, 1.0);
        (unit > 0.0).then(|| if i == j { 1.0 } else { inside(sigma[(i, j)] / unit) })
    };
    (0..p).map(|i| (0..p).map(|j| entry(i, j)).collect()).collect()
}
