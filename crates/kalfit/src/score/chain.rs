//! From the adjoints of a test's coefficients to dℓ/dα.
//!
//! ```text
//! φ̄, Q̄, b̄ of steps ── groups ──> F̄, Q̄_c, ū ─┐
//! R̄, z̄, h̄ of measurements ── unwhitened ──────┼── taps ──> dℓ/dα
//! ā, P̄0 ── Lyapunov ──────────────────────────┘
//! ```
//!
//! Every coefficient that depends on a free value is a tap: adjoints gather at it and go through its expression once for each
//! run of equal cells. The cost does not depend on the number of free values.

mod groups;
mod measured;
mod moved;
mod response;
mod taps;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;
use std::ops::Range;

use crate::ensemble::Test;
use crate::model::Slots;
use crate::reduce::{
    At, Coefficient, Fault, LawAdjoint, Preparer, ReduceErrorKind, Replay, StartAdjoint, Subject, Workspace,
};

pub(crate) use measured::Measured;
use measured::Measuring;
pub(crate) use moved::Moved;
use moved::Moving;
pub(crate) use response::{Entry, Response};
use taps::{Context, Pending, Read, Taps};

/// Gradient of one test: (slot, dℓ/dvalue), each slot at most once, ascending.
pub(crate) type Gradient = Vec<(usize, f64)>;

/// Adds one gradient to another.
pub(crate) fn add(gradient: &mut Gradient, other: &Gradient) {
    for &(slot, x) in other {
        match gradient.binary_search_by_key(&slot, |&(slot, _)| slot) {
            Ok(at) => gradient[at].1 += x,
            Err(at) => gradient.insert(at, (slot, x)),
        }
    }
}

/// The way from the coefficients of a model at α to its free values. Threads share it.
#[derive(Debug)]
pub(crate) struct Chain<'a> {
    preparer: &'a Preparer,
    slots: &'a Slots,
    taps: Taps,
    /// Tap of each slot of the dynamics' coefficients.
    values: Vec<Option<usize>>,
    /// Tap of each slot of the dynamics' inputs.
    inputs: Vec<Option<usize>>,
    /// For each slot of the dynamics' coefficients, whether it has a tap.
    free: Vec<bool>,
    /// Cells that taps of the dynamics' coefficients read.
    reads: Vec<Read>,
    /// Cells that any tap reads, if any does.
    cells: Option<Vec<Read>>,
    meters: Vec<MeterTaps>,
    pairs: Vec<Option<usize>>,
    /// Tap of each of the start's coefficients.
    start: Vec<Option<usize>>,
    needs: Needs,
}

/// Taps of a measurement.
#[derive(Debug, Clone)]
struct MeterTaps {
    noise: Option<usize>,
    constant: Option<usize>,
    /// (kernel state, tap).
    terms: Vec<(usize, usize)>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Needs {
    /// φ depends on free values, and b through Γ.
    rates: bool,
    inputs: bool,
    noise: bool,
    equation: bool,
    measurements: bool,
    start: bool,
}

impl<'a> Chain<'a> {
    /// `preparer` must have been made with the free parameters of `slots` ([`Preparer::with_free`]). An error where a free
    /// parameter decides which rows count, or when x_0 is: ℓ jumps there.
    pub(crate) fn new(preparer: &'a Preparer, slots: &'a Slots) -> Result<Chain<'a>, Box<Fault>> {
        let at = preparer.at();
        refuse_jumps(&at, preparer)?;
        let mut taps = Taps::default();
        let dynamics = &preparer.dynamics;
        let values = table(&mut taps, &at, &dynamics.table);
        let inputs = table(&mut taps, &at, &dynamics.inputs);
        let mut meters = Vec::new();
        for (noise, constant, terms) in preparer.meters.parts() {
            let (noise, constant) = (taps.add(&at, noise), taps.add(&at, constant));
            let term = |(state, h): &(u32, Coefficient)| Some((*state as usize, taps.add(&at, h)?));
            meters.push(MeterTaps { noise, constant, terms: terms.iter().filter_map(term).collect() });
        }
        let pairs: Vec<Option<usize>> = preparer.meters.pairs().map(|pair| taps.add(&at, pair)).collect();
        let start: Vec<Option<usize>> = preparer.start.coefficients().map(|c| taps.add(&at, c)).collect();
        let reads: BTreeSet<Read> = values.iter().flatten().flat_map(|&tap| taps.reads(tap)).copied().collect();
        let free = values.iter().map(Option::is_some).collect();
        let cells = taps.all_reads();
        let mut chain = Chain {
            preparer,
            slots,
            taps,
            values,
            inputs,
            free,
            reads: reads.into_iter().collect(),
            cells: Some(cells).filter(|cells| !cells.is_empty()),
            meters,
            pairs,
            start,
            needs: Needs::default(),
        };
        chain.needs = chain.find_needs();
        Ok(chain)
    }

