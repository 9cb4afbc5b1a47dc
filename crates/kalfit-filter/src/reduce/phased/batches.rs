//! Tests in phases, batched phase by phase with tests of similar rows; the batches serve for all values of α.

use std::sync::Arc;

use rayon::prelude::*;

use crate::reduce::Reductions;
use crate::reduce::batches::{EnsembleBatches, FilteredBatch, FilteredBatches};
use crate::reduce::chunk_size::chunk_size;
use crate::reduce::error::ReduceError;
use crate::reduce::part::ReducedPhase;
use crate::reduce::phased::replicates::PhaseReplicates;
use crate::reduce::phased::{PhasedReducer, PhasedWork};
use crate::reduce::reducer::ReducedWithEnd;
use kalfit_model::Reduction;
use kalfit_model::Test;
use kalfit_model::{PhaseReduction, PhasedTest};

/// Batches of the phases of tests.
#[derive(Debug)]
pub struct PhasedBatches {
    phases: Vec<PhaseMembers>,
    /// For each test, whether any phase is in a batch.
    pub(crate) has: Vec<bool>,
}

/// The tests that have rows in a phase.
#[derive(Debug)]
struct PhaseMembers {
    /// Indices of the tests, ascending.
    numbers: Arc<Vec<usize>>,
    batches: Arc<EnsembleBatches>,
}

/// Tests in phases at one α, after the filters of the phases have run.
#[derive(Debug)]
pub struct FilteredPhases {
    phases: Vec<(Arc<Vec<usize>>, FilteredBatches)>,
    /// Reductions of the phases of each test, `None` for a test in no batch; empty where the model has one phase.
    pieces: Vec<Option<Vec<PhaseReduction>>>,
}

impl FilteredPhases {
    /// Reductions of the separate phases of test `number`; `None` for a test in no batch.
    pub(crate) fn pieces(&self, number: usize) -> Option<&[PhaseReduction]> {
        self.pieces.get(number)?.as_deref()
    }

    /// Indices of the tests that have rows in phase `at`, and the batches of these tests as a parallel iterator.
    pub(crate) fn phase(&self, at: usize) -> (&[usize], impl IndexedParallelIterator<Item = FilteredBatch<'_>>) {
        let (numbers, filtered) = &self.phases[at];
        (numbers, filtered.batches())
    }
}

impl PhasedReducer {
    /// Forms the batches of the phases of tests. `alone`: indices of tests that remain in lanes where no other test has
    /// the same design; `shared`: indices of a few tests of each design that several tests share.
    pub(crate) fn batches(
        &self,
        tests: &[PhasedTest],
        phases: Vec<PhaseReplicates>,
        (alone, shared): (&[usize], &[usize]),
    ) -> PhasedBatches {
        let mut has = vec![false; tests.len()];
        let mut phase = |(at, PhaseReplicates { numbers, replicates }): (usize, PhaseReplicates)| {
            let rows: Vec<&Test> = numbers.iter().filter_map(|&number| self.rows_of(at, &tests[number])).collect();
            let places = |wanted: &[usize]| -> Vec<usize> {
                wanted.iter().filter_map(|number| numbers.binary_search(number).ok()).collect()
            };
            let reducer = &self.phases[at].reducer;
            let batches = EnsembleBatches::new(reducer, (&rows, replicates), &places(alone), &places(shared));
            batches.numbers().for_each(|place| has[numbers[place]] = true);
            PhaseMembers { numbers: Arc::new(numbers), batches: Arc::new(batches) }
        };
        let phases = phases.into_iter().enumerate().map(&mut phase).collect();
        PhasedBatches { phases, has }
    }

    /// Reduces tests as [`PhasedReducer::reduce`] does, with the phases of the tests in given batches.
    pub(crate) fn reduce_batches(
        &self,
        tests: &[PhasedTest],
        batches: &PhasedBatches,
    ) -> Result<(Reductions, FilteredPhases), ReduceError> {
        let filter = |at: usize, rows: &[&Test]| {
            let PhaseMembers { numbers, batches: own } = &batches.phases[at];
            let (found, filtered) = own.reduce(&self.phases[at].reducer, rows);
            (found, (numbers.clone(), filtered))
        };
        if let Some((_, rows)) = self.plain(tests) {
            let (found, phase) = filter(0, &rows);
            return Ok((found.ordered()?, FilteredPhases { phases: vec![phase], pieces: Vec::new() }));
        }
        let mut found: Vec<Vec<Option<ReducedWithEnd>>> = tests.iter().map(|_| Vec::new()).collect();
        let mut phases = Vec::with_capacity(self.phases.len());
        for (at, PhaseMembers { numbers, .. }) in batches.phases.iter().enumerate() {
            let rows = numbers.iter().filter_map(|&number| self.rows_of(at, &tests[number]));
            let (ends, phase) = filter(at, &rows.collect::<Vec<_>>());
            found.iter_mut().for_each(|own| own.push(None));
            let ends = numbers.iter().zip(ends.by_number(numbers.len()));
            ends.for_each(|(&number, end)| found[number][at] = Some(end));
            phases.push(phase);
        }
        let rows = tests.iter().map(PhasedTest::row_count).sum();
        let size = chunk_size(tests.len(), rows);
        let chunks = tests.par_chunks(size).zip(batches.has.par_chunks(size)).zip(found.into_par_iter().chunks(size));
        let whole = |work: &mut PhasedWork, ((tests, has), found): ((&[PhasedTest], &[bool]), Vec<_>)| {
            let parts: Vec<_> =
                tests.iter().zip(found).map(|(test, found)| self.parts(test, found, work, false)).collect();
            let pieces = parts.iter().zip(has).map(|(parts, &has)| pieces(parts.as_deref().ok().filter(|_| has)));
            let pieces: Vec<_> = pieces.collect();
            self.reduce_wholes(tests, parts).into_iter().zip(pieces).collect::<Vec<_>>()
        };
        let all: Vec<(Result<Reduction, ReduceError>, _)> =
            chunks.map_init(|| self.workspace(), whole).flatten_iter().collect();
        let (reductions, pieces): (Vec<_>, Vec<_>) = all.into_iter().unzip();
        let reductions = reductions.into_iter().collect::<Result<_, _>>()?;
        Ok((reductions, FilteredPhases { phases, pieces }))
    }
}

/// Owned copies of the reductions of a test's phases.
fn pieces(parts: Option<&[ReducedPhase<'_>]>) -> Option<Vec<PhaseReduction>> {
    Some(parts?.iter().map(|part| part.clone().into_piece()).collect())
}
