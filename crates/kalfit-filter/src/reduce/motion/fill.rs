//! The transitions of tests in lanes, from coefficients to φ, Q and b.

use std::collections::HashMap;

use kalfit_lanes::{Isa, Kernel, Lanes, MAX_LANES, Width};

use crate::reduce::dynamics::{Component, Dynamics, Table};
use crate::reduce::lanes::BatchColumns;
use crate::reduce::motion::{EntrySource, InputSource, MotionPlan, Moves, append_flow, check_noise};
use kalfit_algebra::exponential::scalar_flows;

/// The transitions that lead to the steps of tests in lanes: transition t of the test in a lane is at t × lanes + lane.
#[derive(Debug, Clone, Default)]
pub(crate) struct Transitions {
    /// Step length of each transition; 0 where a test has no such transition.
    pub(crate) dt: Vec<f64>,
    /// 1 where a test has the transition, else 0.
    pub(crate) moving: Vec<f64>,
    /// Row of the test from which the coefficients of each transition are read.
    pub(crate) sources: Vec<u32>,
}

/// Coefficients, inputs and flows on all transitions of tests in lanes.
#[derive(Debug, Clone, Default)]
pub(crate) struct MotionColumns {
    /// Values of each coefficient that varies, in the order of [`Table::varying`].
    pub(crate) values: Vec<Vec<f64>>,
    pub(crate) inputs: Vec<Vec<f64>>,
    /// Flows φ, Γ, Q of the components: entry i on the transition at `place` is at i × (number of places) + place.
    pub(super) flows: Vec<f64>,
}

/// Coefficients on transitions: each coefficient has one value on all transitions, or a column with one value per
/// transition.
pub(super) struct SlotValues<'a> {
    pub(super) fixed: &'a [f64],
    /// Column of each slot; `None` for a slot with one value on all transitions. Empty when no slot has a column.
    columns: Vec<Option<&'a [f64]>>,
}

impl Transitions {
    pub(crate) fn clear(&mut self) {
        let Transitions { dt, moving, sources } = self;
        dt.clear();
        moving.clear();
        sources.clear();
    }
}

impl MotionColumns {
    /// Sets all columns to `places` zeros. `varying`: number of columns of coefficients, and of inputs.
    pub(crate) fn blank(&mut self, varying: [usize; 2], places: usize) {
        for (columns, varying) in [&mut self.values, &mut self.inputs].into_iter().zip(varying) {
            columns.resize_with(varying, Vec::new);
            for column in columns {
                column.clear();
                column.resize(places, 0.0);
            }
        }
    }
}

impl<'a> SlotValues<'a> {
    /// The table in which each coefficient has one value on all transitions.
    fn without_columns(values: &[f64]) -> SlotValues<'_> {
        SlotValues { fixed: values, columns: Vec::new() }
    }

    pub(super) fn new(table: &'a Table, columns: &'a [Vec<f64>]) -> SlotValues<'a> {
        let mut slots = SlotValues { fixed: &table.fixed, columns: vec![None; table.fixed.len()] };
        for ((slot, ..), column) in table.varying.iter().zip(columns) {
            slots.columns[*slot] = Some(column);
        }
        slots
    }

    #[inline(always)]
    pub(super) fn lanes<T: Lanes>(&self, slot: usize, place: usize) -> T {
        match self.column(slot) {
            Some(column) => T::load(&column[place..]),
            None => T::splat(self.fixed[slot]),
        }
    }

    pub(super) fn number_at(&self, slot: usize, place: usize) -> f64 {
        self.column(slot).map_or(self.fixed[slot], |column| column[place])
    }

    #[inline(always)]
    fn column(&self, slot: usize) -> Option<&'a [f64]> {
        self.columns.get(slot).copied().flatten()
    }

    #[inline(always)]
    pub(super) fn lanes_or_zero<T: Lanes>(&self, slot: Option<usize>, place: usize) -> T {
        match slot {
            Some(slot) => self.lanes(slot, place),
            None => T::splat(0.0),
        }
    }
}

/// Flows, φ and Q of one transition.
#[derive(Debug, Clone, Default)]
pub struct Filled {
    step: Transitions,
    pub(super) flows: Vec<f64>,
    pub(super) phi: Vec<f64>,
    pub(super) q: Vec<f64>,
}

