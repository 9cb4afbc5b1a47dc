//! From ∂ℓ/∂(φ, Q, b) of steps back to ∂ℓ/∂coefficient of the dynamics.

use crate::reduce::dynamics::{Component, Dynamics, matrices};
use crate::reduce::error::ReduceErrorKind;
use crate::reduce::motion::{EntrySource, InputSource, MotionPlan, append_flow};
use crate::reduce::subject::{Fault, Subject};
use kalfit_algebra::exponential::{flow_adjoint, scalar_adjoint};

impl MotionPlan {
    /// (number of entries of φ, number of entries of Q).
    pub(crate) fn entries(&self) -> (usize, usize) {
        (self.phi.len(), self.q.len())
    }

    /// Whether an entry of φ is an entry of ΓG.
    pub(crate) fn holds(&self) -> bool {
        self.phi.iter().any(|entry| matches!(entry, EntrySource::Held(_)))
    }

    /// Recomputes the flows of a step.
    pub(crate) fn flows(
        &self,
        dynamics: &Dynamics,
        values: &[f64],
        dt: f64,
        out: &mut Vec<f64>,
    ) -> Result<(), Box<Fault>> {
        out.clear();
        dynamics.components.iter().try_for_each(|component| append_flow(component, |slot| values[slot], dt, out))
    }

    /// Adds ∂ℓ/∂Γ of one step with b = Γu to `flow_bar`, the adjoints of the flows.
    pub(crate) fn drive_flows(&self, input_bar: &[f64], inputs: &[f64], flow_bar: &mut [f64]) {
        for (drive, bar) in self.drives.iter().zip(input_bar) {
            if let InputSource::Flow(terms) = drive {
                terms.iter().for_each(|&(at, slot)| flow_bar[at] += bar * inputs[slot]);
            }
        }
    }

    /// Calls `add_adjoint(slot, ∂ℓ/∂u)` for the inputs of one step, for some slots more than once: the parts add up. `flows`
    /// may be empty when all motion is discrete.
    pub(crate) fn drive_inputs(
        &self,
        input_bar: &[f64],
        flows: &[f64],
        mut add_adjoint: impl FnMut(usize, f64) -> Result<(), Box<Fault>>,
    ) -> Result<(), Box<Fault>> {
        for (drive, bar) in self.drives.iter().zip(input_bar) {
            match drive {
                InputSource::Slot(slot) => add_adjoint(*slot, *bar)?,
                InputSource::Flow(terms) => {
                    terms.iter().try_for_each(|&(at, slot)| add_adjoint(slot, bar * flows[at]))?
                }
            }
        }
        Ok(())
    }

    /// Adds ∂ℓ/∂coefficient of one transition to `out`. `phi_bar`, `q_bar`: adjoints of the entries of φ and Q, summed
    /// over the steps of the transition; the adjoint of an off-diagonal entry of Q counts both triangles; `flow_bar`:
    /// adjoints of the flows from [`MotionPlan::drive_flows`]; `free`: whether each coefficient depends on free
    /// parameters.
    pub(crate) fn backward(
        &self,
        dynamics: &Dynamics,
        step: &Evaluated<'_>,
        (phi_bar, q_bar, flow_bar): (&[f64], &[f64], &mut [f64]),
        free: &[bool],
        out: &mut [f64],
    ) -> Result<(), Box<Fault>> {
        let entries = self.phi.iter().zip(phi_bar).chain(self.q.iter().zip(q_bar));
        for (entry, &bar) in entries {
            match entry {
                EntrySource::Slot(slot) => out[*slot] += bar,
                EntrySource::Flow(at) => flow_bar[*at] += bar,
                EntrySource::Held(terms) => {
                    for &(at, slot) in terms {
                        flow_bar[at] += bar * step.values[slot];
                        out[slot] += bar * step.flows[at];
                    }
                }
            }
        }
        for (component, &offset) in dynamics.components.iter().zip(&self.offsets) {
            let bars = &flow_bar[offset..][..3 * component.states.len().pow(2)];
            if component.is_free(free) && bars.iter().any(|&bar| bar != 0.0) {
                component_backward(component, step, bars, out)?;
            }
        }
        Ok(())
    }
}

/// Coefficients, length and flows of a step.
pub struct Evaluated<'a> {
    pub(crate) values: &'a [f64],
    pub(crate) dt: f64,
    /// Flows of the step, read only when [`MotionPlan::holds`].
    pub(crate) flows: &'a [f64],
}

impl Component {
    pub(super) fn is_free(&self, free: &[bool]) -> bool {
        self.rates.iter().chain(&self.noise).any(|&(.., slot)| free[slot])
    }
}

pub(super) fn component_backward(
    component: &Component,
    step: &Evaluated<'_>,
    bars: &[f64],
    out: &mut [f64],
) -> Result<(), Box<Fault>> {
    let m = component.states.len();
    let fault = || Fault::new(Subject::Derivative(component.states[0]), ReduceErrorKind::NotFinite);
    if let ([phi, gamma, noise], true) = (bars, m == 1) {
        let slots = [&component.rates, &component.noise].map(|terms| terms.first().map(|&(.., slot)| slot));
        let [f, q] = slots.map(|slot| slot.map_or(0.0, |slot| step.values[slot]));
        let adjoints = scalar_adjoint(f, q, step.dt, [*phi, *gamma, *noise]);
        slots.iter().zip(adjoints).for_each(|(slot, bar)| slot.iter().for_each(|&slot| out[slot] += bar));
        return if adjoints.iter().all(|bar| bar.is_finite()) { Ok(()) } else { Err(fault()) };
    }
    let (f, q) = matrices(m, [&component.rates, &component.noise], |slot| step.values[slot]);
    let (phi, rest) = bars.split_at(m * m);
    let (gamma, noise) = rest.split_at(m * m);
    let (mut f_bar, mut q_bar) = flow_adjoint(&f, &q, m, step.dt, [phi, gamma, noise]).map_err(|_| fault())?;
    // Of two coefficients for one entry, the last one is the one in effect.
    for &(i, j, slot) in component.rates.iter().rev() {
        out[slot] += std::mem::take(&mut f_bar[i * m + j]);
    }
    for &(i, j, slot) in component.noise.iter().rev() {
        let lower = std::mem::take(&mut q_bar[i * m + j]);
        out[slot] += lower + std::mem::take(&mut q_bar[j * m + i]);
    }
    Ok(())
}
