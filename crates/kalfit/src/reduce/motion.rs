//! The kernel order of a model's states, and the transitions of its steps.

use std::sync::Arc;

use crate::linalg::exponential::{Flow, flow};
use crate::reduce::design::{DENSE, Frame, Transition, ZERO};
use crate::reduce::dynamics::{Component, Dynamics, close};
use crate::reduce::error::ReduceErrorKind;
use crate::reduce::semidefinite::ldl;
use crate::reduce::start::Start;
use crate::reduce::subject::{At, Fault, Subject};

/// Where states stand in the kernels, and what drives them.
#[derive(Debug, Clone)]
pub(crate) struct Order {
    /// Kernel index of each state of the model.
    pub(crate) place: Vec<usize>,
    pub(crate) frame: Arc<Frame>,
    /// What drives each state of [`Frame::driven`].
    drives: Vec<Drive>,
}

/// Where a known input comes from.
#[derive(Debug, Clone, Copy)]
enum Drive {
    /// This slot of the inputs.
    Slot(usize),
    /// Row `i` of Γ times the inputs of a component.
    Flow { component: usize, i: usize },
}

/// What a step does to the states, whatever its inputs.
#[derive(Debug, Clone)]
pub(crate) struct Moves {
    pub(crate) transition: Arc<Transition>,
    /// Γ of each component.
    gammas: Vec<Vec<f64>>,
}

impl Order {
    pub(crate) fn new(at: &At<'_>, dynamics: &Dynamics, start: &Start) -> Order {
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
        let mut drives = drives(dynamics, &place);
        drives.sort_by_key(|drive| drive.0);
        let frame = Frame {
            n,
            p,
            r: noisy.iter().filter(|&&noisy| noisy).count(),
            rows: states.iter().map(row).collect(),
            sensitivity,
            driven: drives.iter().map(|drive| drive.0).collect(),
            digest: 0,
        };
        Order { place, frame: Arc::new(frame.seal()), drives: drives.into_iter().map(|drive| drive.1).collect() }
    }

    /// Appends b of the driven states. `inputs`: values of the dynamics' inputs.
    pub(crate) fn inputs(&self, dynamics: &Dynamics, moves: &Moves, inputs: &[f64], out: &mut Vec<f64>) {
        for drive in &self.drives {
            out.push(match *drive {
                Drive::Slot(slot) => inputs[slot],
                Drive::Flow { component, i } => {
                    let gamma = &moves.gammas[component];
                    let component = &dynamics.components[component];
                    let m = component.states.len();
                    let term =
                        |(k, slot): (usize, &Option<usize>)| slot.map_or(0.0, |slot| gamma[i * m + k] * inputs[slot]);
                    component.inputs.iter().enumerate().map(term).sum()
                }
            });
        }
    }
}

