//! Parameters in the matrices of the covariance structure: dℓ/dα through Σ at fixed coordinates of Σ.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::DMatrix;

use crate::model::{Alpha, CovarianceKind, Expression, Model, PhasedModel, Scope, Tape};
use crate::score::{Gradient, Slots};

/// dℓ/dvalue through Σ = Σ* (fixed), βΣ* (proportional) or DRD (correlation), from G with dℓ = tr(G dΣ), over all phases.
pub(crate) fn matrix_gradient(
    model: &PhasedModel,
    alpha: &Alpha,
    slots: &Slots,
    sigma: &DMatrix<f64>,
    score: &DMatrix<f64>,
) -> Gradient {
    let mut sum = BTreeMap::new();
    for (phase, range) in model.phases.iter().zip(model.ranges()) {
        let own =
            |matrix: &DMatrix<f64>| matrix.view((range.start, range.start), (range.len(), range.len())).into_owned();
        for (slot, bar) in phase_gradient(&phase.model, alpha, slots, &own(sigma), &own(score)) {
            *sum.entry(slot).or_insert(0.0) += bar;
        }
    }
    sum.into_iter().collect()
}

fn phase_gradient(model: &Model, alpha: &Alpha, slots: &Slots, sigma: &DMatrix<f64>, score: &DMatrix<f64>) -> Gradient {
    let (CovarianceKind::Fixed(entries) | CovarianceKind::Proportional(entries) | CovarianceKind::Correlation(entries)) =
        &model.covariance.kind
    else {
        return Gradient::new();
    };
    let named = phase_slots(model, slots);
    if named.is_empty() {
        return Gradient::new();
    }
    let scope = Scope { numbers: &[], texts: &[], step: 0.0, alpha };
    let value = |i: usize, j: usize| entries[i][j].evaluate(&scope).unwrap_or(0.0); // it had a value when Σ was made
    let star: f64 = (0..sigma.nrows()).map(|i| value(i, i)).sum();
    let weight = |i: usize, j: usize| match &model.covariance.kind {
        CovarianceKind::Proportional(_) if star > 0.0 => sigma.trace() / star,
        CovarianceKind::Correlation(_) => (sigma[(i, i)] * sigma[(j, j)]).sqrt(),
        CovarianceKind::Fixed(_) => 1.0,
        _ => 0.0,
    };
    let (mut gradient, mut tape) = (vec![0.0; slots.len()], Tape::default());
    for (i, row) in entries.iter().enumerate() {
        for (j, entry) in row.iter().enumerate() {
            let seed = score[(i, j)] * weight(i, j);
            let _ = entry.differentiate(seed, &scope, &mut tape, &mut |parameter, bar| {
                if let Some(slot) = slots.find(parameter, &[]) {
                    gradient[slot] += bar;
                }
            });
        }
    }
    named.into_iter().map(|slot| (slot, gradient[slot])).collect()
}

/// Free values that matrices of the structures depend on.
pub(crate) fn slots(model: &PhasedModel, slots: &Slots) -> Vec<usize> {
    let all: BTreeSet<usize> = model.phases.iter().flat_map(|phase| phase_slots(&phase.model, slots)).collect();
    all.into_iter().collect()
}

fn phase_slots(model: &Model, slots: &Slots) -> Vec<usize> {
    let (CovarianceKind::Fixed(entries) | CovarianceKind::Proportional(entries) | CovarianceKind::Correlation(entries)) =
        &model.covariance.kind
    else {
        return Vec::new();
    };
    let named = |parameter: usize| {
        let is = &mut |part: &Expression| matches!(part, Expression::Parameter(index) if *index == parameter);
        entries.iter().flatten().any(|entry| entry.any(is))
    };
    (0..slots.len()).filter(|&s| named(slots.slots()[s].parameter)).collect()
}
