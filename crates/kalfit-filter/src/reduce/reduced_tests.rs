//! What is found of tests, in the order in which they are done.

use crate::reduce::reducer::ToEnd;
use crate::reduce::terminal::TerminalState;
use crate::reduce::{ReduceError, Reductions};

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
