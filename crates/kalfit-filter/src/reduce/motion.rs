//! The transitions of a model's steps.

mod backward;
mod fill;
mod pull;

use std::sync::Arc;

use crate::reduce::design::{Pattern, Transition, TransitionRow};
use crate::reduce::dynamics::{Component, Dynamics, Recursion, matrices};
use crate::reduce::error::ReduceErrorKind;
use crate::reduce::order::Order;
use crate::reduce::semidefinite::ldl;
use crate::reduce::subject::{Fault, Subject};
use kalfit_algebra::exponential::flow;

pub use backward::Evaluated;
pub use fill::Filled;
pub(crate) use fill::{MotionColumns, Transitions};
pub use pull::MotionPullback;

/// How the entries of φ, Q and b follow from coefficients and from the flows of components. The flows are concatenated:
/// φ, Γ, Q of the first component, each m × m, then those of the next component.
#[derive(Debug, Clone)]
pub struct MotionPlan {
    pattern: Arc<Pattern>,
    phi: Vec<EntrySource>,
    q: Vec<EntrySource>,
    /// Source of b for each state of [`StateFrame::driven`](crate::reduce::design::StateFrame::driven).
    drives: Vec<InputSource>,
    /// Index at which each component's flow begins.
    offsets: Vec<usize>,
    /// Number of entries in the flows of all components together.
    pub(crate) flow_len: usize,
    /// The components that consist of a single state.
    singles: Vec<Single>,
    /// Entry of the identity matrix at the row and column of each entry of φ.
    identity: Vec<f64>,
}

/// A component that consists of one state.
#[derive(Debug, Clone)]
struct Single {
    /// Index at which the flow of the component begins.
    offset: usize,
    /// Slots of the component's rate and noise among the dynamics' coefficients; `None` without a rate, or without
    /// noise.
    rate: Option<usize>,
    noise: Option<usize>,
}

/// Source of an entry of φ or Q.
#[derive(Debug, Clone, PartialEq, Eq)]
enum EntrySource {
    /// Slot of a coefficient.
    Slot(usize),
    /// Index of an entry in the flows.
    Flow(usize),
    /// Σ (entry of a flow) × coefficient, an entry of ΓG: the effect of states that are held constant over the step.
    Held(Vec<(usize, usize)>),
}

/// Source of a known input.
#[derive(Debug, Clone, PartialEq, Eq)]
enum InputSource {
    /// A slot of the inputs.
    Slot(usize),
    /// Σ (entry of a flow) × (slot of the inputs), an element of Γu.
    Flow(Vec<(usize, usize)>),
}

/// Transition of a step, without the inputs of the step.
#[derive(Debug, Clone)]
pub struct Moves {
    /// φ and Q of the step.
    pub transition: Arc<Transition>,
    /// The flows of the components; empty where no input is multiplied by a flow.
    flows: Vec<f64>,
}

/// How a state of the model moves.
enum StateMotion<'a> {
    Still,
    Recursion(&'a Recursion),
    /// State `i` of component `c`, as (c, component, i).
    Component(usize, &'a Component, usize),
}

fn state_motion(dynamics: &Dynamics, state: usize) -> StateMotion<'_> {
    if let Some(recursion) = dynamics.recursions.iter().find(|recursion| recursion.state == state) {
        return StateMotion::Recursion(recursion);
    }
    for (c, component) in dynamics.components.iter().enumerate() {
        if let Ok(i) = component.states.binary_search(&state) {
            return StateMotion::Component(c, component, i);
        }
    }
    StateMotion::Still
}

impl MotionPlan {
    /// A transition with φ = 0 and Q = 0.
    pub(crate) fn blank(&self) -> Transition {
        Transition::new(self.pattern.clone(), vec![0.0; self.phi.len()], vec![0.0; self.q.len()])
    }

