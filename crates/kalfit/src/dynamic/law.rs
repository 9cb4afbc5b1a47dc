//! The joint law of μ, Σ and the values of α that move Σ, from the inverse of the joint information.

use nalgebra::DMatrix;

use crate::dynamic::covariances::Covariances;
use crate::dynamic::matrices::matrix_derivatives;
use crate::dynamic::{Coordinate, DynamicFit, Standing};
use crate::estimate::{JointLaw, Values};
use crate::model::PhasedModel;

/// Covariances of more coordinates are not kept.
const MOST: usize = 400;

/// The covariance of the inner coordinates and of the values that stand in matrices of the structures, with what those move.
pub(crate) fn joint(model: &PhasedModel, fit: &DynamicFit, covariances: &Covariances) -> JointLaw {
    let coordinates = Coordinate::of(model, &fit.slots);
    let (state, sigma) = (&fit.estimate.state, &fit.estimate.covariance);
    let (mut known, mut moves, mut open) = (Vec::new(), Vec::new(), Vec::new());
    let slope = |slot: usize| coordinates[slot].slope(fit.values[slot]);
    let mut columns: Vec<Moving> = (0..fit.values.len()).map(|slot| (slot, slope(slot), None)).collect();
    for (slot, derivative) in matrix_derivatives(model, &fit.alpha, &fit.slots, sigma) {
        let column = state.elements_in(&(derivative * slope(slot)));
        columns[slot].2 = Some(column.clone());
        let place = covariances.shared.iter().position(|&s| s == slot);
        match (fit.standing[slot], place.filter(|_| covariances.alpha[slot].is_some())) {
            (Standing::Inside, Some(place)) => {
                known.push(place);
                moves.push(column);
            }
            (Standing::Inside | Standing::Unidentified, _) => open.push(column),
            _ => {} // at a bound it stays
        }
    }
    let k = covariances.shared.len();
    let places: Vec<usize> = (k..covariances.whole.nrows()).chain(known).collect();
    let elements = state.problem.covariance.elements.count();
    let matrix = |columns: &[Vec<f64>]| DMatrix::from_fn(elements, columns.len(), |i, c| columns[c][i]);
    JointLaw {
        covariance: DMatrix::from_fn(places.len(), places.len(), |i, j| covariances.whole[(places[i], places[j])]),
        moves: matrix(&moves),
        open: matrix(&open),
        values: values(fit, covariances, (elements, &columns)),
        mixed: None,
    }
}

/// A free value: its slot, dvalue/dcoordinate, and what it moves of Σ.
type Moving = (usize, f64, Option<Vec<f64>>);

/// All free values with everything else; `columns`: dσ/dcoordinate of those that stand in matrices.
fn values(fit: &DynamicFit, covariances: &Covariances, (elements, columns): (usize, &[Moving])) -> Values {
    let place = |slot: usize| covariances.shared.iter().position(|&s| s == slot);
    let is_inside = |slot: usize| fit.standing[slot] == Standing::Inside && covariances.alpha[slot].is_some();
    let (known, rest): (Vec<_>, Vec<_>) =
        columns.iter().partition(|(slot, ..)| is_inside(*slot) && place(*slot).is_some());
    let open = rest.into_iter().map(|(slot, ..)| *slot);
    let open = open.filter(|&slot| matches!(fit.standing[slot], Standing::Inside | Standing::Unidentified)).collect();
    let k = covariances.shared.len();
    let places: Vec<usize> =
        (k..covariances.whole.nrows()).chain(known.iter().filter_map(|(slot, ..)| place(*slot))).collect();
    let covariance = (places.len() <= MOST)
        .then(|| DMatrix::from_fn(places.len(), places.len(), |i, j| covariances.whole[(places[i], places[j])]));
    let moves = DMatrix::from_fn(elements, known.len(), |i, c| known[c].2.as_ref().map_or(0.0, |column| column[i]));
    let is_zero = |slot: &usize| fit.standing[*slot] == Standing::Lower && fit.values[*slot] == 0.0;
    let at_zero = (0..fit.values.len()).filter(is_zero).collect();
    Values { at_zero, slots: known.iter().map(|(slot, slope, _)| (*slot, *slope)).collect(), covariance, moves, open }
}
