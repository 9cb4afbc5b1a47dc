//! The transitions of many tests side by side, and the way back to the coefficients of the motion.

use std::collections::HashMap;

use kalfit_lanes::{Isa, Kernel, Lanes, MOST};

use crate::linalg::exponential::{scalar_flow, scalar_flows, scalar_slope};
use crate::reduce::design::{Moved, Pattern};
use crate::reduce::dynamics::{Component, Dynamics, Table};
use crate::reduce::lanes::Columns;
use crate::reduce::motion::backward::{Evaluated, component_backward};
use crate::reduce::motion::{Drive, Entry, Plan, append_flow, check_noise};

/// The transitions that lead to the steps of tests in lanes: number t of the test in a lane at t × lanes + lane.
#[derive(Debug, Clone, Default)]
pub(crate) struct Transitions {
    /// Lengths; 0 where a test has none.
    pub(crate) dt: Vec<f64>,
    /// 1 where a test has one, else 0.
    pub(crate) moving: Vec<f64>,
    /// The row that its coefficients read.
    pub(crate) sources: Vec<u32>,
}

/// What the motion is on all transitions of tests in lanes.
#[derive(Debug, Clone, Default)]
pub(crate) struct MotionColumns {
    /// Of each coefficient that varies, in the order of [`Table::varying`].
    pub(crate) values: Vec<Vec<f64>>,
    pub(crate) inputs: Vec<Vec<f64>>,
    /// φ, Γ, Q of each component.
    flows: Vec<f64>,
}

/// A table of coefficients on transitions: the same on all of them, or a column.
struct Slots<'a> {
    fixed: &'a [f64],
    columns: Vec<Option<&'a [f64]>>,
}

impl<'a> Slots<'a> {
    fn new(table: &'a Table, columns: &'a [Vec<f64>]) -> Slots<'a> {
        let mut slots = Slots { fixed: &table.fixed, columns: vec![None; table.fixed.len()] };
        for ((slot, ..), column) in table.varying.iter().zip(columns) {
            slots.columns[*slot] = Some(column);
        }
        slots
    }

    #[inline(always)]
    fn lanes<T: Lanes>(&self, slot: usize, place: usize) -> T {
        match self.columns[slot] {
            Some(column) => T::load(&column[place..]),
            None => T::splat(self.fixed[slot]),
        }
    }

    fn one(&self, slot: usize, place: usize) -> f64 {
        self.columns[slot].map_or(self.fixed[slot], |column| column[place])
    }

    #[inline(always)]
    fn some<T: Lanes>(&self, slot: Option<usize>, place: usize) -> T {
        match slot {
            Some(slot) => self.lanes(slot, place),
            None => T::splat(0.0),
        }
    }
}

/// Slots of the rate and of the noise of a single state.
fn rates(component: &Component) -> [Option<usize>; 2] {
    [&component.rates, &component.noise].map(|terms| terms.first().map(|&(.., slot)| slot))
}

impl Component {
    /// Slots of its rates and noises.
    fn slots(&self) -> impl Iterator<Item = usize> {
        self.rates.iter().chain(&self.noise).map(|&(.., slot)| slot)
    }
}

impl Plan {
    /// Whether φ or b depends on Γ of a single state whose flow begins here.
    fn holds_over(&self, offset: usize) -> bool {
        let gamma = |terms: &[(usize, usize)]| terms.iter().any(|&(at, _)| at == offset + 1);
        self.phi.iter().any(|entry| matches!(entry, Entry::Held(terms) if gamma(terms)))
            || self.drives.iter().any(|drive| matches!(drive, Drive::Flow(terms) if gamma(terms)))
    }

