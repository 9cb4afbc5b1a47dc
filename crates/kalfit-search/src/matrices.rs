//! Parameters in the matrices of the covariance structure: dℓ/dα through Σ at fixed coordinates of Σ.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::DMatrix;

use kalfit_filter::score::Gradient;
use kalfit_model::{Alpha, CovarianceKind, CovarianceStructure, PhasedModel, Scope, Slots, Tape};

/// dℓ/dvalue through Σ = Σ* (fixed), βΣ* (proportional) or DRD (correlation), from G with dℓ = tr(G dΣ), over all phases.
pub fn matrix_gradient(
    model: &PhasedModel,
    alpha: &Alpha,
    slots: &Slots,
    sigma: &DMatrix<f64>,
    score: &DMatrix<f64>,
) -> Gradient {
    let mut sum = BTreeMap::new();
    for (structure, range) in model.blocks() {
        let own =
            |matrix: &DMatrix<f64>| matrix.view((range.start, range.start), (range.len(), range.len())).into_owned();
        for (slot, bar) in block_gradient(structure, alpha, slots, &own(sigma), &own(score)) {
            *sum.entry(slot).or_insert(0.0) += bar;
        }
    }
    sum.into_iter().collect()
}

/// dΣ/dvalue at fixed coordinates of Σ, for each value that a matrix of the structures depends on.
pub fn matrix_derivatives(
    model: &PhasedModel,
    alpha: &Alpha,
    slots: &Slots,
    sigma: &DMatrix<f64>,
) -> BTreeMap<usize, DMatrix<f64>> {
    let mut all = BTreeMap::new();
    for (structure, range) in model.blocks() {
        let own = sigma.view((range.start, range.start), (range.len(), range.len())).into_owned();
        each_derivative(structure, alpha, slots, &own, &mut |slot, (i, j), slope| {
            let whole = all.entry(slot).or_insert_with(|| DMatrix::zeros(sigma.nrows(), sigma.ncols()));
            whole[(range.start + i, range.start + j)] += slope;
        });
    }
    all
}

fn block_gradient(
    structure: &CovarianceStructure,
    alpha: &Alpha,
    slots: &Slots,
    sigma: &DMatrix<f64>,
    score: &DMatrix<f64>,
) -> Gradient {
    let mut gradient: BTreeMap<usize, f64> =
        block_slots(structure, slots).into_iter().map(|slot| (slot, 0.0)).collect();
    each_derivative(structure, alpha, slots, sigma, &mut |slot, at, slope| {
        *gradient.entry(slot).or_insert(0.0) += score[at] * slope;
    });
    gradient.into_iter().collect()
}

/// dσ_ij/dvalue of one block for every element and every value that the element depends on; `take` receives (slot, (i,
/// j), derivative).
fn each_derivative(
    structure: &CovarianceStructure,
    alpha: &Alpha,
    slots: &Slots,
    sigma: &DMatrix<f64>,
    take: &mut dyn FnMut(usize, (usize, usize), f64),
) {
    // a kind that is added must say here how Σ depends on parameters: the compiler refuses to leave it out
    let entries = match &structure.kind {
        CovarianceKind::Fixed(entries)
        | CovarianceKind::Proportional(entries)
        | CovarianceKind::Correlation(entries) => entries,
        CovarianceKind::Full | CovarianceKind::Diagonal | CovarianceKind::Blocks(_) | CovarianceKind::Linear { .. } => {
            return;
        } // nothing but numbers
    };
    if block_slots(structure, slots).is_empty() {
        return;
    }
    let scope = Scope { numbers: &[], texts: &[], step: 0.0, alpha };
    let value = |i: usize, j: usize| entries[i][j].evaluate(&scope).unwrap_or(0.0); // it had a value when Σ was made
    let star: f64 = (0..sigma.nrows()).map(|i| value(i, i)).sum();
    let weight = |i: usize, j: usize| match &structure.kind {
        CovarianceKind::Proportional(_) if star > 0.0 => sigma.trace() / star,
        CovarianceKind::Correlation(_) => (sigma[(i, i)] * sigma[(j, j)]).sqrt(),
        CovarianceKind::Fixed(_) => 1.0,
        CovarianceKind::Proportional(_)
        | CovarianceKind::Full
        | CovarianceKind::Diagonal
        | CovarianceKind::Blocks(_)
        | CovarianceKind::Linear { .. } => 0.0, // Σ* is zero, or no matrix of the structure is there
    };
    let mut tape = Tape::default();
    for (i, row) in entries.iter().enumerate() {
        for (j, entry) in row.iter().enumerate() {
            let _ = entry.differentiate(weight(i, j), &scope, &mut tape, &mut |parameter, bar| {
                if let Some(slot) = slots.find(parameter, &[]) {
                    take(slot, (i, j), bar);
                }
            });
        }
    }
}

/// Slots of the free values that matrices of the covariance structures depend on.
pub(crate) fn slots(model: &PhasedModel, slots: &Slots) -> Vec<usize> {
    let all: BTreeSet<usize> = model.blocks().flat_map(|(structure, _)| block_slots(structure, slots)).collect();
    all.into_iter().collect()
}

fn block_slots(structure: &CovarianceStructure, slots: &Slots) -> Vec<usize> {
    let entries = structure.kind.expressions();
    let named: BTreeSet<usize> = entries.into_iter().flat_map(|(_, entry)| entry.parameters()).collect();
    (0..slots.len()).filter(|&s| named.contains(&slots.slots()[s].parameter)).collect()
}
