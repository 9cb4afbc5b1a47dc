//! dℓ/dα of a test, exactly, by one backward pass (theory §6), whatever the number of parameters.
//!
//! ```text
//! Test at α, moments (x̂, V) of ξ ── backward ──> adjoints of φ, Q, M, R, b, d, a, P0 ── chain ──> dℓ/dα
//! ```

mod backward;
mod chain;
mod complete;
mod expected;
mod levels;
mod moments;
mod slots;
mod smoother;
#[cfg(test)]
mod tests;

use std::ops::Range;

use rayon::prelude::*;

use crate::ensemble::Test;
use crate::reduce::{Fault, ReduceError, Reducer, Workspace};
use backward::{BackwardWork, MeasuredBar, MovedBar, Run, Sink, Wanted};
use chain::{Adjoints, Chain, Measured, Moved};

pub use slots::{Slot, Slots};

pub(crate) use chain::Gradient;
pub(crate) use complete::Complete;
pub(crate) use levels::Levels;
pub(crate) use moments::{Moments, moments};

/// Scores of tests at the α of a reducer.
#[derive(Debug)]
pub(crate) struct Scorer<'a> {
    reducer: &'a Reducer,
    chain: Chain<'a>,
}

impl<'a> Scorer<'a> {
    /// `reducer` must know the slots ([`Reducer::scoring`]).
    pub(crate) fn new(reducer: &'a Reducer, slots: &'a Slots) -> Result<Scorer<'a>, ReduceError> {
        let chain =
            Chain::new(reducer.preparer(), slots).map_err(|fault| fault.name(&reducer.preparer().model, None))?;
        Ok(Scorer { reducer, chain })
    }

    /// dℓ_j/dα of each test, with the moments of its ξ.
    pub(crate) fn scores(&self, tests: &[Test], moments: &[Moments]) -> Result<Vec<Gradient>, ReduceError> {
        let room = || (self.reducer.workspace(), BackwardWork::default(), self.chain.adjoints());
        let one = |room: &mut (Workspace, BackwardWork, Adjoints<'_>), (test, moments): (&Test, &Moments)| {
            let (work, backward, adjoints) = room;
            self.one(test, moments, work, backward, adjoints)
        };
        let all: Vec<Result<Gradient, ReduceError>> =
            tests.par_iter().zip(moments).map_init(room, |room, pair| one(room, pair)).collect();
        all.into_iter().collect()
    }

    /// Moments of the complete data of each test (the E-step), with the moments of its ξ.
    pub(crate) fn all_complete(&self, tests: &[Test], moments: &[Moments]) -> Result<Vec<Complete>, ReduceError> {
        let room = || (self.reducer.workspace(), BackwardWork::default());
        let one = |(work, backward): &mut (Workspace, BackwardWork), (test, moments): (&Test, &Moments)| {
            self.complete(test, moments, (work, backward))
        };
        let all: Vec<Result<Complete, ReduceError>> =
            tests.par_iter().zip(moments).map_init(room, |room, pair| one(room, pair)).collect();
        all.into_iter().collect()
    }

    /// The expected log-likelihood of the complete data of each test and its gradient, at the α of the reducer; `None` where
    /// the complete data of some test could not have come about.
    pub(crate) fn all_expected(
        &self,
        tests: &[Test],
        complete: &[Complete],
    ) -> Result<Option<Vec<(f64, Gradient)>>, ReduceError> {
        let room = || (self.reducer.workspace(), self.chain.adjoints());
        let one = |(work, adjoints): &mut (Workspace, Adjoints<'_>), (test, complete): (&Test, &Complete)| {
            self.expected(test, complete, (work, adjoints))
        };
        let all: Vec<Result<Option<(f64, Gradient)>, ReduceError>> =
            tests.par_iter().zip(complete).map_init(room, |room, pair| one(room, pair)).collect();
        all.into_iter().collect()
    }

    fn one(
        &self,
        test: &Test,
        moments: &Moments,
        work: &mut Workspace,
        backward: &mut BackwardWork,
        adjoints: &mut Adjoints<'_>,
    ) -> Result<Gradient, ReduceError> {
        let wanted = Wanted { motion: self.chain.needs_rates(), equation: self.chain.needs_equation() };
        backward.set_unfrozen(self.reducer.is_unfrozen());
        let result = self.reducer.with_gains(test, work, |gains, work| {
            let run = Run {
                design: &work.design,
                gains,
                start: &work.data.start,
                inputs: &work.data.inputs,
                values: &work.data.values,
                moments,
                ending: None,
                wanted,
            };
            let mut onward = Onward { adjoints, test, work };
            run.backward(backward, &mut onward)?;
            adjoints.finish(test, work)
        })?;
        result.map_err(|fault| fault.name(&self.reducer.preparer().model, Some(test)))
    }
}

/// Takes the adjoints of a test on to the chain rule.
struct Onward<'a, 'b> {
    adjoints: &'a mut Adjoints<'b>,
    test: &'a Test,
    work: &'a Workspace,
}

impl Sink for Onward<'_, '_> {
    type Error = Box<Fault>;

    fn sums(&mut self, steps: Range<usize>) -> bool {
        self.adjoints.uniform(self.test, steps, self.work)
    }

    fn measured(&mut self, k: usize, bar: &MeasuredBar) -> Result<(), Box<Fault>> {
        let bars = Measured { noise: &bar.noise, value: &bar.value, h: &bar.h };
        self.adjoints.step_measured(self.test, k, self.work, bars)
    }

    fn moved(&mut self, k: usize, bar: &MovedBar) -> Result<(), Box<Fault>> {
        let bars = Moved { phi: &bar.phi, q: &bar.q, input: &bar.input };
        self.adjoints.step_moved(self.test, k, self.work, bars)
    }

    fn started(&mut self, mean: &[f64], variance: &[f64]) -> Result<(), Box<Fault>> {
        self.adjoints.started(self.test, self.work, mean, variance)
    }
}
