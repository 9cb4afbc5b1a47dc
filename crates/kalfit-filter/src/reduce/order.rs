//! The kernel order of a model's states.

use std::sync::Arc;

use crate::reduce::design::{DENSE, StateFrame, ZERO};
use crate::reduce::dynamics::{Dynamics, close_transitively};
use crate::reduce::start::ModelStart;
use crate::reduce::subject::ModelAt;

/// Permutation between the model's order of states and the kernels' order.
#[derive(Debug, Clone)]
pub struct Order {
    /// State of the model at each kernel index.
    pub states: Vec<usize>,
    /// Kernel index of each state of the model.
    pub place: Vec<usize>,
    pub frame: Arc<StateFrame>,
}

/// Traits of each state, by which the kernels order the states.
#[derive(Debug, Clone)]
pub(crate) struct StateTraits {
    /// Whether noise ever reaches the state.
    pub(crate) noisy: Vec<bool>,
    /// Whether the row of φ of the state ever differs from the row of the identity matrix.
    pub(crate) moving: Vec<bool>,
    /// Whether the state has a known input b.
    pub(crate) driven: Vec<bool>,
}

impl Order {
    /// The order of the states of a model.
    pub(crate) fn new(at: &ModelAt<'_>, dynamics: &Dynamics, start: &ModelStart) -> Order {
        let (n, p) = (at.model.states.len(), at.model.estimated.len());
        let (mut moving, mut driven) = (vec![false; n], vec![false; n]);
        for component in &dynamics.components {
            for (i, &state) in component.states.iter().enumerate() {
                moving[state] = !component.is_identity_row(i);
            }
        }
        dynamics.recursions.iter().for_each(|recursion| moving[recursion.state] = true);
        dynamics.driven().for_each(|state| driven[state] = true);
        let noisy = reachable(n, dynamics, start, &at.model.estimated);
        let mut sensitivity = vec![0.0; n * p];
        at.model.estimated.iter().enumerate().for_each(|(column, &state)| sensitivity[state * p + column] = 1.0);
        Order::of(&StateTraits { noisy, moving, driven }, &sensitivity, p)
    }

    /// The order for given traits: states that noise reaches come before noise-free states, and in both groups moving
    /// states come first. `sensitivity`: A by states of the model, n × p, row-major.
    pub(crate) fn of(traits: &StateTraits, sensitivity: &[f64], p: usize) -> Order {
        let StateTraits { noisy, moving, driven } = traits;
        let n = noisy.len();
        let mut states: Vec<usize> = (0..n).collect();
        states.sort_by_key(|&i| (!noisy[i], !moving[i], i));
        let mut place = vec![0; n];
        states.iter().enumerate().for_each(|(at, &state)| place[state] = at);
        let sensitivity_row = |state: usize| &sensitivity[state * p..][..p];
        let row =
            |&state: &usize| if noisy[state] || moving[state] { DENSE } else { column_of(sensitivity_row(state)) };
        let frame = StateFrame {
            n,
            p,
            r: noisy.iter().filter(|&&noisy| noisy).count(),
            rows: states.iter().map(row).collect(),
            sensitivity: states.iter().flat_map(|&state| sensitivity_row(state)).copied().collect(),
            driven: (0..n).filter(|&place| driven[states[place]]).map(|place| place as u32).collect(),
            digest: 0,
        };
        Order { states, place, frame: Arc::new(frame.seal()) }
    }
}

/// The column k where a row of A is the k-th unit vector, [`ZERO`] for a row of zeros, else [`DENSE`].
fn column_of(row: &[f64]) -> u32 {
    match row.iter().position(|&x| x != 0.0) {
        None => ZERO,
        Some(column) if row[column] == 1.0 && row[column + 1..].iter().all(|&x| x == 0.0) => column as u32,
        Some(_) => DENSE,
    }
}

/// Whether noise ever reaches each of the n states.
fn reachable(n: usize, dynamics: &Dynamics, start: &ModelStart, estimated: &[usize]) -> Vec<bool> {
    // depends[i * n + j]: the motion of x_i depends on x_j.
    let mut depends = vec![false; n * n];
    let mut noisy = vec![false; n];
    start.noisy(estimated).iter().for_each(|&state| noisy[state] = true);
    dynamics.noise.iter().for_each(|&(i, j, _)| (noisy[i], noisy[j]) = (true, true));
    for component in &dynamics.components {
        for &(i, j, _) in &component.rates {
            depends[component.states[i] * n + component.states[j]] = true;
        }
        component.held.iter().for_each(|&(i, state, _)| depends[component.states[i] * n + state] = true);
        for &(i, j, _) in &component.noise {
            (noisy[component.states[i]], noisy[component.states[j]]) = (true, true);
        }
    }
    for recursion in &dynamics.recursions {
        recursion.terms.iter().for_each(|&(state, _)| depends[recursion.state * n + state] = true);
    }
    close_transitively(&mut depends, n);
    (0..n).map(|i| noisy[i] || (0..n).any(|j| depends[i * n + j] && noisy[j])).collect()
}
