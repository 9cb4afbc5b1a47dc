//! From adjoints of the transitions of tests in lanes back to adjoints of the coefficients of the motion.

use kalfit_lanes::{Lanes, MAX_LANES};

use crate::reduce::dynamics::{Component, Dynamics};
use crate::reduce::motion::backward::{Evaluated, component_backward};
use crate::reduce::motion::fill::{MotionColumns, SlotValues, Transitions};
use crate::reduce::motion::{EntrySource, InputSource, MotionPlan, Single};
use kalfit_algebra::exponential::{scalar_flow, scalar_slope};

impl Component {
    /// Slots of the component's rates and noises.
    pub(super) fn slots(&self) -> impl Iterator<Item = usize> {
        self.rates.iter().chain(&self.noise).map(|&(.., slot)| slot)
    }
}

impl MotionPlan {
    /// Whether φ or b depends on Γ of the single-state component whose flow begins at `offset`.
    fn uses_gamma(&self, offset: usize) -> bool {
        let gamma = |terms: &[(usize, usize)]| terms.iter().any(|&(at, _)| at == offset + 1);
        self.phi.iter().any(|entry| matches!(entry, EntrySource::Held(terms) if gamma(terms)))
            || self.drives.iter().any(|drive| matches!(drive, InputSource::Flow(terms) if gamma(terms)))
    }

    /// The pullback of the transitions `steps`. `free`: whether each coefficient depends on free parameters.
    pub(crate) fn back<'a>(
        &'a self,
        dynamics: &'a Dynamics,
        (steps, motion): (&'a Transitions, &'a MotionColumns),
        free: &'a [bool],
    ) -> MotionPullback<'a> {
        let back = |single| {
            let &Single { offset, rate, .. } = single;
            SinglePullback { single, is_free: rate.is_some_and(|slot| free[slot]), holds: self.uses_gamma(offset) }
        };
        let steady = |component: &Component| {
            dynamics.table.varying.iter().all(|(slot, ..)| component.slots().all(|own| own != *slot))
        };
        let coupled = dynamics.components.iter().zip(&self.offsets).filter(|(component, _)| component.states.len() > 1);
        let coupled = coupled.map(|(component, &offset)| CoupledPullback {
            component,
            offset,
            is_free: component.is_free(free),
            steady: steady(component),
        });
        MotionPullback {
            plan: self,
            steps,
            flows: &motion.flows,
            singles: self.singles.iter().map(back).collect(),
            coupled: coupled.collect(),
            values: SlotValues::new(&dynamics.table, &motion.values),
            inputs: SlotValues::new(&dynamics.inputs, &motion.inputs),
        }
    }
}

/// Pullback to the coefficients of a component of several states.
struct CoupledPullback<'a> {
    component: &'a Component,
    offset: usize,
    is_free: bool,
    /// Whether each coefficient of the component has one value on all transitions.
    steady: bool,
}

/// Pullback to the coefficients of a component of one state.
struct SinglePullback<'a> {
    single: &'a Single,
    /// Whether the rate of the component depends on free parameters.
    is_free: bool,
    /// Whether φ or b depends on Γ of the component.
    holds: bool,
}

/// Pullback from adjoints of transitions to adjoints of the coefficients of the motion.
pub struct MotionPullback<'a> {
    plan: &'a MotionPlan,
    steps: &'a Transitions,
    flows: &'a [f64],
    singles: Vec<SinglePullback<'a>>,
    coupled: Vec<CoupledPullback<'a>>,
    values: SlotValues<'a>,
    inputs: SlotValues<'a>,
}

/// Adjoints in lanes: of the flows of one transition (work space), of the coefficients and of the inputs.
#[derive(Debug, Clone)]
pub(crate) struct MotionBars<T> {
    flows: Vec<T>,
    /// Flow adjoints of coupled components with steady coefficients, summed over successive transitions of one length;
    /// `last` is the place of the last such transition in each lane.
    pending: Vec<T>,
    last: [Option<usize>; MAX_LANES],
    pub(crate) values: Vec<T>,
    pub(crate) inputs: Vec<T>,
}

