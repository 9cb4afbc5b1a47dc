//! The response of the free values to the adjoints of a test: the chain rule of a design as a list of factors, found by
//! setting each adjoint in turn to one and all other adjoints to zero.
//!
//! ```text
//! dℓ/dα = Σ over the adjoints of steps and start of factor × adjoint
//! ```

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use crate::reduce::{Fault, Workspace};
use crate::score::backward::{MeasurementAdjoint, TransitionAdjoint};
use crate::score::pullback::adjoints::Adjoints;
use crate::score::pullback::taps::Gradient;
use kalfit_model::Test;

/// Range of indices of factors: (first, first after the range).
pub(crate) type FactorSpan = (u32, u32);

/// The response to the adjoint of one entry of a matrix or of a list.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ResponseEntry {
    /// Row, or index in the list.
    pub(crate) i: usize,
    /// Column; zero in a list.
    pub(crate) j: usize,
    pub(crate) span: FactorSpan,
}

/// The response to the adjoints of one scalar measurement.
#[derive(Debug, Clone, Default)]
pub(crate) struct RowResponse {
    /// Response to ∂ℓ/∂R.
    pub(crate) noise: FactorSpan,
    /// Response to ∂ℓ/∂(z - d).
    pub(crate) value: FactorSpan,
    /// Response to ∂ℓ/∂h: entries by state.
    pub(crate) h: Range<usize>,
}

/// The response to the adjoints of one transition, as ranges of entries.
#[derive(Debug, Clone, Default)]
pub(crate) struct MoveResponse {
    /// Response to ∂ℓ/∂φ, by index among the rows of φ that move, and column.
    pub(crate) phi: Range<usize>,
    /// Response to ∂ℓ/∂Q, by states; an off-diagonal adjoint is the derivative to both entries together.
    pub(crate) q: Range<usize>,
    /// Response to ∂ℓ/∂b, by state.
    pub(crate) input: Range<usize>,
}

/// The response to all adjoints of a test.
#[derive(Debug, Clone, Default)]
pub(crate) struct PullbackFactors {
    /// Slots of the free values that respond, ascending.
    pub(crate) slots: Vec<usize>,
    /// (index into `slots`, factor).
    factors: Vec<(u32, f64)>,
    entries: Vec<ResponseEntry>,
    /// Response to each scalar measurement of the steps requested.
    pub(crate) rows: Vec<RowResponse>,
    /// Response to each transition to the steps requested.
    pub(crate) moves: Vec<MoveResponse>,
    /// Response to ∂ℓ/∂a, by state.
    pub(crate) mean: Range<usize>,
    /// Response to ∂ℓ/∂P0, by states; an off-diagonal factor belongs to both entries, whose adjoints are equal.
    pub(crate) variance: Range<usize>,
}

impl PullbackFactors {
    /// Pairs (index into `slots`, factor) of a span.
    #[inline(always)]
    pub(crate) fn factors(&self, (from, to): FactorSpan) -> &[(u32, f64)] {
        &self.factors[from as usize..to as usize]
    }

    #[inline(always)]
    pub(crate) fn entries(&self, range: &Range<usize>) -> &[ResponseEntry] {
        &self.entries[range.clone()]
    }

    /// Replaces the slot of each factor by the index of the slot in `slots`.
    fn index_slots(mut self) -> PullbackFactors {
        let mut slots: Vec<usize> = self.factors.iter().map(|&(slot, _)| slot as usize).collect();
        slots.sort_unstable();
        slots.dedup();
        for (slot, _) in &mut self.factors {
            *slot = slots.binary_search(&(*slot as usize)).expect("it is among them") as u32;
        }
        PullbackFactors { slots, ..self }
    }
}

/// Key of the response to one transition: the address of the transition, and the bits of the cells that coefficients
/// with free values read.
type MoveKey = (usize, Vec<u64>);

