//! The start of a model at α: x_0 = a + Aξ + ζ.

mod backward;

use nalgebra::{DMatrix, DVector};

use crate::reduce::dynamics::{Dynamics, connected_components, matrices};
use crate::reduce::error::ReduceErrorKind;
use crate::reduce::semidefinite::ldl;
use crate::reduce::subject::{Coefficient, Fault, ModelAt, Subject, Uses};
use kalfit_algebra::exponential::{FlowError, stationary, stationary_discrete};
use kalfit_model::{Initial, Motion, Scope};

pub(crate) use backward::{LawAdjoint, StartAdjoint};

/// The start of a model. States are numbered as in the model.
#[derive(Debug, Clone, Default)]
pub struct ModelStart {
    /// (state, offset) of each state with a known offset, which is added to the mean of the state.
    offsets: Vec<(usize, Coefficient)>,
    /// (state, mean, variance) of each state with a known start.
    known: Vec<(usize, Coefficient, Coefficient)>,
    /// (i, j, covariance): known covariance of elements i ≥ j of ξ.
    covariance: Vec<(usize, usize, Coefficient)>,
    groups: Vec<StationaryGroup>,
    /// Whether the estimated states also have a law, which comes with each test.
    pub(crate) has_per_test_law: bool,
    /// Time of x_0.
    pub(crate) initial_time: Option<Coefficient>,
    /// Columns that must be constant within a test.
    pub(crate) uses: Uses,
    /// Whether no coefficient of the start varies.
    pub(crate) fixed: bool,
}

/// Stationary states that depend on each other. Indices i, j count within the group; slots refer to the dynamics'
/// tables.
#[derive(Debug, Clone)]
struct StationaryGroup {
    states: Vec<usize>,
    continuous: bool,
    motion: Vec<(usize, usize, usize)>,
    noise: Vec<(usize, usize, usize)>,
    inputs: Vec<(usize, usize)>,
}

/// a and P0, by state of the model.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StartMoments {
    /// a, n numbers.
    pub mean: Vec<f64>,
    /// (state, state, covariance), each pair once.
    pub covariance: Vec<(usize, usize, f64)>,
}

impl ModelStart {
    pub(crate) fn new(at: &ModelAt<'_>, dynamics: &Dynamics) -> Result<ModelStart, Box<Fault>> {
        let mut start = ModelStart::default();
        let mut stationary_states = Vec::new();
        for (i, state) in at.model.states.iter().enumerate() {
            if let Some(offset) = &state.offset {
                start.offsets.push((i, at.coefficient(offset, Subject::Offset(i))?));
            }
            match &state.initial {
                Initial::Estimated => {}
                Initial::Stationary => stationary_states.push(i),
                Initial::Known { mean, variance } => {
                    let mean = at.coefficient(mean, Subject::InitialMean(i))?;
                    start.known.push((i, mean, at.variance(variance, Subject::InitialVariance(i))?));
                }
            }
        }
        for (i, row) in at.model.covariance.known.iter().flatten().enumerate() {
            for (j, entry) in row.iter().enumerate().take(i + 1) {
                let entry = at.coefficient(entry, Subject::KnownCovariance)?;
                if !entry.is_zero() {
                    start.covariance.push((i, j, entry));
                }
            }
        }
        if start.covariance.iter().all(|(.., entry)| entry.constant().is_some()) {
            let scope = Scope { numbers: &[], texts: &[], step: 0.0, alpha: at.alpha };
            start.add_known_covariance(at, &scope, &mut StartMoments::default())?; // the same for every test
        }
        if let Some(time) = &at.model.clock.initial_time {
            if at.model.clock.time.is_none() {
                return Err(Fault::new(Subject::InitialTime, ReduceErrorKind::InitialTimeWithoutTime));
            }
            start.initial_time = Some(at.coefficient(time, Subject::InitialTime)?);
        }
        start.groups = groups(at, dynamics, &stationary_states)?;
        let coefficients: Vec<&Coefficient> = start.coefficients().collect();
        let mut uses = Uses::default();
        coefficients.iter().for_each(|coefficient| uses.add(coefficient, at.alpha));
        start.fixed = coefficients.iter().all(|coefficient| coefficient.constant().is_some());
        start.initial_time.iter().for_each(|coefficient| uses.add(coefficient, at.alpha));
        at.model.mean.regression.iter().for_each(|regression| uses.number(regression.column));
        start.uses = uses;
        Ok(start)
    }

    /// All coefficients: mean and variance of each known start, then offsets, then known covariances.
    pub(crate) fn coefficients(&self) -> impl Iterator<Item = &Coefficient> {
        let known = self.known.iter().flat_map(|(_, mean, variance)| [mean, variance]);
        known.chain(self.offsets.iter().map(|(_, c)| c)).chain(self.covariance.iter().map(|(.., c)| c))
    }