    fn find_needs(&self) -> Needs {
        let dynamics = &self.preparer.dynamics;
        let (free, start) = (|slot: usize| self.free[slot], &self.preparer.start);
        let any = |terms: &[(usize, usize, usize)]| terms.iter().any(|&(.., slot)| free(slot));
        let rates = dynamics.components.iter().any(|c| any(&c.rates) || any(&c.held))
            || dynamics.recursions.iter().any(|recursion| recursion.terms.iter().any(|&(_, slot)| free(slot)));
        let noise = any(&dynamics.noise)
            || dynamics.components.iter().any(|c| any(&c.noise) || (any(&c.rates) && !c.noise.is_empty()));
        let noises = self.meters.iter().any(|meter| meter.noise.is_some());
        let covariances = self.pairs.iter().any(Option::is_some);
        let terms = self.meters.iter().any(|meter| !meter.terms.is_empty());
        let constants = self.meters.iter().any(|meter| meter.constant.is_some());
        let settled = (0..self.free.len()).any(|slot| free(slot) && start.needs(slot));
        let driven = (0..self.inputs.len()).any(|slot| self.inputs[slot].is_some() && start.needs_input(slot));
        Needs {
            rates,
            inputs: self.inputs.iter().any(Option::is_some),
            noise,
            // Whitening mixes equations by the noises.
            equation: terms || covariances || (noises && !self.pairs.is_empty()),
            measurements: terms || covariances || noises || constants,
            start: self.start.iter().any(Option::is_some) || settled || driven,
        }
    }

    /// φ depends on free values.
    pub(crate) fn needs_rates(&self) -> bool {
        self.needs.rates
    }

    /// φ or b depends on free values.
    #[cfg(test)]
    pub(crate) fn needs_motion(&self) -> bool {
        self.needs.rates || self.needs.inputs
    }

    /// Q depends on free values.
    #[cfg(test)]
    pub(crate) fn needs_noise(&self) -> bool {
        self.needs.noise
    }

    /// Adjoints of h are needed: h depends on free values, or the whitening of measurements does.
    pub(crate) fn needs_equation(&self) -> bool {
        self.needs.equation
    }

    /// a or P0 depends on free values.
    #[cfg(test)]
    pub(crate) fn needs_start(&self) -> bool {
        self.needs.start
    }

    /// An accumulator, for one test after the other.
    pub(crate) fn adjoints(&self) -> Adjoints<'_> {
        Adjoints {
            chain: self,
            pending: Pending::new(&self.taps, &self.preparer.at(), self.slots),
            moving: Moving::new(self),
            measuring: Measuring::default(),
            replay: Replay::default(),
            start: StartAdjoint::default(),
        }
    }

    fn context(&self) -> Context<'_> {
        Context { at: self.preparer.at(), slots: self.slots, taps: &self.taps }
    }
}

/// Taps of a table, by slot.
fn table(taps: &mut Taps, at: &At<'_>, table: &crate::reduce::Table) -> Vec<Option<usize>> {
    let mut places = vec![None; table.fixed.len()];
    for (slot, coefficient) in table.free.iter().map(|(slot, c)| (*slot, c)) {
        places[slot] = taps.add(at, coefficient);
    }
    for (slot, coefficient, _) in &table.varying {
        places[*slot] = taps.add(at, coefficient);
    }
    places
}