impl MotionPlan {
    /// Computes φ, Q and b of transitions. Returns for each lane whether flows, φ and Q are finite; false in all lanes
    /// where the noises do not form a covariance.
    pub(crate) fn fill(
        &self,
        width: Width,
        dynamics: &Dynamics,
        (steps, motion): (&Transitions, &mut MotionColumns),
        out: BatchColumns<'_>,
    ) -> [bool; MAX_LANES] {
        if check_noise(dynamics, &dynamics.table.fixed).is_err() {
            return [false; MAX_LANES];
        }
        let MotionColumns { values, inputs, flows } = motion;
        flows.resize(self.flow_len * steps.dt.len(), 0.0);
        let (values, inputs) = (SlotValues::new(&dynamics.table, values), SlotValues::new(&dynamics.inputs, inputs));
        self.fill_coupled((dynamics, &values), steps, flows);
        let finite_lanes = width.run(TransitionKernel { plan: self, steps, values, flows, phi: out.phi, q: out.q });
        width.run(InputKernel { plan: self, steps, inputs, flows, out: out.inputs });
        finite_lanes
    }

    /// Computes φ and Q of one transition of length `dt`; true where all numbers are finite.
    pub(super) fn fill_one(&self, dynamics: &Dynamics, values: &[f64], dt: f64, filled: &mut Filled) -> bool {
        let (Filled { step, flows, phi, q }, values) = (filled, SlotValues::without_columns(values));
        for (column, numbers) in [(&mut *flows, self.flow_len), (&mut *phi, self.phi.len()), (&mut *q, self.q.len())] {
            column.resize(numbers, 0.0);
        }
        for (column, x) in [(&mut step.dt, dt), (&mut step.moving, 1.0)] {
            column.clear();
            column.push(x);
        }
        self.fill_coupled((dynamics, &values), step, flows);
        let alone = Isa::best().alone();
        alone.run(TransitionKernel { plan: self, steps: step, values, flows, phi, q })[0]
    }

    /// Appends b of the driven states, with the same bits as in lanes. `inputs`: values of the dynamics' inputs.
    pub fn inputs(&self, moves: &Moves, inputs: &[f64], out: &mut Vec<f64>) {
        if !self.drives.is_empty() {
            Isa::best().alone().run(SingleInputKernel { drives: &self.drives, moves, inputs, out });
        }
    }

    /// Computes φ, Γ and Q of components of several states, transition by transition, once for each length and set of
    /// coefficients. Flows that overflow become NaN.
    fn fill_coupled(&self, (dynamics, values): (&Dynamics, &SlotValues<'_>), steps: &Transitions, flows: &mut [f64]) {
        let coupled = dynamics.components.iter().zip(&self.offsets).filter(|(component, _)| component.states.len() > 1);
        for (component, &offset) in coupled {
            fill_coupled((component, offset), steps, values, flows);
        }
    }
}

fn fill_coupled(
    (component, offset): (&Component, usize),
    steps: &Transitions,
    values: &SlotValues<'_>,
    flows: &mut [f64],
) {
    let (places, m) = (steps.dt.len(), component.states.len());
    let (mut known, mut own) = (HashMap::new(), Vec::new());
    for place in 0..places {
        own.clear();
        if steps.moving[place] == 0.0 {
            own.resize(3 * m * m, 0.0);
            (0..m).for_each(|i| own[i * m + i] = 1.0);
        } else {
            let bits = component.slots().map(|slot| values.number_at(slot, place)).chain([steps.dt[place]]);
            let before = *known.entry(bits.map(f64::to_bits).collect::<Vec<u64>>()).or_insert(place);
            if before < place {
                own.extend((0..3 * m * m).map(|k| flows[(offset + k) * places + before]));
            } else if append_flow(component, |slot| values.number_at(slot, place), steps.dt[place], &mut own).is_err() {
                own.resize(3 * m * m, f64::NAN);
            }
        }
        own.iter().enumerate().for_each(|(k, &x)| flows[(offset + k) * places + place] = x);
    }
}

/// Σ (entry of a flow) × coefficient.
#[inline(always)]
fn held<T: Lanes>(terms: &[(usize, usize)], flow: impl Fn(usize) -> T, slot: impl Fn(usize) -> T) -> T {
    let mut sum = T::splat(0.0);
    for &(at, own) in terms {
        sum = slot(own).fma(flow(at), sum);
    }
    sum
}

/// Kernel that computes φ and Q of transitions, after the flows of single states.
struct TransitionKernel<'a> {
    plan: &'a MotionPlan,
    steps: &'a Transitions,
    values: SlotValues<'a>,
    flows: &'a mut [f64],
    phi: &'a mut [f64],
    q: &'a mut [f64],
}