    /// States whose x_0 is noisy.
    pub(crate) fn noisy(&self, estimated: &[usize]) -> Vec<usize> {
        let known = self.known.iter().filter(|(.., variance)| !variance.is_zero()).map(|&(state, ..)| state);
        let added = self.covariance.iter().flat_map(|&(i, j, _)| [estimated[i], estimated[j]]);
        let has_per_test_law = estimated.iter().copied().filter(|_| self.has_per_test_law);
        known
            .chain(added)
            .chain(has_per_test_law)
            .chain(self.groups.iter().flat_map(|group| group.states.iter().copied()))
            .collect()
    }

    /// True when the law needs the dynamics' coefficients.
    pub(crate) fn has_stationary_states(&self) -> bool {
        !self.groups.is_empty()
    }

    /// Whether the law needs this slot of the dynamics' coefficients. Coefficients of other states are not evaluated
    /// for the law: the cells of such coefficients may be empty on a first row to which no step leads.
    pub(crate) fn needs(&self, slot: usize) -> bool {
        let of = |terms: &[(usize, usize, usize)]| terms.iter().any(|term| term.2 == slot);
        self.groups.iter().any(|group| of(&group.motion) || of(&group.noise))
    }

    /// Whether the law needs this slot of the dynamics' inputs.
    pub(crate) fn needs_input(&self, slot: usize) -> bool {
        self.groups.iter().any(|group| group.inputs.iter().any(|input| input.1 == slot))
    }

    /// The law of x_0. `values`, `inputs`: the dynamics' tables on the first row.
    pub fn law(
        &self,
        at: &ModelAt<'_>,
        scope: &Scope<'_>,
        values: &[f64],
        inputs: &[f64],
    ) -> Result<StartMoments, Box<Fault>> {
        let mut law = StartMoments { mean: vec![0.0; at.model.states.len()], covariance: Vec::new() };
        for (state, mean, variance) in &self.known {
            law.mean[*state] = at.value(mean, scope)?;
            law.covariance.push((*state, *state, at.variance_value(variance, scope)?));
        }
        self.add_known_covariance(at, scope, &mut law)?;
        for group in &self.groups {
            group.settle(at, values, inputs, &mut law)?;
        }
        for (state, offset) in &self.offsets {
            law.mean[*state] += at.value(offset, scope)?;
        }
        Ok(law)
    }

    fn add_known_covariance(
        &self,
        at: &ModelAt<'_>,
        scope: &Scope<'_>,
        law: &mut StartMoments,
    ) -> Result<(), Box<Fault>> {
        if self.covariance.is_empty() {
            return Ok(());
        }
        let p = at.model.estimated.len();
        let mut matrix = vec![0.0; p * p];
        for (i, j, entry) in &self.covariance {
            let value = at.value(entry, scope)?;
            matrix[i * p + j] = value;
            law.covariance.push((at.model.estimated[*i], at.model.estimated[*j], value));
        }
        ldl(&mut matrix, p).map_err(|bad| Fault::new(Subject::KnownCovariance, bad))
    }
}