fn refuse_jumps(at: &At<'_>, preparer: &Preparer) -> Result<(), Box<Fault>> {
    let refuse = |coefficient: &Coefficient, subject: Subject| {
        let Some(parameter) = coefficient.source().and_then(|(expression, _)| at.free_parameter(expression)) else {
            return Ok(());
        };
        let parameter = at.model.parameters[parameter].name.clone();
        Err(Fault::new(subject, ReduceErrorKind::FreeParameter { parameter }))
    };
    preparer.meters.filters().try_for_each(|(m, filter)| refuse(filter, Subject::Filter(m)))?;
    preparer.start.initial_time.iter().try_for_each(|time| refuse(time, Subject::InitialTime))
}

/// The adjoints of one test, from its last step to its first, on their way to dℓ/dα.
#[derive(Debug)]
pub(crate) struct Adjoints<'a> {
    chain: &'a Chain<'a>,
    pending: Pending,
    moving: Moving,
    measuring: Measuring,
    replay: Replay,
    start: StartAdjoint,
}

impl Adjoints<'_> {
    /// True when equal steps of one measurement each have coefficients that depend on the free values in the same way, so that
    /// the sums of their adjoints, as those of the first of them, give the same gradient.
    pub(crate) fn uniform(&self, test: &Test, steps: Range<usize>, work: &Workspace) -> bool {
        let chain = self.chain;
        let (first, last) = (work.design.step(steps.start).rows, work.design.step(steps.end - 1).rows);
        if first.is_empty() || !work.instances.uniform(first.start..last.end) {
            return false;
        }
        let Some(reads) = &chain.cells else { return true };
        if !work.same_dt(&steps) {
            return false;
        }
        let rows = work.rows_of(&steps, chain.preparer.reads_previous());
        let (numbers, texts) = (test.numbers(rows.start), test.texts(rows.start));
        reads.iter().all(|read| match *read {
            Read::Step => true,
            Read::Number(column) => {
                rows.clone().all(|row| test.numbers(row)[column].to_bits() == numbers[column].to_bits())
            }
            Read::Text(column) => rows.clone().all(|row| test.texts(row)[column] == texts[column]),
        })
    }

    /// The start of a test, after [`Preparer::prepare`] into `work`. `mean`: ∂ℓ/∂a, n numbers in kernel order; `variance`:
    /// ∂ℓ/∂P0, r × r, symmetric, the derivative to each place by itself. Not read unless [`Chain::needs_start`].
    pub(crate) fn started(
        &mut self,
        test: &Test,
        work: &Workspace,
        mean: &[f64],
        variance: &[f64],
    ) -> Result<(), Box<Fault>> {
        let Adjoints { chain, pending, moving, replay, start: out, .. } = self;
        if !chain.needs.start {
            return Ok(());
        }
        let (preparer, context) = (chain.preparer, chain.context());
        let law = LawAdjoint { place: &preparer.order.place, r: preparer.order.frame.r, mean, variance };
        if !preparer.start.settles() {
            preparer.start.backward(&context.at, (&[], &[]), &law, out)?;
        } else {
            let scope = preparer.settled(test, work, &mut moving.cells)?;
            preparer.settling(&scope, replay)?;
            preparer.start.backward(&context.at, (&replay.values, &replay.inputs), &law, out)?;
            let slots = chain.values.iter().zip(&out.values).chain(chain.inputs.iter().zip(&out.inputs));
            for (tap, &bar) in slots {
                if let Some(tap) = *tap {
                    pending.add(&context, tap, bar, &scope)?;
                }
            }
        }
        let scope = preparer.starting(work);
        for (tap, &bar) in chain.start.iter().zip(&out.coefficients) {
            if let Some(tap) = *tap {
                pending.add(&context, tap, bar, &scope)?;
            }
        }
        Ok(())
    }

    /// The gradient of the test; the next one can begin.
    pub(crate) fn finish(&mut self, test: &Test, work: &Workspace) -> Result<Gradient, Box<Fault>> {
        let result = self.settle(test, work).and_then(|()| self.pending.finish(&self.chain.context()));
        self.clear();
        result
    }

    /// Forgets what was given so far.
    fn clear(&mut self) {
        self.pending.clear();
        self.moving.groups.clear();
    }
}