    pub(crate) fn new(dynamics: &Dynamics, order: &Order) -> MotionPlan {
        let mut offsets = Vec::new();
        let mut flow_len = 0;
        for component in &dynamics.components {
            offsets.push(flow_len);
            flow_len += 3 * component.states.len().pow(2);
        }
        let (mut pattern, mut phi, mut drives) = (Pattern::default(), Vec::new(), Vec::new());
        for (place, &state) in order.states.iter().enumerate() {
            let state_motion = state_motion(dynamics, state);
            if let Some(mut row) = phi_row(&state_motion, &offsets, order) {
                row.sort_by_key(|term| term.0);
                pattern.push(place, order.frame.r, row.iter().map(|term| term.0));
                phi.extend(row.into_iter().map(|term| term.1));
            }
            if order.frame.driven.contains(&(place as u32)) {
                drives.push(drive(&state_motion, &offsets));
            }
        }
        let mut noise = noise_entries(dynamics, order, &offsets);
        noise.sort_by_key(|entry| entry.0);
        pattern.pairs = noise.iter().map(|entry| entry.0).collect();
        let q = noise.into_iter().map(|entry| entry.1).collect();
        let (singles, pattern) = (singles(dynamics, &offsets), pattern.seal());
        let identity = identity(&pattern);
        MotionPlan { pattern: Arc::new(pattern), phi, q, drives, offsets, flow_len, singles, identity }
    }

    /// Whether no state ever moves, so that a transition would change nothing.
    pub(crate) fn is_still(&self) -> bool {
        self.pattern.moved.is_empty() && self.pattern.pairs.is_empty() && self.drives.is_empty()
    }

    /// φ, Q and Γ of steps of length `dt`, with the same bits as in lanes. `values`: the dynamics' coefficients on the
    /// step; `filled`: work space; `reusable`: an unshared transition whose memory is reused.
    pub fn moves(
        &self,
        dynamics: &Dynamics,
        values: &[f64],
        dt: f64,
        (filled, reusable): (&mut Filled, Option<Arc<Transition>>),
    ) -> Result<Moves, Box<Fault>> {
        check_noise(dynamics, values)?;
        if !self.fill_one(dynamics, values, dt, filled) {
            return Err(self.overflow(dynamics, filled));
        }
        let new_transition = || Arc::new(Transition::new(self.pattern.clone(), Vec::new(), Vec::new()));
        let mut shared_transition = reusable.unwrap_or_else(new_transition);
        let transition = Arc::get_mut(&mut shared_transition).expect("nobody else has it");
        transition.phi.clear();
        transition.phi.extend_from_slice(&filled.phi);
        transition.q.clear();
        transition.q.extend_from_slice(&filled.q);
        let kept = self.drives.iter().any(|drive| matches!(drive, InputSource::Flow(_)));
        Ok(Moves { transition: shared_transition, flows: if kept { filled.flows.clone() } else { Vec::new() } })
    }

    /// The fault of a step that is not finite: the first component whose flow overflows, else the transition as a
    /// whole.
    fn overflow(&self, dynamics: &Dynamics, filled: &Filled) -> Box<Fault> {
        let is_not_finite = |&(component, &offset): &(&Component, &usize)| {
            let numbers = offset..offset + 3 * component.states.len().pow(2);
            filled.flows[numbers].iter().any(|x| !x.is_finite())
        };
        let bad = dynamics.components.iter().zip(&self.offsets).find(is_not_finite);
        let subject = bad.map_or(Subject::Transition, |(component, _)| Subject::Derivative(component.states[0]));
        Fault::new(subject, ReduceErrorKind::NotFinite)
    }
}

/// The components that consist of a single state, with slots and offsets.
fn singles(dynamics: &Dynamics, offsets: &[usize]) -> Vec<Single> {
    let slot = |terms: &[(usize, usize, usize)]| terms.first().map(|&(.., slot)| slot);
    let components = dynamics.components.iter().zip(offsets).filter(|(component, _)| component.states.len() == 1);
    let single = |(component, &offset): (&Component, &usize)| Single {
        offset,
        rate: slot(&component.rates),
        noise: slot(&component.noise),
    };
    components.map(single).collect()
}

/// Entry of the identity matrix at the row and column of each entry of φ.
fn identity(pattern: &Pattern) -> Vec<f64> {
    let identity_row = |row: &TransitionRow| {
        let terms = &pattern.columns[row.start as usize..row.end as usize];
        terms.iter().map(|&column| f64::from(u8::from(column == row.state))).collect::<Vec<f64>>()
    };
    pattern.moved.iter().flat_map(identity_row).collect()
}