/// The groups of stationary states; the states of a group must depend on no other states.
fn groups(
    at: &ModelAt<'_>,
    dynamics: &Dynamics,
    stationary_states: &[usize],
) -> Result<Vec<StationaryGroup>, Box<Fault>> {
    let name = |i: usize| at.model.states[i].name.clone();
    let continuous = |i: usize| matches!(at.model.states[i].motion, Motion::Continuous { .. });
    let mut motion: Vec<(usize, usize, usize)> = Vec::new();
    let mut noise = dynamics.noise.clone();
    for component in &dynamics.components {
        let state = |i: usize| component.states[i];
        motion.extend(component.rates.iter().map(|&(i, j, slot)| (state(i), state(j), slot)));
        motion.extend(component.held.iter().map(|&(i, j, slot)| (state(i), j, slot)));
        noise.extend(component.noise.iter().map(|&(i, j, slot)| (state(i), state(j), slot)));
    }
    for recursion in &dynamics.recursions {
        motion.extend(recursion.terms.iter().map(|&(j, slot)| (recursion.state, j, slot)));
    }
    if let Some(&still) = stationary_states.iter().find(|&&i| at.model.states[i].motion == Motion::Constant) {
        let kind = ReduceErrorKind::Unstable { states: vec![name(still)] };
        return Err(Fault::new(Subject::StationaryLaw(still), kind));
    }
    motion.retain(|(i, ..)| stationary_states.contains(i));
    for &(i, j, _) in &motion {
        if !stationary_states.contains(&j) {
            let kind = ReduceErrorKind::StationaryOpen { state: name(i), other: name(j) };
            return Err(Fault::new(Subject::StationaryLaw(i), kind));
        }
        if continuous(i) != continuous(j) {
            let kind = ReduceErrorKind::StationaryMixed { state: name(i), other: name(j) };
            return Err(Fault::new(Subject::StationaryLaw(i), kind));
        }
    }
    noise.retain(|(i, j, _)| stationary_states.contains(i) && stationary_states.contains(j));
    let links: Vec<(usize, usize)> = motion.iter().chain(&noise).map(|&(i, j, _)| (i, j)).collect();
    let group = |states: Vec<usize>| {
        let local = |of: &[(usize, usize, usize)]| -> Vec<(usize, usize, usize)> {
            let find = |i: &usize| states.binary_search(i).ok();
            of.iter().filter_map(|(i, j, slot)| Some((find(i)?, find(j)?, *slot))).collect()
        };
        let (motion, noise) = (local(&motion), local(&noise));
        let inputs = inputs_of(dynamics, &states);
        StationaryGroup { continuous: continuous(states[0]), motion, noise, inputs, states }
    };
    let groups: Vec<StationaryGroup> = connected_components(stationary_states, &links).into_iter().map(group).collect();
    for group in &groups {
        for &(i, slot) in &group.inputs {
            if dynamics.inputs.reads_data(slot) {
                let kind = ReduceErrorKind::StationaryInput { state: name(group.states[i]) };
                return Err(Fault::new(Subject::StationaryLaw(group.states[i]), kind));
            }
        }
    }
    Ok(groups)
}

/// (i, slot) of the inputs of `states`, with i counted within `states`.
fn inputs_of(dynamics: &Dynamics, states: &[usize]) -> Vec<(usize, usize)> {
    let local = |state: usize| states.binary_search(&state).ok();
    let components = dynamics.components.iter().flat_map(|c| c.states.iter().copied().zip(c.inputs.iter().copied()));
    let recursions = dynamics.recursions.iter().map(|recursion| (recursion.state, recursion.input));
    components.chain(recursions).filter_map(|(state, slot)| Some((local(state)?, slot?))).collect()
}

impl StationaryGroup {
    /// F (or φ) and Q, m × m.
    fn matrices(&self, values: &[f64]) -> (Vec<f64>, Vec<f64>) {
        matrices(self.states.len(), [&self.motion, &self.noise], |slot| values[slot])
    }

    /// A of the fixed point Am = u, which is 0 = Fm + u or m = φm + u.
    fn fixed_point(&self, f: &[f64]) -> DMatrix<f64> {
        let m = self.states.len();
        DMatrix::from_fn(m, m, |i, j| f64::from(!self.continuous && i == j) - f[i * m + j])
    }

    /// The constant input u, m numbers.
    fn input(&self, inputs: &[f64]) -> DVector<f64> {
        let mut u = DVector::zeros(self.states.len());
        for &(i, slot) in &self.inputs {
            u[i] = inputs[slot];
        }
        u
    }

    /// Adds the stationary law of the group: the covariance by Lyapunov's equation, and the mean as the fixed point
    /// under constant inputs.
    fn settle(
        &self,
        at: &ModelAt<'_>,
        values: &[f64],
        inputs: &[f64],
        law: &mut StartMoments,
    ) -> Result<(), Box<Fault>> {
        let m = self.states.len();
        let (f, q) = self.matrices(values);
        let subject = Subject::StationaryLaw(self.states[0]);
        ldl(&mut q.clone(), m).map_err(|bad| Fault::new(subject, bad))?;
        let p = if self.continuous { stationary(&f, &q, m) } else { stationary_discrete(&f, &q, m) };
        let unstable = || ReduceErrorKind::Unstable {
            states: self.states.iter().map(|&i| at.model.states[i].name.clone()).collect(),
        };
        let p = p.map_err(|error| match error {
            FlowError::Unstable => Fault::new(subject, unstable()),
            FlowError::NotFinite => Fault::new(subject, ReduceErrorKind::NotFinite),
        })?;
        for i in 0..m {
            for j in 0..=i {
                if p[i * m + j] != 0.0 {
                    law.covariance.push((self.states[i], self.states[j], p[i * m + j]));
                }
            }
        }
        if self.inputs.is_empty() {
            return Ok(());
        }
        let mean =
            self.fixed_point(&f).lu().solve(&self.input(inputs)).ok_or_else(|| Fault::new(subject, unstable()))?;
        for (&state, mean) in self.states.iter().zip(&mean) {
            law.mean[state] = *mean;
        }
        Ok(())
    }
}