    /// φ, Q and b of transitions. Returns in which lanes all of them are finite: in none where the noises are no covariance.
    pub(crate) fn fill(
        &self,
        isa: Isa,
        dynamics: &Dynamics,
        (steps, motion): (&Transitions, &mut MotionColumns),
        out: Columns<'_>,
    ) -> [bool; MOST] {
        if check_noise(dynamics, &dynamics.table.fixed).is_err() {
            return [false; MOST];
        }
        let MotionColumns { values, inputs, flows } = motion;
        flows.resize(self.flow_len(dynamics) * steps.dt.len(), 0.0);
        let (values, inputs) = (Slots::new(&dynamics.table, values), Slots::new(&dynamics.inputs, inputs));
        let (mut singles, mut coupled) = (Vec::new(), [true; MOST]);
        for (component, &offset) in dynamics.components.iter().zip(&self.offsets) {
            match component.states.len() {
                1 => singles.push((offset, rates(component))),
                _ => fill_coupled((component, offset), (steps, isa.lanes()), &values, flows, &mut coupled),
            }
        }
        let mut sound = isa.run(Fill { plan: self, singles, steps, values, inputs, flows, out });
        sound.iter_mut().zip(coupled).for_each(|(sound, coupled)| *sound &= coupled);
        sound
    }

    /// The way back from these transitions. `free`: coefficients that count.
    pub(crate) fn back<'a>(
        &'a self,
        dynamics: &'a Dynamics,
        (steps, motion): (&'a Transitions, &'a MotionColumns),
        free: &'a [bool],
    ) -> MotionBack<'a> {
        let (mut singles, mut coupled) = (Vec::new(), Vec::new());
        for (component, &offset) in dynamics.components.iter().zip(&self.offsets) {
            if component.states.len() > 1 {
                let steady = dynamics.table.varying.iter().all(|(slot, ..)| component.slots().all(|own| own != *slot));
                coupled.push(Coupled { component, offset, counts: component.counts(free), steady });
            } else {
                let [rate, noise] = rates(component);
                let counts = rate.is_some_and(|slot| free[slot]);
                singles.push(Single { offset, rate, noise, counts, holds: self.holds_over(offset) });
            }
        }
        MotionBack {
            plan: self,
            steps,
            flows: &motion.flows,
            singles,
            coupled,
            flow_len: self.flow_len(dynamics),
            values: Slots::new(&dynamics.table, &motion.values),
            inputs: Slots::new(&dynamics.inputs, &motion.inputs),
        }
    }
}

/// φ, Γ and Q of a component of several states, transition by transition, those of one length and equal coefficients once.
fn fill_coupled(
    (component, offset): (&Component, usize),
    (steps, lanes): (&Transitions, usize),
    values: &Slots<'_>,
    flows: &mut [f64],
    sound: &mut [bool; MOST],
) {
    let (places, m) = (steps.dt.len(), component.states.len());
    let (mut known, mut own) = (HashMap::new(), Vec::new());
    for place in 0..places {
        own.clear();
        if steps.moving[place] == 0.0 {
            own.resize(3 * m * m, 0.0);
            (0..m).for_each(|i| own[i * m + i] = 1.0);
        } else {
            let bits = component.slots().map(|slot| values.one(slot, place)).chain([steps.dt[place]]);
            let before = *known.entry(bits.map(f64::to_bits).collect::<Vec<u64>>()).or_insert(place);
            if before < place {
                own.extend((0..3 * m * m).map(|k| flows[(offset + k) * places + before]));
            } else if append_flow(component, |slot| values.one(slot, place), steps.dt[place], &mut own).is_err() {
                sound[place % lanes] = false;
                own.resize(3 * m * m, 0.0);
                known.clear();
            }
        }
        own.iter().enumerate().for_each(|(k, &x)| flows[(offset + k) * places + place] = x);
    }
}

/// A component of several states.
struct Coupled<'a> {
    component: &'a Component,
    offset: usize,
    counts: bool,
    /// Its coefficients are the same on all transitions.
    steady: bool,
}

