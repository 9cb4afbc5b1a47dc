//! Batches of tests with different designs, which stay in lanes for all values of α.
//!
//! ```text
//! once:        cells ── Skeleton ──> BatchLayout steps, measurements and lengths of steps, one test per lane
//! at an α:     coefficients ── BatchValues ──> h, R, z - d, φ, Q, b, a, P0 in lanes ── filters ──> reductions
//! its score:   BatchValues ── backward, pulled back column by column (score/phased/batches) ──> dℓ/dα
//! ```
//!
//! Which tests share a shape, which cells each step reads and what is measured depend on the cells of the data alone,
//! so that one determination holds for all α. For a measurement or a step of the batch that a test lacks, the lane of
//! the test has one that changes nothing. A test that is in error or needs square-root arrays is reduced alone, outside
//! the batch; that reduction reports the error.

pub(crate) mod batch_workspace;
mod identity;
mod layout;
pub(crate) mod reduced;
mod values;
mod whitened;

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use kalfit_lanes::Isa;
use rayon::iter::Either;
use rayon::prelude::*;

use crate::reduce::digest::Digest;
use crate::reduce::lanes::DataWorkspace;
use crate::reduce::prepare::{Preparer, Skeleton, Workspace};
use crate::reduce::reduced_tests::ReducedTests;
use crate::reduce::reducer::{ReducedWithEnd, Reducer};
use crate::reduce::replicates::Replicates;
use batch_workspace::{batch_bytes, width_for};
use kalfit_model::Test;
use kalfit_model::{Alpha, Level};
pub(crate) use layout::BatchLayout;
use reduced::TestHeader;
pub(crate) use values::BatchValues;

/// Memory limit of all batches of an ensemble with the values at one α, in bytes.
const MAX_CACHED_BYTES: usize = 1 << 30;
/// Number of chunks of batches per thread.
const CHUNKS_PER_THREAD: usize = 4;
/// Largest number of batches in a chunk; ensembles of long tests have few batches.
const MAX_CHUNK_BATCHES: usize = 8;

/// A batch of tests in lanes.
#[derive(Debug)]
struct CachedBatch {
    layout: BatchLayout,
    own: Vec<TestHeader>,
    /// Values of the batch, each set at some α, that no [`FilteredBatches`] uses.
    idle: Mutex<Vec<BatchValues>>,
}

/// The tests of an ensemble with different designs, in batches. Which tests share a batch does not depend on the order
/// of the tests.
#[derive(Debug, Default)]
pub(crate) struct EnsembleBatches {
    batches: Vec<CachedBatch>,
    /// Indices of the tests without replicates that fit no batch, whatever α.
    unbatched: Vec<usize>,
    /// The tests that are neither in `batches` nor in `unbatched`.
    unbatched_replicates: Replicates,
}

/// All batches at one α, after the filters have run.
#[derive(Debug)]
pub(crate) struct FilteredBatches {
    ensemble_batches: Arc<EnsembleBatches>,
    /// Values of each batch at the α.
    values: Vec<BatchValues>,
}