/// Row of φ as (kernel index, source of the entry); `None` for a row of the identity.
fn phi_row(state_motion: &StateMotion<'_>, offsets: &[usize], order: &Order) -> Option<Vec<(usize, EntrySource)>> {
    match *state_motion {
        StateMotion::Recursion(recursion) => {
            Some(recursion.terms.iter().map(|&(state, slot)| (order.place[state], EntrySource::Slot(slot))).collect())
        }
        StateMotion::Component(c, component, i) if !component.is_identity_row(i) => {
            let m = component.states.len();
            let inner = (0..m).filter(|&j| component.depends(i, j));
            let mut row: Vec<(usize, EntrySource)> =
                inner.map(|j| (order.place[component.states[j]], EntrySource::Flow(offsets[c] + i * m + j))).collect();
            for &(k, state, slot) in component.held.iter().filter(|&&(k, ..)| component.depends(i, k)) {
                let term = (offsets[c] + m * m + i * m + k, slot);
                match row.iter_mut().find(|(place, _)| *place == order.place[state]) {
                    Some((_, EntrySource::Held(terms))) => terms.push(term),
                    _ => row.push((order.place[state], EntrySource::Held(vec![term]))),
                }
            }
            Some(row)
        }
        _ => None,
    }
}

fn drive(state_motion: &StateMotion<'_>, offsets: &[usize]) -> InputSource {
    match *state_motion {
        StateMotion::Recursion(Recursion { input: Some(slot), .. }) => InputSource::Slot(*slot),
        StateMotion::Component(c, component, i) => {
            let m = component.states.len();
            let term = |k: usize| Some((offsets[c] + m * m + i * m + k, component.inputs[k]?));
            InputSource::Flow((0..m).filter(|&k| component.depends(i, k)).filter_map(term).collect())
        }
        _ => InputSource::Flow(Vec::new()),
    }
}

/// ((i, j), source) of each entry i ≥ j of Q that can be nonzero, in kernel indices.
fn noise_entries(dynamics: &Dynamics, order: &Order, offsets: &[usize]) -> Vec<((u32, u32), EntrySource)> {
    let pair = |a: usize, b: usize| {
        let (a, b) = (order.place[a], order.place[b]);
        (a.max(b) as u32, a.min(b) as u32)
    };
    let mut entries: Vec<_> =
        dynamics.noise.iter().map(|&(i, j, slot)| (pair(i, j), EntrySource::Slot(slot))).collect();
    for (component, &offset) in dynamics.components.iter().zip(offsets) {
        let m = component.states.len();
        for i in 0..m {
            for j in 0..=i {
                let reaches = |k: usize, l: usize| component.depends(i, k) && component.depends(j, l);
                if component.noise.iter().any(|&(k, l, _)| reaches(k, l) || reaches(l, k)) {
                    let at = offset + 2 * m * m + i * m + j;
                    entries.push((pair(component.states[i], component.states[j]), EntrySource::Flow(at)));
                }
            }
        }
    }
    entries
}

/// Appends φ, Γ and Q of a component.
fn append_flow(
    component: &Component,
    value: impl Fn(usize) -> f64,
    dt: f64,
    flows: &mut Vec<f64>,
) -> Result<(), Box<Fault>> {
    let m = component.states.len();
    let (f, q) = matrices(m, [&component.rates, &component.noise], value);
    let fault = |_| Fault::new(Subject::Derivative(component.states[0]), ReduceErrorKind::NotFinite);
    let flow = flow(&f, &q, m, dt).map_err(fault)?;
    [flow.phi, flow.gamma, flow.q].iter().for_each(|matrix| flows.extend(matrix));
    Ok(())
}

/// Checks that the covariance of correlated noises is positive semidefinite; single variances were checked before.
fn check_noise(dynamics: &Dynamics, values: &[f64]) -> Result<(), Box<Fault>> {
    semidefinite(&dynamics.noise, values, |state| state)?;
    dynamics.components.iter().try_for_each(|c| semidefinite(&c.noise, values, |i| c.states[i]))
}

fn semidefinite(
    noise: &[(usize, usize, usize)],
    values: &[f64],
    name: impl Fn(usize) -> usize,
) -> Result<(), Box<Fault>> {
    if noise.iter().all(|(i, j, _)| i == j) {
        return Ok(());
    }
    let mut states: Vec<usize> = noise.iter().flat_map(|&(i, j, _)| [i, j]).collect();
    states.sort_unstable();
    states.dedup();
    let m = states.len();
    let local = |state: &usize| states.binary_search(state).expect("every state of the noise is listed");
    let mut q = vec![0.0; m * m];
    for (i, j, slot) in noise {
        let (i, j) = (local(i), local(j));
        q[i.max(j) * m + i.min(j)] = values[*slot];
    }
    ldl(&mut q, m).map_err(|bad| Fault::new(Subject::ProcessNoise(name(states[0])), bad))
}
