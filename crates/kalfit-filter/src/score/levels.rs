//! Noise levels: parameters that only scale noises, so that the M-step has a closed form.
//!
//! Where n noises have variances R_k = σ^d s_k, E[v_k²] = R_k + 2 R_k² ∂ℓ/∂R_k sums to σ^d_new = σ^d (1 + (2/dn) ∂ℓ/∂ln σ).

use std::collections::BTreeSet;

use rayon::prelude::*;

use crate::reduce::{Fault, PhasedReducer, PhasedWork, ReduceError, Reducer, Workspace};
use kalfit_model::Test;
use kalfit_model::{Evidence, PhasedTest};
use kalfit_model::{Expression, Initial, Model, Motion, Phase, PhasedModel, Site, Slots};

/// Which free values are noise levels, and how many noises each of them scales.
#[derive(Debug, Clone, PartialEq)]
pub struct Levels {
    /// Exponent d of each parameter σ in the variance σ^d s_k; `None` where the parameter is not a level.
    degree: Vec<Option<f64>>,
    /// n of each slot: the number of noises that the level scales.
    count: Vec<f64>,
}

impl Levels {
    /// The noise levels of a model; `reducer` must be at an α where no level is zero.
    pub fn new(
        model: &PhasedModel,
        reducer: &PhasedReducer,
        slots: &Slots,
        tests: &[PhasedTest],
    ) -> Result<Levels, ReduceError> {
        let parameters = 0..model.shared().parameters.len();
        let degree: Vec<Option<f64>> =
            parameters.map(|p| if slots.is_free(p) { common_degree(model, slots, p) } else { None }).collect();
        let mut count = vec![0.0; slots.len()];
        if degree.iter().any(Option::is_some) {
            let one = |work: &mut PhasedWork, test: &PhasedTest| -> Result<Vec<usize>, ReduceError> {
                let mut found = Vec::new();
                for (at, evidence) in test.phases.iter().enumerate() {
                    let (Evidence::Rows(rows), None) = (evidence, &model.phases[at].filter) else { continue };
                    let phase = &reducer.phases()[at];
                    let own = noise_slots(&phase.reducer, slots, &degree, rows, &mut work.phases[at]);
                    let named =
                        |fault: Box<Fault>| phase.named(fault.name(&phase.reducer.preparer().model, Some(rows)));
                    found.extend(own.map_err(named)?);
                }
                Ok(found)
            };
            let all: Vec<Result<Vec<usize>, ReduceError>> =
                tests.par_iter().map_init(|| reducer.workspace(), one).collect();
            for found in all {
                found?.into_iter().for_each(|slot| count[slot] += 1.0);
            }
        }
        Ok(Levels { degree, count })
    }

    /// (d, n) of a slot; `None` where the parameter of the slot is not a level.
    pub fn of(&self, slots: &Slots, slot: usize) -> Option<(f64, f64)> {
        Some((self.degree[slots.slots()[slot].parameter]?, self.count[slot]))
    }
}

/// d of a parameter that is a level with one d in all phases that mention the parameter, and that occurs neither in a
/// carry nor in a phase with a suboptimal filter; otherwise `None`.
fn common_degree(model: &PhasedModel, slots: &Slots, parameter: usize) -> Option<f64> {
    let mut common = None;
    for phase in &model.phases {
        let carried = phase.inherited_expressions().any(|expression| expression.mentions(parameter));
        let mut places = phase.model.expressions();
        places.retain(|(_, expression)| expression.mentions(parameter));
        if places.is_empty() && !carried {
            continue;
        }
        if carried || phase.filter.is_some() {
            return None;
        }
        let own = degree(&phase.model, slots, parameter, &places)?;
        if common.is_some_and(|common| common != own) {
            return None;
        }
        common = Some(own);
    }
    common
}

/// Indices of the free parameters that a phase or the carry of the phase depends on, ascending.
pub fn dependences(phase: &Phase, slots: &Slots) -> Vec<usize> {
    free_in(
        phase.model.expressions().into_iter().map(|(_, expression)| expression).chain(phase.inherited_expressions()),
        slots,
    )
}

/// Indices of the free parameters that the carry of a phase depends on, ascending.
pub fn carried(phase: &Phase, slots: &Slots) -> Vec<usize> {
    free_in(phase.inherited_expressions(), slots)
}

/// Indices of the free parameters in the expressions, ascending.
fn free_in<'m>(expressions: impl Iterator<Item = &'m Expression>, slots: &Slots) -> Vec<usize> {
    let all: BTreeSet<usize> = expressions.flat_map(Expression::parameters).collect();
    all.into_iter().filter(|&parameter| slots.is_free(parameter)).collect()
}