impl EnsembleBatches {
    /// Batches of the tests with indices `numbers`, without tests that share a design with another test. `shared`:
    /// indices of a few tests of each design that several tests share. `replicates`: the replicates among all tests.
    pub(crate) fn new(
        reducer: &Reducer,
        (tests, replicates): (&[&Test], Replicates),
        numbers: &[usize],
        shared: &[usize],
    ) -> EnsembleBatches {
        let preparer = reducer.preparer();
        if numbers.is_empty() || !preparer.has_columns() {
            return EnsembleBatches { batches: Vec::new(), unbatched: Vec::new(), unbatched_replicates: replicates };
        }
        let digest = |number: usize, work: &mut Workspace| {
            preparer.prepare(tests[number], work).ok().map(|()| work.design.digest())
        };
        let mut work = reducer.workspace();
        let shared: HashSet<u128> = shared.iter().filter_map(|&number| digest(number, &mut work)).collect();
        let skeleton = |work: &mut Workspace, &number: &usize| {
            let mut own = Skeleton::default();
            let fits = preparer.skeleton(tests[number], number, work, &mut own);
            let mut is_shared = || digest(number, work).is_none_or(|digest| shared.contains(&digest));
            let found = if fits { Ok(own) } else { Err(number) };
            (!fits || shared.is_empty() || !is_shared()).then_some(found)
        };
        let found = numbers.par_iter().map_init(|| reducer.workspace(), skeleton).flatten_iter();
        let (mut skeletons, mut unbatched): (Vec<Skeleton>, Vec<usize>) =
            found.partition_map(|found| found.map_or_else(Either::Right, Either::Left));
        let mut is_alone = vec![false; tests.len()];
        replicates.alone.iter().for_each(|&number| is_alone[number] = true);
        unbatched.retain(|&number| is_alone[number]);
        let id = |own: &Skeleton| &tests[own.number].id;
        skeletons.par_sort_unstable_by(|a, b| a.by_shape(b).then_with(|| id(a).cmp(id(b))));
        let mut bytes = 0;
        let mut groups = groups(preparer, &skeletons);
        groups.retain(|own| {
            let own = batch_bytes(preparer, own, width_for(own.len()).lanes());
            let fits = bytes + own <= MAX_CACHED_BYTES;
            bytes += if fits { own } else { 0 };
            fits
        });
        let batches: Vec<CachedBatch> =
            groups.into_par_iter().map(|own| CachedBatch::new(reducer, tests, own)).collect();
        let mut is_assigned = vec![false; tests.len()];
        batches
            .iter()
            .flat_map(|batch| &batch.layout.tests)
            .chain(&unbatched)
            .for_each(|&number| is_assigned[number] = true);
        EnsembleBatches { batches, unbatched, unbatched_replicates: replicates.without(&is_assigned) }
    }

    /// Reductions and errors of all tests at the α of `reducer`, and the batches after the filters.
    pub(crate) fn reduce(
        self: &Arc<EnsembleBatches>,
        reducer: &Reducer,
        tests: &[&Test],
    ) -> (ReducedTests, FilteredBatches) {
        let (filtered, mut found) = self.filter_all(reducer, tests);
        let exceptional = std::mem::take(&mut found.exceptional);
        let root = |work: &mut Workspace, &number: &usize| match reducer.reduce_by_root(tests[number], work) {
            Ok((reduction, class)) => Ok((reduction, reducer.ending(&class, work.pass.x.iter().copied()))),
            Err(_) => reducer.reduce_to_end(tests[number], work),
        };
        let rooted: Vec<ReducedWithEnd> = exceptional.par_iter().map_init(|| reducer.workspace(), root).collect();
        exceptional.into_iter().zip(rooted).for_each(|(number, rooted)| found.note(number, rooted));
        let alone = |work: &mut Workspace, &number: &usize| reducer.reduce_to_end(tests[number], work);
        let ends: Vec<ReducedWithEnd> = self.unbatched.par_iter().map_init(|| reducer.workspace(), alone).collect();
        self.unbatched.iter().zip(ends).for_each(|(&number, end)| found.note(number, end));
        found.take(vec![reducer.reduce_each(tests, &self.unbatched_replicates)], tests.len());
        (found, filtered)
    }

    /// Runs the filters of all batches at the α of `reducer`.
    fn filter_all(self: &Arc<EnsembleBatches>, reducer: &Reducer, tests: &[&Test]) -> (FilteredBatches, ReducedTests) {
        let mut alpha = Digest::new();
        digest_alpha(&mut alpha, reducer.preparer().at().alpha);
        let alpha = alpha.finish();
        let filter_chunk = |scratch: &mut DataWorkspace, batches: &[CachedBatch]| {
            let mut found = ReducedTests::default();
            let values = batches
                .iter()
                .map(|batch| batch.evaluate_and_filter((reducer, alpha), tests, scratch, &mut found))
                .collect();
            (values, found)
        };
        let chunk_len =
            (self.batches.len() / (CHUNKS_PER_THREAD * rayon::current_num_threads())).clamp(1, MAX_CHUNK_BATCHES);
        let filtered_chunks: Vec<(Vec<BatchValues>, ReducedTests)> =
            self.batches.par_chunks(chunk_len).map_init(DataWorkspace::default, filter_chunk).collect();
        let (values, parts): (Vec<Vec<BatchValues>>, Vec<ReducedTests>) = filtered_chunks.into_iter().unzip();
        let (values, mut all_reduced) = (values.into_iter().flatten().collect(), ReducedTests::default());
        all_reduced.take(parts, tests.len());
        (FilteredBatches { ensemble_batches: self.clone(), values }, all_reduced)
    }

