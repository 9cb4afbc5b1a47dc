//! What the filters of tests in lanes have found, as reductions.

use std::sync::Arc;

use crate::ensemble::Test;
use crate::reduce::blocks::layout::BatchLayout;
use crate::reduce::blocks::values::BatchValues;
use crate::reduce::data::Outcome;
use crate::reduce::lanes::DataWorkspace;
use crate::reduce::reducer::{Reducer, ReductionHeader, ToEnd};
use crate::reduce::terminal::TerminalState;
use crate::reduce::{Path, ReduceError, Reductions};

/// What a reduction has from its test, whatever α.
#[derive(Debug)]
pub(super) struct TestHeader {
    pub(super) digest: u128,
    pub(super) covariates: Vec<f64>,
    pub(super) steps: usize,
    pub(super) observations: usize,
}

/// Reductions as they come.
#[derive(Debug, Default)]
pub(crate) struct ReducedTests {
    pub(crate) reductions: Reductions,
    /// The number of the test of each.
    pub(crate) numbers: Vec<usize>,
    /// Where each ends; none where that is not wanted.
    pub(crate) terminals: Vec<TerminalState>,
    /// Tests that must be looked at by themselves.
    pub(crate) odd: Vec<usize>,
    /// What is wrong with tests.
    pub(crate) faults: Vec<(usize, ReduceError)>,
}

impl ReducedTests {
    /// Takes what was found of a test by itself.
    pub(crate) fn note(&mut self, number: usize, found: ToEnd) {
        match found {
            Ok((reduction, end)) => {
                self.reductions.push(reduction);
                self.numbers.push(number);
                self.terminals.extend(end);
            }
            Err(error) => self.faults.push((number, error)),
        }
    }

    /// Takes all of others, of so many tests that there are at last.
    pub(crate) fn take(&mut self, others: Vec<ReducedTests>, tests: usize) {
        let mut parts = Vec::with_capacity(others.len());
        for other in others {
            self.numbers.extend(other.numbers);
            self.terminals.extend(other.terminals);
            self.odd.extend(other.odd);
            self.faults.extend(other.faults);
            parts.push(other.reductions);
        }
        self.reductions.take(parts, tests);
    }

    /// The same in the order of the tests, where it is not asked where they end.
    pub(crate) fn sorted(mut self) -> ReducedTests {
        if self.terminals.is_empty() {
            self.reductions = self.reductions.in_order(&self.numbers);
            self.numbers.sort_unstable();
        }
        self
    }

    /// The reductions in the order of the tests; of several tests in error, the first one's error.
    pub(crate) fn ordered(self) -> Result<Reductions, ReduceError> {
        match self.faults.into_iter().min_by_key(|(number, _)| *number) {
            Some((_, error)) => Err(error),
            None => Ok(self.reductions.in_order(&self.numbers)),
        }
    }

    /// What was found of each of so many tests, by number.
    pub(crate) fn by_number(self, tests: usize) -> Vec<ToEnd> {
        let mut all: Vec<Option<ToEnd>> = (0..tests).map(|_| None).collect();
        let mut terminals = self.terminals.into_iter();
        for (row, &number) in self.reductions.iter().zip(&self.numbers) {
            all[number] = Some(Ok((row.into(), terminals.next())));
        }
        self.faults.into_iter().for_each(|(number, error)| all[number] = Some(Err(error)));
        all.into_iter().map(|found| found.expect("every test was looked at")).collect()
    }
}

impl BatchValues {
    /// Runs the filters of tests that were evaluated. `digest`: of a design.
    pub(super) fn filter(
        &mut self,
        (layout, own): (&BatchLayout, &[TestHeader]),
        (reducer, digest): (&Reducer, impl Fn(&TestHeader) -> u128),
        tests: &[&Test],
        room: &mut DataWorkspace,
        found: &mut ReducedTests,
    ) {
        self.batch_filter.design_batch.with_ends = reducer.wants_ends();
        self.batch_filter.filter(&layout.design, own.len(), room);
        for (lane, (own, &number)) in own.iter().zip(&layout.tests).enumerate() {
            let Some((factor, outcome, end)) = self.of(lane, (layout, own.observations), reducer, room) else {
                self.sound[lane] = false;
                found.odd.push(number);
                continue;
            };
            let about = ReductionHeader {
                factor,
                covariates: &own.covariates,
                steps: own.steps,
                observations: own.observations,
                path: Path::Information,
                digest: digest(own),
            };
            found.reductions.put(reducer.row(tests[number], &outcome, about));
            found.numbers.push(number);
            found.terminals.extend(end);
        }
    }

    /// R and what the filter found of the test in a lane, and where it ends, if that is wanted; `None` where square-root arrays are
    /// called for or something is not finite.
    pub(super) fn of(
        &self,
        lane: usize,
        (layout, observations): (&BatchLayout, usize),
        reducer: &Reducer,
        room: &DataWorkspace,
    ) -> Option<(&[f64], Outcome, Option<TerminalState>)> {
        let (factor, determinant) = self.batch_filter.design_batch.found[lane].as_ref().filter(|_| self.sound[lane])?;
        let outcome = self.batch_filter.block.outcome(lane, (observations, *determinant), room);
        let end = match reducer.wants_ends() {
            true => Some(self.end(lane, layout, reducer, room)?),
            false => None,
        };
        outcome.is_finite().then_some((factor, outcome, end))
    }

    /// Where the test in a lane ends; `None` where that calls for square-root arrays.
    fn end(&self, lane: usize, layout: &BatchLayout, reducer: &Reducer, room: &DataWorkspace) -> Option<TerminalState> {
        let states = &reducer.preparer().order.states;
        let end = self.batch_filter.design_batch.end((lane, layout.lanes), states)?;
        Some(TerminalState::new(Arc::new(end), states, self.batch_filter.block.last(lane, room)))
    }
}
