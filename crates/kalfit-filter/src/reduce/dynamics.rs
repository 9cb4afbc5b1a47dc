//! The motion of a model at α: the coefficients, and the components of states that depend on each other.

use crate::reduce::error::ReduceErrorKind;
use crate::reduce::subject::{Coefficient, Fault, ModelAt, Subject, Uses, reads_data};
use kalfit_model::{Motion, Scope};

/// Coefficients in slots: fixed values are stored, varying values are evaluated on each step.
#[derive(Debug, Clone, Default)]
pub struct Table {
    /// Value of each slot, 0 for a slot that varies.
    pub fixed: Vec<f64>,
    /// (Slot, coefficient, true for a variance) of each slot that varies.
    pub(crate) varying: Vec<(usize, Coefficient, bool)>,
    /// (Slot, coefficient) of each fixed slot that depends on free parameters.
    pub(crate) free: Vec<(usize, Coefficient)>,
}

impl Table {
    /// Adds a slot for a coefficient; `None` if the coefficient is zero.
    fn add(&mut self, coefficient: Coefficient, variance: bool) -> Option<usize> {
        if coefficient.is_zero() {
            return None;
        }
        let slot = self.fixed.len();
        self.fixed.push(coefficient.constant().unwrap_or(0.0));
        match coefficient {
            Coefficient::Fixed(_) => {}
            free @ Coefficient::Free(..) => self.free.push((slot, free)),
            varying @ Coefficient::Varying(..) => self.varying.push((slot, varying, variance)),
        }
        Some(slot)
    }

    /// Evaluates all slots on a row, into `values`.
    pub(crate) fn evaluate(
        &self,
        at: &ModelAt<'_>,
        scope: &Scope<'_>,
        values: &mut Vec<f64>,
    ) -> Result<(), Box<Fault>> {
        self.evaluate_some(at, scope, |_| true, values)
    }

    /// Evaluates the needed slots on a row, into `values`; a slot that varies and is not needed is 0.
    pub(crate) fn evaluate_some(
        &self,
        at: &ModelAt<'_>,
        scope: &Scope<'_>,
        needed: impl Fn(usize) -> bool,
        values: &mut Vec<f64>,
    ) -> Result<(), Box<Fault>> {
        values.clone_from(&self.fixed);
        for (slot, coefficient, variance) in self.varying.iter().filter(|(slot, ..)| needed(*slot)) {
            values[*slot] =
                if *variance { at.variance_value(coefficient, scope)? } else { at.value(coefficient, scope)? };
        }
        Ok(())
    }

    /// True if the value of the slot depends on the data.
    pub(crate) fn reads_data(&self, slot: usize) -> bool {
        self.varying.iter().any(|(s, coefficient, _)| *s == slot && reads_data(coefficient))
    }
}

/// F and Q, m × m by rows, from (i, j, slot) of each entry.
pub(crate) fn matrices(
    m: usize,
    [rates, noise]: [&[(usize, usize, usize)]; 2],
    value: impl Fn(usize) -> f64,
) -> (Vec<f64>, Vec<f64>) {
    let (mut f, mut q) = (vec![0.0; m * m], vec![0.0; m * m]);
    for &(i, j, slot) in rates {
        f[i * m + j] = value(slot);
    }
    for &(i, j, slot) in noise {
        q[i * m + j] = value(slot);
        q[j * m + i] = value(slot);
    }
    (f, q)
}

/// A set of states of continuous motion that depend on each other. Indices i, j count within the component.
#[derive(Debug, Clone, Default)]
pub struct Component {
    /// Indices of the m states in the model, ascending.
    pub states: Vec<usize>,
    /// (i, j, slot): dx_i/dt contains the coefficient times x_j.
    pub(crate) rates: Vec<(usize, usize, usize)>,
    /// (i, state, slot): dx_i/dt contains the coefficient times a state of the model that is constant over the step.
    pub(crate) held: Vec<(usize, usize, usize)>,
    /// (i, j, slot), i ≥ j: covariance of the driving noise.
    pub(crate) noise: Vec<(usize, usize, usize)>,
    /// Slot of the input of each state, in `Dynamics::inputs`.
    pub inputs: Vec<Option<usize>>,
    /// m × m by rows: true where entry (i, j) of exp(Fδ) can differ from entry (i, j) of the identity.
    pub(crate) closure: Vec<bool>,
}

/// A state of discrete motion.
#[derive(Debug, Clone)]
pub struct Recursion {
    pub state: usize,
    /// (state, slot) of each term, in ascending order of state.
    pub(crate) terms: Vec<(usize, usize)>,
    pub input: Option<usize>,
}