/// States that noise ever reaches.
fn reachable(n: usize, dynamics: &Dynamics, start: &Start, estimated: &[usize]) -> Vec<bool> {
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

fn drives(dynamics: &Dynamics, place: &[usize]) -> Vec<(u32, Drive)> {
    let mut drives = Vec::new();
    for recursion in &dynamics.recursions {
        drives.extend(recursion.input.map(|slot| (place[recursion.state] as u32, Drive::Slot(slot))));
    }
    for (c, component) in dynamics.components.iter().enumerate() {
        for (i, &state) in component.states.iter().enumerate() {
            if component.inputs.iter().enumerate().any(|(k, input)| input.is_some() && component.depends(i, k)) {
                drives.push((place[state] as u32, Drive::Flow { component: c, i }));
            }
        }
    }
    drives
}

/// φ, Q and Γ of a step of length `dt`. `values`: the dynamics' coefficients on the step.
pub(crate) fn moves(dynamics: &Dynamics, order: &Order, values: &[f64], dt: f64) -> Result<Moves, Box<Fault>> {
    let r = order.frame.r;
    let place = |state: usize| order.place[state];
    let mut rows: Vec<(usize, Vec<(usize, f64)>)> = Vec::new();
    let mut noise: Vec<(usize, usize, f64)> = Vec::new();
    let mut gammas = Vec::with_capacity(dynamics.components.len());
    for recursion in &dynamics.recursions {
        let terms = recursion.terms.iter().map(|&(state, slot)| (place(state), values[slot])).collect();
        rows.push((place(recursion.state), terms));
    }
    discrete_noise(dynamics, values, &mut |i, j, q| noise.push((place(i), place(j), q)))?;
    for component in &dynamics.components {
        let flow = component_flow(component, values, dt)?;
        let m = component.states.len();
        for i in (0..m).filter(|&i| !component.still(i)) {
            rows.push((place(component.states[i]), component_row(component, &flow, values, i, place)));
        }
        for (i, &state) in component.states.iter().enumerate() {
            for (j, &other) in component.states[..=i].iter().enumerate() {
                if flow.q[i * m + j] != 0.0 {
                    noise.push((place(state), place(other), flow.q[i * m + j]));
                }
            }
        }
        gammas.push(flow.gamma);
    }
    rows.sort_by_key(|row| row.0);
    let mut transition = Transition::empty();
    for (state, terms) in &mut rows {
        terms.sort_by_key(|term| term.0);
        if terms.iter().any(|term| !term.1.is_finite()) {
            return Err(Fault::new(Subject::Transition, ReduceErrorKind::NotFinite));
        }
        transition.push(*state, r, terms);
    }
    let mut noise: Vec<(u32, u32, f64)> =
        noise.into_iter().map(|(i, j, q)| (i.max(j) as u32, i.min(j) as u32, q)).collect();
    noise.sort_by_key(|&(i, j, _)| (i, j));
    transition.pairs.extend(noise.iter().map(|&(i, j, _)| (i, j)));
    transition.q.extend(noise.iter().map(|&(.., q)| q));
    Ok(Moves { transition: Arc::new(transition.seal()), gammas })
}

/// Row i of φ: exp(Fδ) on the component, ΓG on what is held over the step.
fn component_row(
    component: &Component,
    flow: &Flow,
    values: &[f64],
    i: usize,
    place: impl Fn(usize) -> usize,
) -> Vec<(usize, f64)> {
    let m = component.states.len();
    let mut terms: Vec<(usize, f64)> = (0..m)
        .filter(|&j| component.depends(i, j))
        .map(|j| (place(component.states[j]), flow.phi[i * m + j]))
        .collect();
    for &(k, state, slot) in component.held.iter().filter(|&&(k, ..)| component.depends(i, k)) {
        let value = flow.gamma[i * m + k] * values[slot];
        match terms.iter_mut().find(|term| term.0 == place(state)) {
            Some(term) => term.1 += value,
            None => terms.push((place(state), value)),
        }
    }
    terms
}

fn component_flow(component: &Component, values: &[f64], dt: f64) -> Result<Flow, Box<Fault>> {
    let m = component.states.len();
    let (mut f, mut q) = (vec![0.0; m * m], vec![0.0; m * m]);
    for &(i, j, slot) in &component.rates {
        f[i * m + j] = values[slot];
    }
    for &(i, j, slot) in &component.noise {
        q[i * m + j] = values[slot];
        q[j * m + i] = values[slot];
    }
    semidefinite(&q, m, Subject::ProcessNoise(component.states[0]))?;
    flow(&f, &q, m, dt).map_err(|_| Fault::new(Subject::Derivative(component.states[0]), ReduceErrorKind::NotFinite))
}

/// Checks the noise of discrete motion and gives its entries that are not zero.
fn discrete_noise(
    dynamics: &Dynamics,
    values: &[f64],
    give: &mut dyn FnMut(usize, usize, f64),
) -> Result<(), Box<Fault>> {
    let mut states: Vec<usize> = dynamics.noise.iter().flat_map(|&(i, j, _)| [i, j]).collect();
    states.sort_unstable();
    states.dedup();
    let m = states.len();
    let mut q = vec![0.0; m * m];
    for &(i, j, slot) in &dynamics.noise {
        let local = |state| states.binary_search(&state).expect("every state of the noise is listed");
        q[local(i).max(local(j)) * m + local(i).min(local(j))] = values[slot];
        if values[slot] != 0.0 {
            give(i, j, values[slot]);
        }
    }
    states.first().map_or(Ok(()), |&state| semidefinite(&q, m, Subject::ProcessNoise(state)))
}

fn semidefinite(q: &[f64], m: usize, subject: Subject) -> Result<(), Box<Fault>> {
    ldl(&mut q.to_vec(), m)
        .map_err(|bad| Fault::new(subject, ReduceErrorKind::NotSemidefinite { left: bad.left, variance: bad.variance }))
}
