//! Tests in phases whose phases are kept side by side for all values of α: each phase of each test among the rows of its like.

use std::sync::Arc;

use rayon::prelude::*;

use crate::ensemble::Test;
use crate::reduce::batch_reducer::share;
use crate::reduce::blocks::reduced::ToEnd;
use crate::reduce::blocks::{EnsembleBatches, FilteredBatch, FilteredBatches};
use crate::reduce::error::ReduceError;
use crate::reduce::part::ReducedPhase;
use crate::reduce::phased::{PhasedReducer, PhasedWork};
use crate::reduce::{PhaseReduction, PhasedTest, Reduction, Reductions};

/// The phases of tests with designs of their own.
#[derive(Debug)]
pub(crate) struct PhasedBatches {
    phases: Vec<Members>,
    /// Whether a phase of a test is in a block.
    pub(crate) has: Vec<bool>,
}

/// The tests that have rows in a phase.
#[derive(Debug)]
struct Members {
    /// By number, ascending.
    numbers: Arc<Vec<usize>>,
    blocks: Arc<EnsembleBatches>,
}

/// Tests in phases at an α, after their filters.
#[derive(Debug)]
pub(crate) struct FilteredPhases {
    phases: Vec<(Arc<Vec<usize>>, FilteredBatches)>,
    /// By test, the phases of those that are in blocks; empty where there is one phase.
    pieces: Vec<Option<Vec<PhaseReduction>>>,
}

impl FilteredPhases {
    /// The phases of a test by themselves, where they are known.
    pub(crate) fn pieces(&self, number: usize) -> Option<&[PhaseReduction]> {
        self.pieces.get(number)?.as_deref()
    }

    /// The numbers of the tests that have rows in a phase, and the blocks of these, for several threads.
    pub(crate) fn phase(&self, at: usize) -> (&[usize], impl IndexedParallelIterator<Item = FilteredBatch<'_>>) {
        let (numbers, filtered) = &self.phases[at];
        (numbers, filtered.blocks())
    }
}

impl PhasedReducer {
    /// The tests with designs of their own, to be kept side by side: of those with the numbers `alone`. `shared`: some of each kind of
    /// the others.
    pub(crate) fn blocks(&self, tests: &[PhasedTest], alone: &[usize], shared: &[usize]) -> Option<PhasedBatches> {
        let mut has = vec![false; tests.len()];
        let mut phase = |at: usize| {
            let (numbers, rows) = self.members(at, tests);
            let places = |wanted: &[usize]| -> Vec<usize> {
                wanted.iter().filter_map(|number| numbers.binary_search(number).ok()).collect()
            };
            let blocks = EnsembleBatches::new(&self.phases[at].reducer, &rows, &places(alone), &places(shared));
            blocks.numbers().for_each(|place| has[numbers[place]] = true);
            Members { numbers: Arc::new(numbers), blocks: Arc::new(blocks) }
        };
        let phases: Vec<Members> = (0..self.phases.len()).map(&mut phase).collect();
        has.contains(&true).then_some(PhasedBatches { phases, has })
    }

    /// The tests, by number, that have rows in a phase for the optimal filter; and these rows.
    pub(super) fn members<'t>(&self, at: usize, tests: &'t [PhasedTest]) -> (Vec<usize>, Vec<&'t Test>) {
        let rows = |(number, test): (usize, &'t PhasedTest)| Some((number, self.rows_of(at, test)?));
        tests.iter().enumerate().filter_map(rows).unzip()
    }

    /// As [`PhasedReducer::reduce`], phases in their blocks.
    pub(crate) fn reduce_blocks(
        &self,
        tests: &[PhasedTest],
        blocks: &PhasedBatches,
    ) -> Result<(Reductions, FilteredPhases), ReduceError> {
        if let Some((phase, rows)) = self.plain(tests) {
            let Members { numbers, blocks } = &blocks.phases[0];
            let (reductions, filtered) = blocks.reduce(&phase.reducer, &rows)?;
            return Ok((reductions, FilteredPhases { phases: vec![(numbers.clone(), filtered)], pieces: Vec::new() }));
        }
        let mut found: Vec<Vec<Option<ToEnd>>> = tests.iter().map(|_| Vec::new()).collect();
        let mut phases = Vec::with_capacity(self.phases.len());
        for (at, Members { numbers, blocks }) in blocks.phases.iter().enumerate() {
            let rows = numbers.iter().filter_map(|&number| self.rows_of(at, &tests[number]));
            let (ends, filtered) = blocks.reduce_to_end(&self.phases[at].reducer, &rows.collect::<Vec<_>>());
            found.iter_mut().for_each(|own| own.push(None));
            numbers.iter().zip(ends).for_each(|(&number, end)| found[number][at] = Some(end));
            phases.push((numbers.clone(), filtered));
        }
        let rows = tests.iter().map(PhasedTest::row_count).sum();
        let size = share(tests.len(), rows);
        let chunks = tests.par_chunks(size).zip(blocks.has.par_chunks(size)).zip(found.into_par_iter().chunks(size));
        let whole = |work: &mut PhasedWork, ((tests, has), found): ((&[PhasedTest], &[bool]), Vec<_>)| {
            let parts: Vec<_> =
                tests.iter().zip(found).map(|(test, found)| self.parts(test, found, work, false)).collect();
            let pieces = parts.iter().zip(has).map(|(parts, &has)| pieces(parts.as_deref().ok().filter(|_| has)));
            let pieces: Vec<_> = pieces.collect();
            self.wholes(tests, parts).into_iter().zip(pieces).collect::<Vec<_>>()
        };
        let all: Vec<(Result<Reduction, ReduceError>, _)> =
            chunks.map_init(|| self.workspace(), whole).flatten_iter().collect();
        let (reductions, pieces): (Vec<_>, Vec<_>) = all.into_iter().unzip();
        let reductions = reductions.into_iter().collect::<Result<_, _>>()?;
        Ok((reductions, FilteredPhases { phases, pieces }))
    }
}

/// The phases of a test by themselves.
fn pieces(parts: Option<&[ReducedPhase<'_>]>) -> Option<Vec<PhaseReduction>> {
    Some(parts?.iter().map(|part| part.clone().into_piece()).collect())
}
