//! Tests in phases, many at a time: each phase of all of them, then each test as a whole.

use rayon::prelude::*;

use crate::ensemble::Test;
use crate::reduce::batch_reducer::{BatchReducer, joined, share};
use crate::reduce::blocks::reduced::ToEnd;
use crate::reduce::error::ReduceError;
use crate::reduce::part::ReducedPhase;
use crate::reduce::phased::{PhasedReducer, PhasedWork};
use crate::reduce::{Evidence, PhaseReduction, PhasedTest, Reduction, Reductions};

/// Reduces batches of tests in phases.
#[derive(Debug)]
struct PhasedBatch<'a> {
    reducer: &'a PhasedReducer,
    /// One for each phase.
    phases: Vec<BatchReducer<'a>>,
    /// For phases that go one by one.
    work: PhasedWork,
}

impl PhasedReducer {
    /// The reductions of tests, in their order: over (ξ_1, …, ξ_I), P = Σ p_i numbers, zero rows and columns for phases that a
    /// test lacks, with the [`Chain`](crate::reduce::Chain) where the model has several phases.
    ///
    /// # Errors
    /// Of several tests in error, the first one's error; of several phases, the first one's.
    pub fn reduce(&mut self, tests: &[PhasedTest]) -> Result<Reductions, ReduceError> {
        if let Some((phase, rows)) = self.plain(tests) {
            return phase.reducer.reduce_all(&rows);
        }
        let rows = tests.iter().map(PhasedTest::row_count).sum();
        let batches = tests
            .par_chunks(share(tests.len(), rows))
            .map_init(|| PhasedBatch::new(self), |batch, tests| batch.reduce(tests).into_iter().collect())
            .collect();
        joined(batches)
    }

    /// Phases of tests one by one, whether the phases before them are known or not: (id of the test, phase, what is known of it).
    ///
    /// # Errors
    /// Of several in error, the first one's error.
    pub fn each_piece(&mut self, phases: &[(&str, usize, &Evidence)]) -> Result<Vec<PhaseReduction>, ReduceError> {
        let rows = |evidence: &Evidence| if let Evidence::Rows(rows) = evidence { rows.rows() } else { 0 };
        let rows = phases.iter().map(|(_, _, evidence)| rows(evidence)).sum();
        let batches: Vec<Vec<Result<PhaseReduction, ReduceError>>> = phases
            .par_chunks(share(phases.len(), rows))
            .map_init(|| PhasedBatch::new(self), |batch, phases| batch.pieces(phases))
            .collect();
        batches.into_iter().flatten().collect()
    }
}

impl<'a> PhasedBatch<'a> {
    fn new(reducer: &'a PhasedReducer) -> PhasedBatch<'a> {
        let phases = reducer.phases.iter().map(|phase| BatchReducer::new(&phase.reducer)).collect();
        PhasedBatch { reducer, phases, work: reducer.workspace() }
    }

    /// The reductions of tests, in their order; of several phases of a test in error, the first one's error.
    fn reduce(&mut self, tests: &[PhasedTest]) -> Vec<Result<Reduction, ReduceError>> {
        let mut found: Vec<Vec<Option<ToEnd>>> = tests.iter().map(|_| Vec::new()).collect();
        for (at, batch) in self.phases.iter_mut().enumerate() {
            let (numbers, rows) = self.reducer.members(at, tests);
            found.iter_mut().for_each(|own| own.push(None));
            numbers.into_iter().zip(batch.reduce_to_end(&rows)).for_each(|(number, end)| found[number][at] = Some(end));
        }
        let (reducer, work) = (self.reducer, &mut self.work);
        let parts = tests.iter().zip(found).map(|(test, found)| reducer.parts(test, found, work, false)).collect();
        reducer.wholes(tests, parts)
    }

    /// Phases of tests by themselves, in their order: (id of the test, phase, what is known of it).
    fn pieces(&mut self, phases: &[(&str, usize, &Evidence)]) -> Vec<Result<PhaseReduction, ReduceError>> {
        let mut pieces: Vec<Option<Result<PhaseReduction, ReduceError>>> = Vec::new();
        pieces.resize_with(phases.len(), || None);
        let mut lines: Vec<(Vec<usize>, Vec<&Test>)> = self.phases.iter().map(|_| Default::default()).collect();
        for (number, &(id, at, evidence)) in phases.iter().enumerate() {
            let phase = &self.reducer.phases[at];
            match evidence {
                Evidence::Rows(rows) if phase.is_optimal() => {
                    lines[at].0.push(number);
                    lines[at].1.push(rows);
                }
                _ => {
                    let room = (&mut self.work.phases[at], &mut self.work.cells);
                    pieces[number] =
                        Some(phase.part((id, evidence), room, (false, false)).map(ReducedPhase::into_piece));
                }
            }
        }
        for (at, (numbers, rows)) in lines.into_iter().enumerate() {
            let found = self.phases[at].reduce_to_end(&rows);
            for ((number, rows), found) in numbers.into_iter().zip(rows).zip(found) {
                let part = self.reducer.phases[at].joined(rows, found, &mut self.work.cells);
                pieces[number] = Some(part.map(ReducedPhase::into_piece));
            }
        }
        pieces.into_iter().map(|piece| piece.expect("every phase was looked at")).collect()
    }
}