/// The motion of a model at α.
#[derive(Debug, Clone, Default)]
pub struct Dynamics {
    /// Coefficients of φ and Q.
    pub table: Table,
    /// Coefficients of known inputs.
    pub inputs: Table,
    pub components: Vec<Component>,
    pub recursions: Vec<Recursion>,
    /// (state, state, slot) of each variance and covariance of the noise of discrete motion, each pair once.
    pub(crate) noise: Vec<(usize, usize, usize)>,
    /// Columns that the coefficients read.
    pub(crate) uses: Uses,
}

impl Dynamics {
    pub(crate) fn new(at: &ModelAt<'_>) -> Result<Dynamics, Box<Fault>> {
        let mut dynamics = Dynamics::default();
        let covariances = dynamics.covariances(at)?;
        let continuous = |i: usize| matches!(at.model.states[i].motion, Motion::Continuous { .. });
        let n = at.model.states.len();
        let mut links: Vec<(usize, usize)> = covariances.iter().map(|&(i, j, _)| (i, j)).collect();
        let mut rates = Vec::new();
        for i in 0..n {
            match &at.model.states[i].motion {
                Motion::Constant => {}
                Motion::Continuous { derivative, noise_variance } => {
                    let subject = Subject::Derivative(i);
                    for (j, coefficient) in &derivative.terms {
                        let coefficient = at.coefficient(coefficient, subject)?;
                        if let Some(slot) = dynamics.slot(at, coefficient, false) {
                            rates.push((i, *j, slot));
                            links.push((i, *j));
                        }
                    }
                    dynamics.add_state_noise(at, i, noise_variance)?;
                }
                Motion::Discrete { next, noise_variance } => {
                    let mut terms = Vec::new();
                    for (j, coefficient) in &next.terms {
                        let coefficient = at.coefficient(coefficient, Subject::Next(i))?;
                        terms.extend(dynamics.slot(at, coefficient, false).map(|slot| (*j, slot)));
                    }
                    let input = dynamics.input(at, &next.constant, Subject::Next(i))?;
                    dynamics.recursions.push(Recursion { state: i, terms, input });
                    dynamics.add_state_noise(at, i, noise_variance)?;
                }
            }
        }
        dynamics.noise.extend(covariances);
        let nodes: Vec<usize> = (0..n).filter(|&i| continuous(i)).collect();
        for states in connected_components(&nodes, &links) {
            let component = dynamics.component(at, states, &rates)?;
            dynamics.components.push(component);
        }
        dynamics.noise.retain(|&(i, _, _)| !continuous(i)); // noise of continuous motion is in the components
        Ok(dynamics)
    }

    /// Indices of the states that a known input reaches within a step.
    pub(crate) fn driven(&self) -> impl Iterator<Item = usize> {
        let recursions = self.recursions.iter().filter(|recursion| recursion.input.is_some()).map(|r| r.state);
        let components = self.components.iter().flat_map(|component| {
            let m = component.states.len();
            let driven = move |&i: &usize| (0..m).any(|k| component.inputs[k].is_some() && component.depends(i, k));
            (0..m).filter(driven).map(|i| component.states[i])
        });
        recursions.chain(components)
    }

    /// True if noises of different states are correlated and a covariance varies from row to row.
    pub(crate) fn correlation_varies(&self) -> bool {
        let varies = |slot: usize| self.table.varying.iter().any(|(other, ..)| *other == slot);
        let mut noise = self.noise.iter().chain(self.components.iter().flat_map(|component| &component.noise));
        noise.any(|&(i, j, slot)| i != j && varies(slot))
    }

    fn slot(&mut self, at: &ModelAt<'_>, coefficient: Coefficient, variance: bool) -> Option<usize> {
        self.uses.add(&coefficient, at.alpha);
        self.table.add(coefficient, variance)
    }

    fn input(
        &mut self,
        at: &ModelAt<'_>,
        constant: &kalfit_model::Expression,
        subject: Subject,
    ) -> Result<Option<usize>, Box<Fault>> {
        let coefficient = at.coefficient(constant, subject)?;
        self.uses.add(&coefficient, at.alpha);
        Ok(self.inputs.add(coefficient, false))
    }

    fn add_state_noise(
        &mut self,
        at: &ModelAt<'_>,
        i: usize,
        variance: &kalfit_model::Expression,
    ) -> Result<(), Box<Fault>> {
        let coefficient = at.variance(variance, Subject::ProcessNoise(i))?;
        if let Some(slot) = self.slot(at, coefficient, true) {
            self.noise.push((i, i, slot));
        }
        Ok(())
    }