/// A component of one state.
struct Single {
    /// Where its flow begins.
    offset: usize,
    /// Slots of its rate and of its noise.
    rate: Option<usize>,
    noise: Option<usize>,
    /// Its rate counts.
    counts: bool,
    /// φ or b depends on its Γ.
    holds: bool,
}

/// The way from the adjoints of transitions back to the coefficients of the motion.
pub(crate) struct MotionBack<'a> {
    plan: &'a Plan,
    steps: &'a Transitions,
    flows: &'a [f64],
    singles: Vec<Single>,
    coupled: Vec<Coupled<'a>>,
    flow_len: usize,
    values: Slots<'a>,
    inputs: Slots<'a>,
}

/// Adjoints of one transition, in lanes: of the flows (work space), of the coefficients and of the inputs.
#[derive(Debug, Clone)]
pub(crate) struct MotionBars<T> {
    flows: Vec<T>,
    /// Of coupled components with steady coefficients, summed over transitions of one length: of each lane the last one's place.
    equal: Vec<T>,
    last: [Option<usize>; MOST],
    pub(crate) values: Vec<T>,
    pub(crate) inputs: Vec<T>,
}

impl MotionBack<'_> {
    /// Adjoints of zero.
    #[inline(always)]
    pub(crate) fn zero<T: Lanes>(&self) -> MotionBars<T> {
        let zero = T::splat(0.0);
        let (flows, values, inputs) = (vec![zero; self.flow_len], self.values.fixed.len(), self.inputs.fixed.len());
        let (equal, last) = (flows.clone(), [None; MOST]);
        MotionBars { flows, equal, last, values: vec![zero; values], inputs: vec![zero; inputs] }
    }

    /// Adds ∂ℓ/∂coefficient of the transition with this number. `bars`: of its entries of φ, of Q (one off the diagonal for both
    /// places) and of b, in lanes.
    #[inline(always)]
    pub(crate) fn pull<T: Lanes>(&self, number: usize, bars: &[f64], out: &mut MotionBars<T>) {
        let (places, place) = (self.steps.dt.len(), number * T::COUNT);
        let moving = T::load(&self.steps.moving[place..]);
        out.flows.fill(T::splat(0.0));
        let mut entries = bars.chunks_exact(T::COUNT);
        for (entry, bar) in self.plan.phi.iter().chain(&self.plan.q).zip(&mut entries) {
            let bar = T::load(bar);
            match entry {
                Entry::Slot(slot) => out.values[*slot] = moving.fma(bar, out.values[*slot]),
                Entry::Flow(at) => out.flows[*at] = out.flows[*at] + bar,
                Entry::Held(terms) => {
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
                Drive::Slot(slot) => out.inputs[*slot] = moving.fma(bar, out.inputs[*slot]),
                Drive::Flow(terms) => {
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
            if moving.lane(lane) != 0.0 && self.coupled.iter().any(|coupled| coupled.counts) {
                self.coupled(lane, place + lane, out);
            }
        }
    }

    /// Adds what equal transitions have summed.
    #[inline(always)]
    pub(crate) fn finish<T: Lanes>(&self, out: &mut MotionBars<T>) {
        for lane in 0..T::COUNT {
            self.settle(lane, out);
        }
    }

    /// The transition at a place of a lane, of coupled states: those of one length on end are summed.
    fn coupled<T: Lanes>(&self, lane: usize, place: usize, out: &mut MotionBars<T>) {
        let same = |before: usize| self.steps.dt[before].to_bits() == self.steps.dt[place].to_bits();
        if !out.last[lane].is_some_and(same) {
            self.settle(lane, out);
            out.last[lane] = Some(place);
        }
        for Coupled { component, offset, steady, .. } in self.coupled.iter().filter(|coupled| coupled.counts) {
            let range = *offset..offset + 3 * component.states.len().pow(2);
            if *steady {
                for k in range {
                    out.equal[k] = added(out.equal[k], lane, out.flows[k].lane(lane));
                }
            } else {
                let bars: Vec<f64> = out.flows[range].iter().map(|bar| bar.lane(lane)).collect();
                self.component(component, (lane, place), &bars, out);
            }
        }
    }

    /// Adds what transitions of one length of a lane have summed.
    fn settle<T: Lanes>(&self, lane: usize, out: &mut MotionBars<T>) {
        let Some(place) = out.last[lane].take() else { return };
        for Coupled { component, offset, .. } in self.coupled.iter().filter(|coupled| coupled.counts && coupled.steady)
        {
            let range = *offset..offset + 3 * component.states.len().pow(2);
            let bars: Vec<f64> = out.equal[range.clone()].iter().map(|bar| bar.lane(lane)).collect();
            range.zip(&bars).for_each(|(k, bar)| out.equal[k] = added(out.equal[k], lane, -bar));
            self.component(component, (lane, place), &bars, out);
        }
    }

    /// From φ, Γ and Q of coupled states to their rates and noises. What has no derivative is not a number.
    fn component<T: Lanes>(
        &self,
        component: &Component,
        (lane, place): (usize, usize),
        bars: &[f64],
        out: &mut MotionBars<T>,
    ) {
        let values: Vec<f64> = (0..self.values.fixed.len()).map(|slot| self.values.one(slot, place)).collect();
        let step = Evaluated { values: &values, dt: self.steps.dt[place], flows: &[] };
        let mut found = vec![0.0; values.len()];
        if component_backward(component, &step, bars, &mut found).is_err() {
            component.slots().for_each(|slot| found[slot] = f64::NAN);
        }
        for slot in component.slots() {
            out.values[slot] = added(out.values[slot], lane, std::mem::take(&mut found[slot]));
        }
    }

    /// From φ, Γ and Q of a single state to its rate and its noise.
    #[inline(always)]
    fn single<T: Lanes>(&self, single: &Single, place: usize, out: &mut MotionBars<T>) {
        let Single { offset, rate, noise, counts, holds } = *single;
        let (places, two) = (self.steps.dt.len(), T::splat(2.0));
        let (dt, phi) = (T::load(&self.steps.dt[place..]), T::load(&self.flows[offset * places + place..]));
        let f = self.values.some::<T>(rate, place);
        let mut slope = out.flows[offset] * dt * phi;
        if holds && counts {
            let gamma = T::load(&self.flows[(offset + 1) * places + place..]);
            slope = out.flows[offset + 1].fma(scalar_slope(f, dt, (phi, gamma)), slope);
        }
        if let Some(slot) = noise {
            let (q, bar) = (self.values.lanes::<T>(slot, place), out.flows[offset + 2]);
            let integral = part(two * f, dt, q, T::load(&self.flows[(offset + 2) * places + place..]));
            out.values[slot] = bar.fma(integral, out.values[slot]);
            if counts {
                slope = (bar * two * q).fma(scalar_slope(two * f, dt, (phi * phi, integral)), slope);
            }
        }
        if let (Some(slot), true) = (rate, counts) {
            out.values[slot] = out.values[slot] + slope;
        }
    }
}

/// With this much more in a lane.
fn added<T: Lanes>(numbers: T, lane: usize, more: f64) -> T {
    let mut all = [0.0; MOST];
    numbers.store(&mut all);
    all[lane] += more;
    T::load(&all)
}

/// ∂Q/∂q of a single state: Q/q, or expm1(xδ)/x for a noise of zero.
#[inline(always)]
fn part<T: Lanes>(rate: T, dt: T, noise: T, q: T) -> T {
    let mut all = [0.0; MOST];
    (q / noise).store(&mut all);
    for lane in 0..T::COUNT {
        if noise.lane(lane) == 0.0 {
            all[lane] = scalar_flow(rate.lane(lane), 0.0, dt.lane(lane))[1];
        }
    }
    T::load(&all)
}

/// Evaluates transitions.
struct Fill<'a> {
    plan: &'a Plan,
    /// Of each single state where its flow begins, and the slots of its rate and of its noise.
    singles: Vec<(usize, [Option<usize>; 2])>,
    steps: &'a Transitions,
    values: Slots<'a>,
    inputs: Slots<'a>,
    flows: &'a mut [f64],
    out: Columns<'a>,
}

impl Kernel for Fill<'_> {
    type Output = [bool; MOST];

    #[inline(always)]
    fn run<T: Lanes>(self) -> [bool; MOST] {
        let (plan, places, identity) = (self.plan, self.steps.dt.len(), identity(&self.plan.pattern));
        let (terms, pairs, drives) = (plan.phi.len(), plan.q.len(), plan.drives.len());
        let mut off = T::splat(0.0);
        for t in 0..places / T::COUNT {
            let place = t * T::COUNT;
            for single in 0..self.singles.len() {
                let (offset, [rate, noise]) = self.singles[single];
                let (f, q) = (self.values.some::<T>(rate, place), self.values.some::<T>(noise, place));
                let flow = scalar_flows(f, q, T::load(&self.steps.dt[place..]));
                for k in 0..3 {
                    flow[k].store(&mut self.flows[(offset + k) * places + place..]);
                    off = flow[k].fma(T::splat(0.0), off);
                }
            }
            for k in 0..terms {
                let x = self.entry::<T>(&plan.phi[k], identity[k], place);
                x.store(&mut self.out.phi[(t * terms + k) * T::COUNT..]);
            }
            for k in 0..pairs {
                let x = self.entry::<T>(&plan.q[k], 0.0, place);
                x.store(&mut self.out.q[(t * pairs + k) * T::COUNT..]);
            }
            for k in 0..drives {
                let x = self.drive::<T>(&plan.drives[k], place);
                x.store(&mut self.out.inputs[(t * drives + k) * T::COUNT..]);
            }
        }
        let mut sound = [false; MOST];
        for lane in 0..T::COUNT {
            sound[lane] = off.lane(lane) == 0.0;
        }
        sound
    }
}

