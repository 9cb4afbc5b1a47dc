//! The kernel order of a model's states.

use std::sync::Arc;

use crate::reduce::design::{DENSE, StateFrame, ZERO};
use crate::reduce::dynamics::{Dynamics, close};
use crate::reduce::start::ModelStart;
use crate::reduce::subject::ModelAt;

/// Where states stand in the kernels.
#[derive(Debug, Clone)]
pub(crate) struct Order {
    /// State of the model at each place of the kernels.
    pub(crate) states: Vec<usize>,
    /// Place of each state of the model.
    pub(crate) place: Vec<usize>,
    pub(crate) frame: Arc<StateFrame>,
}

impl Order {
    pub(crate) fn new(at: &ModelAt<'_>, dynamics: &Dynamics, start: &ModelStart) -> Order {
        let (n, p) = (at.model.states.len(), at.model.estimated.len());
        let noisy = reachable(n, dynamics, start, &at.model.estimated);
        let mut moving = vec![false; n];
        for component in &dynamics.components {
            for (i, &state) in component.states.iter().enumerate() {
                moving[state] = !component.still(i);
            }
        }
        dynamics.recursions.iter().for_each(|recursion| moving[recursion.state] = true);
        let mut states: Vec<usize> = (0..n).collect();
        states.sort_by_key(|&i| (!noisy[i], !moving[i], i));
        let mut place = vec![0; n];
        states.iter().enumerate().for_each(|(at, &state)| place[state] = at);
        let column = |state: usize| at.model.estimated.iter().position(|&e| e == state);
        let row = |&state: &usize| match column(state) {
            _ if noisy[state] || moving[state] => DENSE,
            Some(column) => column as u32,
            None => ZERO,
        };
        let mut sensitivity = vec![0.0; n * p];
        for (column, &state) in at.model.estimated.iter().enumerate() {
            sensitivity[place[state] * p + column] = 1.0;
        }
        let mut driven: Vec<u32> = dynamics.driven().map(|state| place[state] as u32).collect();
        driven.sort_unstable();
        let frame = StateFrame {
            n,
            p,
            r: noisy.iter().filter(|&&noisy| noisy).count(),
            rows: states.iter().map(row).collect(),
            sensitivity,
            driven,
            digest: 0,
        };
        Order { states, place, frame: Arc::new(frame.seal()) }
    }
}

/// States that noise ever reaches.
fn reachable(n: usize, dynamics: &Dynamics, start: &ModelStart, estimated: &[usize]) -> Vec<bool> {
    // depends[i * n + j]: x_i moves with x_j.
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
    close(&mut depends, n);
    (0..n).map(|i| noisy[i] || (0..n).any(|j| depends[i * n + j] && noisy[j])).collect()
}