impl Kernel for TransitionKernel<'_> {
    /// For each lane, whether flows, φ and Q are finite.
    type Output = [bool; MAX_LANES];

    #[inline(always)]
    fn run<T: Lanes>(mut self) -> [bool; MAX_LANES] {
        let (plan, places) = (self.plan, self.steps.dt.len());
        let (terms, pairs) = (plan.phi.len(), plan.q.len());
        let (zero, mut defect) = (T::splat(0.0), T::splat(0.0));
        for t in 0..places / T::COUNT {
            let place = t * T::COUNT;
            self.singles::<T>(place);
            for k in 0..self.flows.len() / places {
                defect = self.flow::<T>(k, place).fma(zero, defect);
            }
            for k in 0..terms {
                let x = self.entry::<T>(&plan.phi[k], plan.identity[k], place);
                x.store(&mut self.phi[(t * terms + k) * T::COUNT..]);
                defect = x.fma(zero, defect);
            }
            for k in 0..pairs {
                let x = self.entry::<T>(&plan.q[k], 0.0, place);
                x.store(&mut self.q[(t * pairs + k) * T::COUNT..]);
                defect = x.fma(zero, defect);
            }
        }
        let mut finite_lanes = [false; MAX_LANES];
        for lane in 0..T::COUNT {
            finite_lanes[lane] = defect.lane(lane) == 0.0;
        }
        finite_lanes
    }
}

impl TransitionKernel<'_> {
    /// Computes the flows of components of a single state.
    #[inline(always)]
    fn singles<T: Lanes>(&mut self, place: usize) {
        let places = self.steps.dt.len();
        for single in &self.plan.singles {
            let (f, q) = (
                self.values.lanes_or_zero::<T>(single.rate, place),
                self.values.lanes_or_zero::<T>(single.noise, place),
            );
            let flow = scalar_flows(f, q, T::load(&self.steps.dt[place..]));
            for k in 0..3 {
                flow[k].store(&mut self.flows[(single.offset + k) * places + place..]);
            }
        }
    }

    /// An entry of φ or Q; `rest`: value of the entry where a test has no transition.
    #[inline(always)]
    fn entry<T: Lanes>(&self, entry: &EntrySource, resting_value: f64, place: usize) -> T {
        match entry {
            EntrySource::Slot(slot) => {
                let moving = T::load(&self.steps.moving[place..]);
                moving
                    .fma(self.values.lanes(*slot, place), moving.fnma(T::splat(resting_value), T::splat(resting_value)))
            }
            EntrySource::Flow(at) => self.flow(*at, place),
            EntrySource::Held(terms) => held(terms, |at| self.flow(at, place), |slot| self.values.lanes(slot, place)),
        }
    }

    #[inline(always)]
    fn flow<T: Lanes>(&self, at: usize, place: usize) -> T {
        T::load(&self.flows[at * self.steps.dt.len() + place..])
    }
}

/// Kernel that computes b of transitions.
struct InputKernel<'a> {
    plan: &'a MotionPlan,
    steps: &'a Transitions,
    inputs: SlotValues<'a>,
    flows: &'a [f64],
    out: &'a mut [f64],
}

impl Kernel for InputKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let InputKernel { plan, steps, inputs, flows, out } = self;
        let (places, drives) = (steps.dt.len(), plan.drives.len());
        for t in 0..places / T::COUNT {
            let place = t * T::COUNT;
            for (k, drive) in plan.drives.iter().enumerate() {
                let x = match drive {
                    InputSource::Slot(slot) => T::load(&steps.moving[place..]) * inputs.lanes(*slot, place),
                    InputSource::Flow(terms) => {
                        held(terms, |at| T::load(&flows[at * places + place..]), |slot| inputs.lanes(slot, place))
                    }
                };
                x.store(&mut out[(t * drives + k) * T::COUNT..]);
            }
        }
    }
}

/// Kernel that appends b of one transition.
struct SingleInputKernel<'a> {
    drives: &'a [InputSource],
    moves: &'a Moves,
    inputs: &'a [f64],
    out: &'a mut Vec<f64>,
}

impl Kernel for SingleInputKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn run<T: Lanes>(self) {
        let SingleInputKernel { drives, moves, inputs, out } = self;
        for drive in drives {
            out.push(match drive {
                InputSource::Slot(slot) => inputs[*slot],
                InputSource::Flow(terms) => {
                    held(terms, |at| T::splat(moves.flows[at]), |slot| T::splat(inputs[slot])).lane(0)
                }
            });
        }
    }
}