    /// (State, state, slot) of each `process_noise_covariance` of the model, checked.
    fn covariances(&mut self, at: &ModelAt<'_>) -> Result<Vec<(usize, usize, usize)>, Box<Fault>> {
        let mut found = Vec::new();
        for (i, j, expression) in &at.model.process_noise_covariance {
            let (i, j) = (*i, *j);
            let subject = Subject::ProcessCovariance(i, j);
            let name = |i: usize| at.model.states[i].name.clone();
            let continuous = |i: usize| matches!(at.model.states[i].motion, Motion::Continuous { .. });
            if i == j {
                return Err(Fault::new(subject, ReduceErrorKind::SelfCovariance { name: name(i) }));
            }
            if continuous(i) != continuous(j) {
                let (a, b) = if continuous(i) { (i, j) } else { (j, i) };
                let kind = ReduceErrorKind::MixedCovariance { continuous: name(a), discrete: name(b) };
                return Err(Fault::new(subject, kind));
            }
            let coefficient = at.coefficient(expression, subject)?;
            if let Some(slot) = self.slot(at, coefficient, false) {
                found.push((i, j, slot));
            }
        }
        Ok(found)
    }

    fn component(
        &mut self,
        at: &ModelAt<'_>,
        states: Vec<usize>,
        rates: &[(usize, usize, usize)],
    ) -> Result<Component, Box<Fault>> {
        let m = states.len();
        let index_in_component = |state: usize| states.binary_search(&state).ok();
        let mut component = Component { closure: vec![false; m * m], ..Component::default() };
        for &(i, j, slot) in rates {
            let Some(row) = index_in_component(i) else { continue };
            match index_in_component(j) {
                Some(column) => {
                    component.rates.push((row, column, slot));
                    component.closure[row * m + column] = true;
                }
                None => component.held.push((row, j, slot)),
            }
        }
        for &(i, j, slot) in &self.noise {
            if let (Some(i), Some(j)) = (index_in_component(i), index_in_component(j)) {
                component.noise.push((i.max(j), i.min(j), slot));
            }
        }
        for &state in &states {
            let Motion::Continuous { derivative, .. } = &at.model.states[state].motion else { continue };
            let input = self.input(at, &derivative.constant, Subject::Derivative(state))?;
            component.inputs.push(input);
        }
        // `closure` lacks the diagonal of the identity: `Component::is_identity_row` needs true dependences only, and
        // `depends` adds the diagonal
        close_transitively(&mut component.closure, m);
        component.states = states;
        Ok(component)
    }
}

impl Component {
    /// True if row i of φ is a row of the identity.
    pub(crate) fn is_identity_row(&self, i: usize) -> bool {
        let m = self.states.len();
        !self.closure[i * m..][..m].contains(&true) && self.held.iter().all(|&(row, ..)| row != i)
    }

    /// True if entry (i, j) of φ or Γ can differ from zero.
    pub(crate) fn depends(&self, i: usize, j: usize) -> bool {
        i == j || self.closure[i * self.states.len() + j]
    }
}

/// Replaces a relation `reach`, m × m by rows, by the transitive closure: `reach` i → k and k → j gives i → j.
pub(crate) fn close_transitively(reach: &mut [bool], m: usize) {
    for k in 0..m {
        for i in 0..m {
            if reach[i * m + k] {
                for j in 0..m {
                    reach[i * m + j] |= reach[k * m + j];
                }
            }
        }
    }
}

/// The connected components of `nodes` (ascending) under `links`; links to other nodes do not count.
pub(crate) fn connected_components(nodes: &[usize], links: &[(usize, usize)]) -> Vec<Vec<usize>> {
    let mut set: Vec<usize> = (0..nodes.len()).collect();
    for (i, j) in links {
        if let (Ok(i), Ok(j)) = (nodes.binary_search(i), nodes.binary_search(j)) {
            let (keep, drop) = (set[i].min(set[j]), set[i].max(set[j]));
            set.iter_mut().filter(|s| **s == drop).for_each(|s| *s = keep);
        }
    }
    let members = |s: usize| {
        nodes.iter().zip(&set).filter(|&(_, set_of_node)| *set_of_node == s).map(|(&node, _)| node).collect()
    };
    (0..nodes.len()).map(members).filter(|members: &Vec<usize>| !members.is_empty()).collect()
}
