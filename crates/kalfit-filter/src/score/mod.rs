//! The exact dℓ/dα of a test from one backward pass (theory §6), for any number of parameters.
//!
//! ```text
//! Test at α, moments (x̂, V) of ξ ── backward ──> adjoints of φ, Q, M, R, b, d, a, P0 ── pullback ──> dℓ/dα
//! ```

mod backward;
mod batching;
#[cfg(test)]
pub(crate) mod by_differences;
mod classes;
mod complete;
mod expected;
mod initial_law;
mod levels;
mod moments;
mod phased;
mod pullback;
mod segments;
mod smoother;
#[cfg(test)]
mod tests;

use std::ops::Range;

use crate::reduce::{Fault, Gains, ReduceError, Reducer, Workspace};
use backward::{MeasurementAdjoint, Sink, TerminalAdjoint, TransitionAdjoint};
use kalfit_model::Slots;
use kalfit_model::Test;
use pullback::{Adjoints, Pullback};

use smoother::SmoothedPhase;

pub use backward::{AdjointsWanted, BackwardInput, BackwardWork, FilterSnapshot, Smoothed};
pub use batching::Batching;
pub(crate) use classes::classes_of;
pub use initial_law::{InitialLaw, JointPosteriors, by_columns};
pub use levels::{Levels, carried, dependences};
pub use moments::{ExactConditional, Moments, expected_square};
pub use phased::{PhasedComplete, PhasedScorer};
pub use pullback::{Gradient, add};
pub use smoother::{PhaseLaws, SmootherPlan};

/// Scores of tests at the α of a reducer.
#[derive(Debug)]
pub(crate) struct Scorer<'a> {
    reducer: &'a Reducer,
    pullback: Pullback<'a>,
}

impl<'a> Scorer<'a> {
    /// A scorer at the α of `reducer`, which must have been made for `slots` ([`Reducer::scoring`]).
    pub(crate) fn new(reducer: &'a Reducer, slots: &'a Slots) -> Result<Scorer<'a>, ReduceError> {
        let pullback =
            Pullback::new(reducer.preparer(), slots).map_err(|fault| fault.name(&reducer.preparer().model, None))?;
        Ok(Scorer { reducer, pullback })
    }

    /// Adjoints of a phase's last state from the later phases; `None` where no phase follows.
    fn ending_of(&self, smooth: &SmoothedPhase) -> Option<TerminalAdjoint> {
        smooth.later.is_some().then(|| self.ending(smooth, smooth.moments.columns))
    }

    /// Adjoints of a phase's last state in kernel order, zero where no phase follows. ρ is padded with zeros to
    /// `columns` columns.
    fn ending(&self, smooth: &SmoothedPhase, columns: usize) -> TerminalAdjoint {
        let order = &self.reducer.preparer().order;
        let (n, r) = (order.frame.n, order.frame.r);
        let mut ending = TerminalAdjoint { r: vec![0.0; n], rho: vec![0.0; n * columns], N: vec![0.0; r * r] };
        let Some(later) = &smooth.later else { return ending };
        for (i, &at) in order.place.iter().enumerate() {
            ending.r[at] = later.r[i];
            (0..later.rho.ncols()).for_each(|k| ending.rho[at * columns + k] = later.rho[(i, k)]);
            for (j, &to) in order.place.iter().enumerate().filter(|(_, to)| at.max(**to) < r) {
                ending.N[at * r + to] = later.N[(i, j)];
            }
        }
        ending
    }

    /// Adjoints that the pullback needs from a backward pass.
    fn wanted(&self) -> AdjointsWanted {
        AdjointsWanted { motion: self.pullback.needs_rates(), equation: self.pullback.needs_equation() }
    }

    /// dℓ_j/dα of one test, given the moments of ξ and, from later phases, the adjoints of the last state of the test.
    pub(crate) fn alone(
        &self,
        test: &Test,
        (moments, ending): (&Moments, Option<&TerminalAdjoint>),
        (work, backward, adjoints): (&mut Workspace, &mut BackwardWork, &mut Adjoints<'_>),
    ) -> Result<Gradient, ReduceError> {
        backward.set_unfrozen(self.reducer.is_unfrozen());
        let mut pass = |gains: &Gains, work: &mut Workspace| {
            let input = BackwardInput::of((work, gains), (moments, ending), self.wanted());
            let mut sink = PullbackSink { adjoints, test, work };
            if !input.sums_suffice(&mut sink) {
                return None;
            }
            let done = input.backward(backward, &mut sink);
            Some(adjoints.finish_after(done, test, work))
        };
        let result = match self.reducer.with_segmented_gains(test, work, &mut pass)? {
            Some(result) => result,
            None => self.reducer.with_prepared(test, work, pass)?.expect("no stretch is cut"),
        };
        result.map_err(|fault| self.reducer.named(*fault, test))
    }
}

/// A sink that passes the adjoints of a test on to the chain rule.
struct PullbackSink<'a, 'b> {
    adjoints: &'a mut Adjoints<'b>,
    test: &'a Test,
    work: &'a Workspace,
}

impl Sink for PullbackSink<'_, '_> {
    type Error = Box<Fault>;

    fn accepts_sums(&mut self, steps: Range<usize>) -> bool {
        self.adjoints.uniform(self.test, steps, self.work)
    }

    fn measured(&mut self, k: usize, bar: &MeasurementAdjoint) -> Result<(), Box<Fault>> {
        self.adjoints.step_measured(self.test, k, self.work, bar)
    }

    fn moved(&mut self, k: usize, bar: &TransitionAdjoint) -> Result<(), Box<Fault>> {
        self.adjoints.step_moved(self.test, k, self.work, bar)
    }

    fn started(&mut self, mean: &[f64], variance: &[f64]) -> Result<(), Box<Fault>> {
        self.adjoints.started(self.test, self.work, mean, variance)
    }
}