impl MotionPullback<'_> {
    /// Adjoints that are all zero.
    #[inline(always)]
    pub(crate) fn zero<T: Lanes>(&self) -> MotionBars<T> {
        let zero = T::splat(0.0);
        let (flows, values, inputs) =
            (vec![zero; self.plan.flow_len], self.values.fixed.len(), self.inputs.fixed.len());
        let (pending, last) = (flows.clone(), [None; MAX_LANES]);
        MotionBars { flows, pending, last, values: vec![zero; values], inputs: vec![zero; inputs] }
    }

    /// Adds ∂ℓ/∂coefficient of transition `number` to `out`. `bars`: adjoints, in lanes, of the entries of φ, Q and b;
    /// the adjoint of an off-diagonal entry of Q counts both triangles.
    #[inline(always)]
    pub(crate) fn pull<T: Lanes>(&self, number: usize, bars: &[f64], out: &mut MotionBars<T>) {
        let (places, place) = (self.steps.dt.len(), number * T::COUNT);
        let moving = T::load(&self.steps.moving[place..]);
        out.flows.fill(T::splat(0.0));
        let mut entries = bars.chunks_exact(T::COUNT);
        for (entry, bar) in self.plan.phi.iter().chain(&self.plan.q).zip(&mut entries) {
            let bar = T::load(bar);
            match entry {
                EntrySource::Slot(slot) => out.values[*slot] = moving.fma(bar, out.values[*slot]),
                EntrySource::Flow(at) => out.flows[*at] = out.flows[*at] + bar,
                EntrySource::Held(terms) => {
                    for &(at, slot) in terms {
                        out.flows[at] = self.values.lanes::<T>(slot, place).fma(bar, out.flows[at]);
                        out.values[slot] = T::load(&self.flows[at * places + place..]).fma(bar, out.values[slot]);
                    }
                }
            }
        }
        for (drive, bar) in self.plan.drives.iter().zip(entries) {
            let bar = T::load(bar);
            match drive {
                InputSource::Slot(slot) => out.inputs[*slot] = moving.fma(bar, out.inputs[*slot]),
                InputSource::Flow(terms) => {
                    for &(at, slot) in terms {
                        out.flows[at] = self.inputs.lanes::<T>(slot, place).fma(bar, out.flows[at]);
                        out.inputs[slot] = T::load(&self.flows[at * places + place..]).fma(bar, out.inputs[slot]);
                    }
                }
            }
        }
        for single in &self.singles {
            self.single(single, place, out);
        }
        for lane in 0..T::COUNT {
            if moving.lane(lane) != 0.0 && self.coupled.iter().any(|coupled| coupled.is_free) {
                self.coupled(lane, place + lane, out);
            }
        }
    }

    /// Pulls the pending flow adjoints of all lanes back to the coefficients.
    #[inline(always)]
    pub(crate) fn finish<T: Lanes>(&self, out: &mut MotionBars<T>) {
        for lane in 0..T::COUNT {
            self.flush(lane, out);
        }
    }

    /// Adds the flow adjoints of coupled states on the transition at `place` of a lane: adjoints of successive
    /// transitions of one length are summed first.
    fn coupled<T: Lanes>(&self, lane: usize, place: usize, out: &mut MotionBars<T>) {
        let has_same_length = |before: usize| self.steps.dt[before].to_bits() == self.steps.dt[place].to_bits();
        if !out.last[lane].is_some_and(has_same_length) {
            self.flush(lane, out);
            out.last[lane] = Some(place);
        }
        for CoupledPullback { component, offset, steady, .. } in self.coupled.iter().filter(|coupled| coupled.is_free) {
            let range = *offset..offset + 3 * component.states.len().pow(2);
            if *steady {
                for k in range {
                    out.pending[k] = add_to_lane(out.pending[k], lane, out.flows[k].lane(lane));
                }
            } else {
                let bars: Vec<f64> = out.flows[range].iter().map(|bar| bar.lane(lane)).collect();
                self.component(component, (lane, place), &bars, out);
            }
        }
    }

    /// Pulls the flow adjoints pending in a lane back to the coefficients, and clears the pending adjoints.
    fn flush<T: Lanes>(&self, lane: usize, out: &mut MotionBars<T>) {
        let Some(place) = out.last[lane].take() else { return };
        for CoupledPullback { component, offset, .. } in
            self.coupled.iter().filter(|coupled| coupled.is_free && coupled.steady)
        {
            let range = *offset..offset + 3 * component.states.len().pow(2);
            let bars: Vec<f64> = out.pending[range.clone()].iter().map(|bar| bar.lane(lane)).collect();
            range.zip(&bars).for_each(|(k, bar)| out.pending[k] = add_to_lane(out.pending[k], lane, -bar));
            self.component(component, (lane, place), &bars, out);
        }
    }

    /// Pulls adjoints of φ, Γ and Q of coupled states back to the rates and noises of the component. Derivatives that
    /// do not exist become NaN.
    fn component<T: Lanes>(
        &self,
        component: &Component,
        (lane, place): (usize, usize),
        bars: &[f64],
        out: &mut MotionBars<T>,
    ) {
        let values: Vec<f64> = (0..self.values.fixed.len()).map(|slot| self.values.number_at(slot, place)).collect();
        let step = Evaluated { values: &values, dt: self.steps.dt[place], flows: &[] };
        let mut found = vec![0.0; values.len()];
        if component_backward(component, &step, bars, &mut found).is_err() {
            component.slots().for_each(|slot| found[slot] = f64::NAN);
        }
        for slot in component.slots() {
            out.values[slot] = add_to_lane(out.values[slot], lane, std::mem::take(&mut found[slot]));
        }
    }

    /// Pulls adjoints of φ, Γ and Q of a single state back to the rate and the noise of the state.
    #[inline(always)]
    fn single<T: Lanes>(&self, back: &SinglePullback<'_>, place: usize, out: &mut MotionBars<T>) {
        let &SinglePullback { single: &Single { offset, rate, noise }, is_free, holds } = back;
        let (places, two) = (self.steps.dt.len(), T::splat(2.0));
        let (dt, phi) = (T::load(&self.steps.dt[place..]), T::load(&self.flows[offset * places + place..]));
        let f = self.values.lanes_or_zero::<T>(rate, place);
        let mut slope = out.flows[offset] * dt * phi;
        if holds && is_free {
            let gamma = T::load(&self.flows[(offset + 1) * places + place..]);
            slope = out.flows[offset + 1].fma(scalar_slope(f, dt, (phi, gamma)), slope);
        }
        if let Some(slot) = noise {
            let (q, bar) = (self.values.lanes::<T>(slot, place), out.flows[offset + 2]);
            let integral = noise_derivative(two * f, dt, q, T::load(&self.flows[(offset + 2) * places + place..]));
            out.values[slot] = bar.fma(integral, out.values[slot]);
            if is_free {
                slope = (bar * two * q).fma(scalar_slope(two * f, dt, (phi * phi, integral)), slope);
            }
        }
        if let (Some(slot), true) = (rate, is_free) {
            out.values[slot] = out.values[slot] + slope;
        }
    }
}

/// `numbers` with `more` added in one lane.
fn add_to_lane<T: Lanes>(numbers: T, lane: usize, addend: f64) -> T {
    let mut all = [0.0; MAX_LANES];
    numbers.store(&mut all);
    all[lane] += addend;
    T::load(&all)
}

/// ∂Q/∂q of a single state: Q/q, or expm1(xδ)/x where the noise q is zero. (`rate` is x, `dt` is δ.)
#[inline(always)]
fn noise_derivative<T: Lanes>(rate: T, dt: T, noise: T, q: T) -> T {
    let mut all = [0.0; MAX_LANES];
    (q / noise).store(&mut all);
    for lane in 0..T::COUNT {
        if noise.lane(lane) == 0.0 {
            all[lane] = scalar_flow(rate.lane(lane), 0.0, dt.lane(lane))[1];
        }
    }
    T::load(&all)
}