impl Fill<'_> {
    /// An entry of φ or Q; `rest` where there is no transition.
    #[inline(always)]
    fn entry<T: Lanes>(&self, entry: &Entry, rest: f64, place: usize) -> T {
        match entry {
            Entry::Slot(slot) => {
                let moving = T::load(&self.steps.moving[place..]);
                moving.fma(self.values.lanes(*slot, place), moving.fnma(T::splat(rest), T::splat(rest)))
            }
            Entry::Flow(at) => self.flow(*at, place),
            Entry::Held(terms) => self.held(terms, &self.values, place),
        }
    }

    #[inline(always)]
    fn drive<T: Lanes>(&self, drive: &Drive, place: usize) -> T {
        match drive {
            Drive::Slot(slot) => T::load(&self.steps.moving[place..]) * self.inputs.lanes(*slot, place),
            Drive::Flow(terms) => self.held(terms, &self.inputs, place),
        }
    }

    #[inline(always)]
    fn held<T: Lanes>(&self, terms: &[(usize, usize)], slots: &Slots<'_>, place: usize) -> T {
        let mut sum = T::splat(0.0);
        for &(at, slot) in terms {
            sum = slots.lanes::<T>(slot, place).fma(self.flow(at, place), sum);
        }
        sum
    }

    #[inline(always)]
    fn flow<T: Lanes>(&self, at: usize, place: usize) -> T {
        T::load(&self.flows[at * self.steps.dt.len() + place..])
    }
}

/// For each entry of φ, that of the identity.
fn identity(pattern: &Pattern) -> Vec<f64> {
    let own = |row: &Moved| {
        let terms = &pattern.columns[row.start as usize..row.end as usize];
        terms.iter().map(|&column| f64::from(u8::from(column == row.state))).collect::<Vec<f64>>()
    };
    pattern.moved.iter().flat_map(own).collect()
}
