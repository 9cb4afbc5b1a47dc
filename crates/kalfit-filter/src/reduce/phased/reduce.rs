//! Reduces many tests in phases at a time: each phase of all tests, then each test as a whole.

use rayon::prelude::*;

use crate::reduce::Reductions;
use crate::reduce::error::ReduceError;
use crate::reduce::phased::{PhasedReducer, PhasedWork};
use crate::reduce::reducer::ReducedWithEnd;
use kalfit_model::Test;
use kalfit_model::{Evidence, PhaseReduction, PhasedTest};

/// Largest number of tests whose phases are in memory at the same time.
const MOST_TESTS_AT_ONCE: usize = 1 << 12;

impl PhasedReducer {
    /// The reductions of `tests`, in the order of `tests`: over (ξ_1, …, ξ_I), P = Σ p_i numbers, with zero rows and
    /// columns for phases that a test lacks, and with the [`Chain`](crate::reduce::Chain) where the model has several
    /// phases.
    ///
    /// # Errors
    /// The error of the first phase in error of the first test in error.
    pub fn reduce(&self, tests: &[PhasedTest]) -> Result<Reductions, ReduceError> {
        if let Some((phase, rows)) = self.plain(tests) {
            return phase.reducer.reduce_all(&rows);
        }
        let some = |tests: &[PhasedTest]| {
            let batches = self.batches(tests, self.replicates(tests), (&[], &[]));
            Ok(self.reduce_batches(tests, &batches)?.0)
        };
        Ok(Reductions::joined(tests.chunks(MOST_TESTS_AT_ONCE).map(some).collect::<Result<_, _>>()?))
    }

    /// Reduces single phases of tests, given as (id of the test, phase, evidence), even where the phases before such a
    /// phase are unknown.
    ///
    /// # Errors
    /// The error of the first phase in error.
    pub fn each_piece(&self, phases: &[(&str, usize, &Evidence)]) -> Result<Vec<PhaseReduction>, ReduceError> {
        let mut found: Vec<Option<ReducedWithEnd>> = phases.iter().map(|_| None).collect();
        for (at, phase) in self.phases.iter().enumerate().filter(|(_, phase)| phase.is_optimal()) {
            let own = phases.iter().enumerate().filter_map(|(number, &(_, of, evidence))| match evidence {
                Evidence::Rows(rows) if of == at => Some((number, rows)),
                _ => None,
            });
            let (numbers, rows): (Vec<usize>, Vec<&Test>) = own.unzip();
            let ends = phase.reducer.reduce_each(&rows, &phase.reducer.replicates(&rows)).by_number(rows.len());
            numbers.into_iter().zip(ends).for_each(|(number, end)| found[number] = Some(end));
        }
        let piece =
            |work: &mut PhasedWork, (&phase, found)| Ok(self.part(phase, found, work, (false, false))?.into_piece());
        let pieces = phases.par_iter().zip(found).map_init(|| self.workspace(), piece);
        pieces.collect::<Vec<Result<PhaseReduction, ReduceError>>>().into_iter().collect()
    }
}