/// For each noise of a test that is scaled by a level, the slot of the level.
fn noise_slots(
    reducer: &Reducer,
    slots: &Slots,
    degree: &[Option<f64>],
    test: &Test,
    work: &mut Workspace,
) -> Result<Vec<usize>, Box<Fault>> {
    let preparer = reducer.preparer();
    let model = &preparer.model;
    preparer.prepare(test, work)?;
    let level = |expression: &Expression| (0..degree.len()).find(|&p| degree[p].is_some() && expression.mentions(p));
    let mut found = Vec::new();
    let meters: Vec<Option<usize>> = model.measurements.iter().map(|m| level(&m.noise_variance)).collect();
    let lines = work.design.each_step().flat_map(|step| step.lines);
    for (instance, noise) in work.instances.iter().zip(lines.map(|line| &work.design.noise[line])) {
        if let Some(parameter) = meters[instance.meter].filter(|_| *noise > 0.0) {
            found.extend(slots.find(parameter, test.texts(instance.row)));
        }
    }
    let driven: Vec<(u32, usize)> = (0..model.states.len())
        .filter_map(|i| Some((preparer.order.place[i] as u32, level(model.states[i].motion.noise_variance()?)?)))
        .collect();
    let mut cells = crate::reduce::GatheredCells::default();
    for (k, step) in work.design.each_step().enumerate() {
        let Some(transition) = step.transition.filter(|_| !driven.is_empty()) else { continue };
        let scope = preparer.moving(test, k, work, &mut cells)?;
        for &(place, parameter) in &driven {
            let own = transition.pattern.pairs.iter().position(|pair| *pair == (place, place));
            if own.is_some_and(|at| transition.q[at] > 0.0) {
                found.extend(slots.find(parameter, scope.texts));
            }
        }
    }
    Ok(found)
}

/// d of a parameter that only scales whole noise variances by σ^d; otherwise `None`. `places`: all expressions that
/// mention the parameter.
fn degree(model: &Model, slots: &Slots, parameter: usize, places: &[(Site, &Expression)]) -> Option<f64> {
    let free = |expression: &Expression| expression.parameters().into_iter().any(|p| slots.is_free(p));
    // a stationary start depends on the process noise of all states
    let is_settled = model.states.iter().any(|state| state.initial == Initial::Stationary);
    let mut common = None;
    for (site, expression) in places {
        let is_alone = match *site {
            Site::Noise(m) => !model.noise_covariance.iter().any(|(i, j, _)| *i == m || *j == m),
            Site::ProcessNoise(state) => !is_settled && has_separate_noise(model, state, &free),
            _ => false,
        };
        let own = scales(expression, slots, parameter).filter(|d| is_alone && *d != 0.0)?;
        if common.is_some_and(|common| common != own) {
            return None;
        }
        common = Some(own);
    }
    common
}

/// Whether the noise of a state is uncorrelated with the noises of all other states and reaches no other state within a
/// step, so that a factor of the noise variance scales the entry of Q of this state in every step.
fn has_separate_noise(model: &Model, state: usize, free: &dyn Fn(&Expression) -> bool) -> bool {
    if model.process_noise_covariance.iter().any(|(i, j, _)| *i == state || *j == state) {
        return false;
    }
    let continuous = |i: usize| matches!(model.states[i].motion, Motion::Continuous { .. });
    match &model.states[state].motion {
        Motion::Continuous { derivative, .. } => {
            let own = derivative.terms.iter().all(|(j, h)| if *j == state { !free(h) } else { !continuous(*j) });
            let others = model.states.iter().enumerate().filter(|(i, _)| *i != state);
            let fed = |motion: &Motion| matches!(motion, Motion::Continuous { derivative, .. } if derivative.terms.iter().any(|t| t.0 == state));
            own && !others.into_iter().any(|(_, other)| fed(&other.motion))
        }
        _ => true,
    }
}

/// d where the expression is σ^d times a factor without free parameters; otherwise `None`.
fn scales(expression: &Expression, slots: &Slots, parameter: usize) -> Option<f64> {
    if expression.parameters().into_iter().any(|p| p != parameter && slots.is_free(p)) {
        return None;
    }
    expression.exponent(parameter)
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::build::{constant, free, measurement, name, when};

    #[test]
    fn a_level_of_some_rows_is_a_level() {
        for (otherwise, degree) in [(0.0, Some(2.0)), (0.1, None)] {
            let model = kalfit_model::Model::builder("")
                .state(constant("x"))
                .measurement(measurement("y", "x", when(name("first").equals(1.0), name("s"), otherwise)))
                .parameter(free("s"));
            let model: PhasedModel = model.build().unwrap();
            let slots = Slots::new(model.shared(), &kalfit_model::Labels::default(), &[]);
            assert_eq!(common_degree(&model, &slots, 0), degree, "{otherwise} on other rows");
        }
    }
}
