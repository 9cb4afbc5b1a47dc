//! The joint law of μ, Σ and the values of α that move Σ, from the inverse of the joint information.

use nalgebra::DMatrix;

use crate::dynamic::covariances::Covariances;
use crate::dynamic::matrices::matrix_derivatives;
use crate::dynamic::{Coordinate, DynamicFit, Standing};
use crate::estimate::JointLaw;
use crate::model::PhasedModel;

/// The covariance of the inner coordinates and of the values that stand in matrices of the structures, with what those move.
pub(crate) fn joint(model: &PhasedModel, fit: &DynamicFit, covariances: &Covariances) -> JointLaw {
    let coordinates = Coordinate::of(model, &fit.slots);
    let (state, sigma) = (&fit.estimate.state, &fit.estimate.covariance);
    let (mut known, mut moves, mut open) = (Vec::new(), Vec::new(), Vec::new());
    for (slot, derivative) in matrix_derivatives(model, &fit.alpha, &fit.slots, sigma) {
        let column = state.elements_in(&(derivative * coordinates[slot].slope(fit.values[slot])));
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
        mixed: None,
    }
}
