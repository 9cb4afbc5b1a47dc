//! The joint law of μ, Σ and the free values of α, from the inverse of the joint information.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{DMatrix, DVector};

use kalfit_estimate::{FlatDirection, JointLaw};
use kalfit_model::PhasedModel;
use kalfit_search::ValueCovariances;
use kalfit_search::matrix_derivatives;
use kalfit_search::{Coordinate, DynamicFit, Standing};

/// The covariance of the inner coordinates and of the free values, with the derivatives of Σ by free values that occur
/// in matrices of the covariance structures.
pub(crate) fn joint(model: &PhasedModel, fit: &DynamicFit, covariances: &ValueCovariances) -> JointLaw {
    let coordinates = Coordinate::of(model, &fit.slots);
    let (state, sigma) = (&fit.estimate.state, &fit.estimate.covariance);
    let slope = |slot: usize| coordinates[slot].slope(fit.values[slot]);
    let derivatives = matrix_derivatives(model, &fit.alpha, &fit.slots, sigma);
    // dσ/dcoordinate
    let columns: BTreeMap<usize, Vec<f64>> =
        derivatives.into_iter().map(|(slot, d)| (slot, state.elements_in(&(d * slope(slot))))).collect();
    let place = |slot: &usize| covariances.shared.iter().position(|s| s == slot);
    let is_known = |slot: &usize| {
        fit.standing[*slot] == Standing::Inside && covariances.alpha[*slot].is_some() && place(slot).is_some()
    };
    let (known, mut open): (Vec<usize>, Vec<usize>) = (0..fit.values.len()).partition(is_known);
    // a value at a bound stays there
    open.retain(|&slot| matches!(fit.standing[slot], Standing::Inside | Standing::Unidentified));
    let open_moving: Vec<usize> = open.iter().copied().filter(|slot| columns.contains_key(slot)).collect();
    let (elements, inner) = (state.problem.covariance.elements.count(), covariances.shared.len());
    let moves = |slots: &[usize]| {
        DMatrix::from_fn(elements, slots.len(), |i, c| columns.get(&slots[c]).map_or(0.0, |column| column[i]))
    };
    let places: Vec<usize> = (inner..covariances.whole.nrows()).chain(known.iter().filter_map(place)).collect();
    let is_zero = |slot: &usize| fit.standing[*slot] == Standing::Lower && fit.values[*slot] == 0.0;
    let of_direction = |along: &DVector<f64>| {
        let parts = covariances.shared.iter().copied().zip(along.iter().copied());
        let moving: Vec<(usize, f64)> = parts.filter(|(_, part)| *part != 0.0).collect();
        let mut moves = DVector::zeros(elements);
        for (slot, part) in &moving {
            columns.get(slot).into_iter().flatten().zip(moves.iter_mut()).for_each(|(d, own)| *own += part * d);
        }
        let parameters: BTreeSet<usize> = moving.iter().map(|(slot, _)| fit.slots.slots()[*slot].parameter).collect();
        FlatDirection {
            parameters: parameters.into_iter().collect(),
            inner: along.rows(inner, along.len() - inner).into_owned(),
            moves,
        }
    };
    JointLaw {
        covariance: DMatrix::from_fn(places.len(), places.len(), |i, j| covariances.whole[(places[i], places[j])]),
        slots: known.iter().map(|&slot| (slot, slope(slot))).collect(),
        moves: moves(&known),
        open_moves: moves(&open_moving),
        open,
        at_zero: (0..fit.values.len()).filter(is_zero).collect(),
        flat: covariances.flat.iter().map(of_direction).collect(),
        mixed: None,
    }
}