struct PullbackProbe<'a, 'b> {
    adjoints: &'a mut Adjoints<'b>,
    test: &'a Test,
    work: &'a Workspace,
    response: PullbackFactors,
    known: HashMap<MoveKey, MoveResponse>,
}

impl Adjoints<'_> {
    /// The response to the adjoints of `steps`, in ascending order, and of the start of the test in the work space,
    /// after [`Preparer::prepare`](crate::reduce::Preparer::prepare).
    ///
    /// # Errors
    /// A derivative is not finite, although the gradient may be finite, where the adjoint is zero.
    pub(crate) fn response(
        &mut self,
        (test, work): (&Test, &Workspace),
        steps: impl Iterator<Item = usize>,
    ) -> Result<PullbackFactors, Box<Fault>> {
        let mut probe =
            PullbackProbe { adjoints: self, test, work, response: PullbackFactors::default(), known: HashMap::new() };
        let done = probe.probe_steps(steps);
        let response = probe.response;
        if done.is_err() {
            self.clear();
        }
        done.map(|()| response.index_slots())
    }

    /// Number of adjoints of one transition to which a response is computed.
    pub(crate) fn adjoint_count(&self, work: &Workspace) -> usize {
        let (needs, frame) = (self.pullback.needs, &work.design.frame);
        let (phi, q) = self.pullback.preparer.plan.entries();
        let inputs = needs.rates || needs.inputs;
        usize::from(needs.rates) * phi + usize::from(needs.noise) * q + usize::from(inputs) * frame.driven.len()
    }
}

impl PullbackProbe<'_, '_> {
    fn probe_steps(&mut self, steps: impl Iterator<Item = usize>) -> Result<(), Box<Fault>> {
        let work = self.work;
        for k in steps {
            let step = work.design.step(k);
            if let Some(transition) = step.transition {
                let own = self.transition(k, Arc::as_ptr(transition) as usize)?;
                self.response.moves.push(own);
            }
            for place in 0..step.rows.len() {
                let own = self.measurement(k, place, step.rows.len(), step.rows.start + place)?;
                self.response.rows.push(own);
            }
        }
        self.start()
    }

    /// Stores the response to the adjoints that were given, and returns the span of the factors.
    fn store_factors(&mut self) -> Result<FactorSpan, Box<Fault>> {
        let gradient: Gradient = self.adjoints.finish(self.test, self.work)?;
        let from = self.response.factors.len() as u32;
        self.response.factors.extend(gradient.iter().map(|&(slot, factor)| (slot as u32, factor)));
        Ok((from, self.response.factors.len() as u32))
    }

    /// Stores the response as the entry (i, j), unless the response is empty.
    fn store_entry(&mut self, (i, j): (usize, usize)) -> Result<(), Box<Fault>> {
        let span = self.store_factors()?;
        if span.0 < span.1 {
            self.response.entries.push(ResponseEntry { i, j, span });
        }
        Ok(())
    }

    fn transition(&mut self, k: usize, which: usize) -> Result<MoveResponse, Box<Fault>> {
        let work = self.work;
        let (needs, frame) = (self.adjoints.pullback.needs, &work.design.frame);
        if !(needs.rates || needs.noise || needs.inputs) {
            return Ok(MoveResponse::default());
        }
        let key = (which, self.adjoints.cells(self.test, k, work)?);
        // known inputs may differ from step to step
        if let Some(own) = self.known.get(&key).filter(|_| frame.driven.is_empty()) {
            return Ok(own.clone());
        }
        let transition = work.design.step(k).transition.expect("there is one");
        let pattern = &transition.pattern;
        let zeros = |many: usize| vec![0.0; many];
        let (phi, q, input) = (zeros(transition.phi.len()), zeros(transition.q.len()), zeros(frame.driven.len()));
        let mut bar = TransitionAdjoint { phi, q, input };
        let mut own = MoveResponse::default();
        own.phi.start = self.response.entries.len();
        if needs.rates {
            for (place, row) in pattern.moved.iter().enumerate() {
                for at in row.start as usize..row.end as usize {
                    bar.phi[at] = 1.0;
                    self.moved(k, &bar, (place, pattern.columns[at] as usize))?;
                    bar.phi[at] = 0.0;
                }
            }
        }
        own.phi.end = self.response.entries.len();
        if needs.noise {
            for (at, &(i, j)) in pattern.pairs.iter().enumerate() {
                bar.q[at] = 1.0;
                self.moved(k, &bar, (i as usize, j as usize))?;
                bar.q[at] = 0.0;
            }
        }
        own.q = own.phi.end..self.response.entries.len();
        if needs.rates || needs.inputs {
            for (at, &state) in frame.driven.iter().enumerate() {
                bar.input[at] = 1.0;
                self.moved(k, &bar, (state as usize, 0))?;
                bar.input[at] = 0.0;
            }
        }
        own.input = own.q.end..self.response.entries.len();
        self.known.insert(key, own.clone());
        Ok(own)
    }

