//! Collects the results of tests, in the order in which the tests are finished.

use crate::reduce::reducer::ReducedWithEnd;
use crate::reduce::terminal::TerminalState;
use crate::reduce::{ReduceError, Reductions};

/// Reductions and errors of tests, in the order in which the tests are finished.
#[derive(Debug, Default)]
pub(crate) struct ReducedTests {
    pub(crate) reductions: Reductions,
    /// Index of the test of each reduction.
    pub(crate) numbers: Vec<usize>,
    /// Last state of each test; empty where last states are not requested.
    pub(crate) terminals: Vec<TerminalState>,
    /// Indices of the tests that must be reduced one by one instead of in lanes.
    pub(crate) exceptional: Vec<usize>,
    /// (index of the test, error) for each test in error.
    pub(crate) faults: Vec<(usize, ReduceError)>,
}

impl ReducedTests {
    /// Adds the result of a test that was reduced alone.
    pub(crate) fn note(&mut self, number: usize, found: ReducedWithEnd) {
        match found {
            Ok((reduction, end)) => {
                self.reductions.push(reduction);
                self.numbers.push(number);
                self.terminals.extend(end);
            }
            Err(error) => self.faults.push((number, error)),
        }
    }

    /// Adds all results of `others`. `tests`: final number of tests, for which memory is reserved.
    pub(crate) fn take(&mut self, others: Vec<ReducedTests>, tests: usize) {
        let mut parts = Vec::with_capacity(others.len());
        for other in others {
            self.numbers.extend(other.numbers);
            self.terminals.extend(other.terminals);
            self.exceptional.extend(other.exceptional);
            self.faults.extend(other.faults);
            parts.push(other.reductions);
        }
        self.reductions.take(parts, tests);
    }

    /// The results with the reductions in the order of the tests; unchanged where last states are requested.
    pub(crate) fn sorted(mut self) -> ReducedTests {
        if self.terminals.is_empty() {
            self.reductions = self.reductions.in_order(&self.numbers);
            self.numbers.sort_unstable();
        }
        self
    }

    /// The reductions in the order of the tests, or the error of the first test in error.
    pub(crate) fn ordered(self) -> Result<Reductions, ReduceError> {
        match self.faults.into_iter().min_by_key(|(number, _)| *number) {
            Some((_, error)) => Err(error),
            None => Ok(self.reductions.in_order(&self.numbers)),
        }
    }

    /// The result of each test, by index of the test. `tests`: number of tests.
    pub(crate) fn by_number(self, tests: usize) -> Vec<ReducedWithEnd> {
        let mut results: Vec<Option<ReducedWithEnd>> = (0..tests).map(|_| None).collect();
        let mut terminals = self.terminals.into_iter();
        for (row, &number) in self.reductions.iter().zip(&self.numbers) {
            results[number] = Some(Ok((row.into(), terminals.next())));
        }
        self.faults.into_iter().for_each(|(number, error)| results[number] = Some(Err(error)));
        results.into_iter().map(|found| found.expect("every test was looked at")).collect()
    }
}
