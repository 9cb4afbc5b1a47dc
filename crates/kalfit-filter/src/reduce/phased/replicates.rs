//! Replicates among tests in phases, phase by phase and as a whole.

use std::collections::BTreeMap;

use crate::reduce::phased::PhasedReducer;
use crate::reduce::replicates::Replicates;
use kalfit_model::PhasedTest;
use kalfit_model::Test;

/// The tests that have rows in a phase for the optimal filter.
#[derive(Debug)]
pub struct PhaseReplicates {
    /// Indices of the tests, ascending.
    pub(super) numbers: Vec<usize>,
    /// Sets of replicates, by index into `numbers`.
    pub(super) replicates: Replicates,
}

/// Status of a test in one phase: without rows, without replicates, or in the set with this index.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum PhaseStanding {
    NoRows,
    Alone,
    Set(usize),
}

impl PhasedReducer {
    /// The replicates among tests in each phase, which do not depend on α.
    pub(crate) fn replicates(&self, tests: &[PhasedTest]) -> Vec<PhaseReplicates> {
        let phase = |at: usize| {
            let (numbers, rows) = self.members(at, tests);
            PhaseReplicates { numbers, replicates: self.phases[at].reducer.replicates(&rows) }
        };
        (0..self.phases.len()).map(phase).collect()
    }

    /// (indices, rows) of the tests that have rows for the optimal filter in phase `at`.
    pub(super) fn members<'t>(&self, at: usize, tests: &'t [PhasedTest]) -> (Vec<usize>, Vec<&'t Test>) {
        let rows = |(number, test): (usize, &'t PhasedTest)| Some((number, self.rows_of(at, test)?));
        tests.iter().enumerate().filter_map(rows).unzip()
    }
}

impl PhaseReplicates {
    /// The tests that are replicates of each other in all of the given phases.
    pub(crate) fn in_all(phases: &[PhaseReplicates], tests: &[PhasedTest]) -> Replicates {
        let standings: Vec<Vec<PhaseStanding>> = phases.iter().map(|phase| phase.standings(tests.len())).collect();
        let mut known: BTreeMap<(usize, Vec<PhaseStanding>), usize> = BTreeMap::new();
        let first = |(number, test): (usize, &PhasedTest)| {
            let own = standings.iter().map(|phase| phase[number]);
            match own.clone().any(|standing| standing == PhaseStanding::Alone) {
                true => number,
                false => *known.entry((test.phases.len(), own.collect())).or_insert(number),
            }
        };
        Replicates::from_firsts(&tests.iter().enumerate().map(first).collect::<Vec<_>>())
    }

    fn standings(&self, tests: usize) -> Vec<PhaseStanding> {
        let mut standings = vec![PhaseStanding::NoRows; tests];
        self.numbers.iter().for_each(|&number| standings[number] = PhaseStanding::Alone);
        for (at, set) in self.replicates.sets.iter().enumerate() {
            set.iter().for_each(|&place| standings[self.numbers[place]] = PhaseStanding::Set(at));
        }
        standings
    }
}
