//! The transitions of many tests side by side, of a motion that calls for no matrix exponential; and the way back to its
//! coefficients.

use kalfit_lanes::{Isa, Kernel, Lanes, MOST};

use crate::linalg::exponential::{scalar_flow, scalar_flows, scalar_slope};
use crate::reduce::design::{Moved, Pattern};
use crate::reduce::dynamics::{Component, Dynamics, Table};
use crate::reduce::lanes::Columns;
use crate::reduce::motion::{Drive, Entry, Plan, check_noise};

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

impl Plan {
    /// Whether φ or b depends on Γ of a component, of single states all.
    fn holds_over(&self, component: usize) -> bool {
        let gamma = |terms: &[(usize, usize)]| terms.iter().any(|&(at, _)| at == 3 * component + 1);
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
        flows.resize(3 * dynamics.components.len() * steps.dt.len(), 0.0);
        let (values, inputs) = (Slots::new(&dynamics.table, values), Slots::new(&dynamics.inputs, inputs));
        isa.run(Fill {
            plan: self,
            rates: dynamics.components.iter().map(rates).collect(),
            steps,
            values,
            inputs,
            flows,
            out,
        })
    }

    /// The way back from these transitions. `free`: coefficients that count.
    pub(crate) fn back<'a>(
        &'a self,
        dynamics: &'a Dynamics,
        (steps, motion): (&'a Transitions, &'a MotionColumns),
        free: &'a [bool],
    ) -> MotionBack<'a> {
        let component = |(c, component): (usize, &Component)| {
            let [rate, noise] = rates(component);
            Single { rate, noise, counts: rate.is_some_and(|slot| free[slot]), holds: self.holds_over(c) }
        };
        MotionBack {
            plan: self,
            steps,
            flows: &motion.flows,
            singles: dynamics.components.iter().enumerate().map(component).collect(),
            values: Slots::new(&dynamics.table, &motion.values),
            inputs: Slots::new(&dynamics.inputs, &motion.inputs),
        }
    }
}

/// A component of one state.
struct Single {
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
    values: Slots<'a>,
    inputs: Slots<'a>,
}

/// Adjoints of one transition, in lanes: of the flows (work space), of the coefficients and of the inputs.
#[derive(Debug, Clone)]
pub(crate) struct MotionBars<T> {
    flows: Vec<T>,
    pub(crate) values: Vec<T>,
    pub(crate) inputs: Vec<T>,
}

impl MotionBack<'_> {
    /// Adjoints of zero.
    #[inline(always)]
    pub(crate) fn zero<T: Lanes>(&self) -> MotionBars<T> {
        let zero = T::splat(0.0);
        let (flows, values, inputs) = (3 * self.singles.len(), self.values.fixed.len(), self.inputs.fixed.len());
        MotionBars { flows: vec![zero; flows], values: vec![zero; values], inputs: vec![zero; inputs] }
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
        for c in 0..self.singles.len() {
            self.single(c, place, out);
        }
    }

    /// From φ, Γ and Q of a single state to its rate and its noise.
    #[inline(always)]
    fn single<T: Lanes>(&self, c: usize, place: usize, out: &mut MotionBars<T>) {
        let Single { rate, noise, counts, holds } = self.singles[c];
        let (places, two) = (self.steps.dt.len(), T::splat(2.0));
        let (dt, phi) = (T::load(&self.steps.dt[place..]), T::load(&self.flows[3 * c * places + place..]));
        let f = self.values.some::<T>(rate, place);
        let mut slope = out.flows[3 * c] * dt * phi;
        if holds && counts {
            let gamma = T::load(&self.flows[(3 * c + 1) * places + place..]);
            slope = out.flows[3 * c + 1].fma(scalar_slope(f, dt, (phi, gamma)), slope);
        }
        if let Some(slot) = noise {
            let (q, bar) = (self.values.lanes::<T>(slot, place), out.flows[3 * c + 2]);
            let integral = part(two * f, dt, q, T::load(&self.flows[(3 * c + 2) * places + place..]));
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
    /// Slots of the rate and of the noise of each component.
    rates: Vec<[Option<usize>; 2]>,
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
            for c in 0..self.rates.len() {
                let [rate, noise] = self.rates[c];
                let (f, q) = (self.values.some::<T>(rate, place), self.values.some::<T>(noise, place));
                let flow = scalar_flows(f, q, T::load(&self.steps.dt[place..]));
                for k in 0..3 {
                    flow[k].store(&mut self.flows[(3 * c + k) * places + place..]);
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