    fn moved(&mut self, k: usize, bar: &TransitionAdjoint, at: (usize, usize)) -> Result<(), Box<Fault>> {
        self.adjoints.step_moved(self.test, k, self.work, bar)?;
        self.store_entry(at)
    }

    /// The response to one scalar measurement: index `place` among the `many` measurements of step `k`.
    fn measurement(&mut self, k: usize, place: usize, many: usize, row: usize) -> Result<RowResponse, Box<Fault>> {
        let n = self.work.design.frame.n;
        let pullback = self.adjoints.pullback;
        let taps = &pullback.meters[self.work.instances.get(row).meter];
        let mut own = RowResponse::default();
        let mut bar = MeasurementAdjoint { noise: vec![0.0; many], value: vec![0.0; many], h: vec![0.0; many * n] };
        let mut probe_adjoint = |probe: &mut Self, list: fn(&mut MeasurementAdjoint) -> &mut Vec<f64>, at: usize| {
            list(&mut bar)[at] = 1.0;
            let done = probe.adjoints.step_measured(probe.test, k, probe.work, &bar);
            list(&mut bar)[at] = 0.0;
            done
        };
        if taps.noise.is_some() {
            probe_adjoint(self, |bar| &mut bar.noise, place)?;
            own.noise = self.store_factors()?;
        }
        if taps.constant.is_some() {
            probe_adjoint(self, |bar| &mut bar.value, place)?;
            own.value = self.store_factors()?;
        }
        own.h.start = self.response.entries.len();
        for &(state, _) in &taps.terms {
            probe_adjoint(self, |bar| &mut bar.h, place * n + state)?;
            self.store_entry((state, 0))?;
        }
        own.h.end = self.response.entries.len();
        Ok(own)
    }

    fn start(&mut self) -> Result<(), Box<Fault>> {
        let (n, r) = (self.work.design.frame.n, self.work.design.frame.r);
        let from = self.response.entries.len();
        (self.response.mean, self.response.variance) = (from..from, from..from);
        if !self.adjoints.pullback.needs.start {
            return Ok(());
        }
        let (mut mean, mut variance) = (vec![0.0; n], vec![0.0; r * r]);
        for state in 0..n {
            mean[state] = 1.0;
            self.adjoints.started(self.test, self.work, &mean, &variance)?;
            self.store_entry((state, 0))?;
            mean[state] = 0.0;
        }
        self.response.mean.end = self.response.entries.len();
        for (i, j) in (0..r).flat_map(|i| (0..=i).map(move |j| (i, j))) {
            (variance[i * r + j], variance[j * r + i]) = (1.0, 1.0);
            self.adjoints.started(self.test, self.work, &mean, &variance)?;
            self.store_entry((i, j))?;
            (variance[i * r + j], variance[j * r + i]) = (0.0, 0.0);
        }
        self.response.variance = self.response.mean.end..self.response.entries.len();
        Ok(())
    }
}