    /// Indices of the tests that are in batches.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = usize> {
        self.batches.iter().flat_map(|batch| &batch.layout.tests).copied()
    }
}

/// Splits tests, sorted by shape, into the groups that become batches.
fn groups<'a>(preparer: &Preparer, skeletons: &'a [Skeleton]) -> Vec<&'a [Skeleton]> {
    let (mut remaining, mut groups) = (skeletons, Vec::new());
    while !remaining.is_empty() {
        let (group, rest) = remaining.split_at(batch_workspace::batch_len(preparer, remaining, Isa::best().lanes()));
        groups.push(group);
        remaining = rest;
    }
    groups
}

/// Adds all values of α to a digest.
fn digest_alpha(digest: &mut Digest, alpha: &Alpha) {
    for level in &alpha.values {
        match level {
            Level::Common(value) => digest.numbers(&[*value]),
            Level::Each { values, other, .. } => {
                digest.count(values.len());
                values.values().chain(other).for_each(|value| digest.numbers(&[*value]));
            }
        }
    }
}

impl CachedBatch {
    fn new(reducer: &Reducer, tests: &[&Test], own: &[Skeleton]) -> CachedBatch {
        let preparer = reducer.preparer();
        let width = width_for(own.len());
        let (mut layout, mut values) = (BatchLayout::new(width, preparer), BatchValues::new(width));
        layout.take(preparer, tests, own);
        values.take(&layout, (preparer, tests));
        let steps: Vec<usize> = own.iter().map(Skeleton::len).collect();
        let digests = values.design_digests(&layout, &steps, &mut Vec::new());
        let own = own.iter().zip(digests).enumerate().map(|(lane, (own, digest))| TestHeader {
            digest: if values.valid[lane] { digest } else { own.number as u128 }, // a number that is no digest of another test
            covariates: own.covariates.clone(),
            steps: own.len(),
            observations: own.instances.len(),
        });
        CachedBatch { own: own.collect(), layout, idle: Mutex::new(vec![values]) }
    }

    /// Evaluates the tests of the batch at the α of `reducer` and runs the filters. `alpha`: digest of α.
    fn evaluate_and_filter(
        &self,
        (reducer, alpha): (&Reducer, u128),
        tests: &[&Test],
        scratch: &mut DataWorkspace,
        found: &mut ReducedTests,
    ) -> BatchValues {
        let CachedBatch { layout, own, .. } = self;
        let idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut values = idle.unwrap_or_else(|| {
            let mut values = BatchValues::new(width_for(own.len()));
            values.take(layout, (reducer.preparer(), tests));
            values
        });
        values.evaluate(layout, (reducer.preparer(), tests), false);
        let digest = |own: &TestHeader| {
            let mut digest = Digest::new();
            digest.wide(own.digest);
            digest.wide(alpha);
            digest.finish()
        };
        values.reduce((layout, own), (reducer, digest), tests, scratch, found);
        values
    }
}

/// One batch at an α, after the filters have run.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FilteredBatch<'a> {
    pub(crate) layout: &'a BatchLayout,
    pub(crate) values: &'a BatchValues,
}

impl FilteredBatch<'_> {
    /// (lane, index of the test) of each test that was filtered in the batch.
    pub(crate) fn tests(&self) -> impl Iterator<Item = (usize, usize)> {
        self.layout.tests.iter().copied().enumerate().filter(|&(lane, _)| self.values.valid[lane])
    }
}

impl FilteredBatches {
    /// The batches, as a parallel iterator.
    pub(crate) fn batches(&self) -> impl IndexedParallelIterator<Item = FilteredBatch<'_>> {
        let batches_with_values = self.ensemble_batches.batches.par_iter().zip(&self.values);
        batches_with_values.map(|(batch, values)| FilteredBatch { layout: &batch.layout, values })
    }
}

impl Drop for FilteredBatches {
    fn drop(&mut self) {
        for (batch, values) in self.ensemble_batches.batches.iter().zip(self.values.drain(..)) {
            batch.idle.lock().unwrap_or_else(PoisonError::into_inner).push(values);
        }
    }
}
