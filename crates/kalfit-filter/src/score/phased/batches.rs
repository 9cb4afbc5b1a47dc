//! Scores of tests that were filtered in one batch.

#[cfg(test)]
mod tests;

use rayon::prelude::*;

use crate::reduce::FilteredBatch;
use crate::score::Scorer;
use crate::score::backward::{BatchBackward, TerminalAdjoint};
use crate::score::moments::Moments;
use crate::score::phased::design_classes::ScoredEnsemble;
use crate::score::phased::unclassed::TestScore;
use crate::score::phased::{PhasedScorer, ScoreWorkspace};
use crate::score::pullback::Gradient;
use crate::score::smoother::SmoothedPhase;
use kalfit_model::Test;

/// Place of a test that is not requested.
const NOT_REQUESTED: usize = usize::MAX;

/// (lane, place of the lane's test among the requested tests, smoother result from which the backward pass starts).
type LaneStart<'a> = (usize, usize, &'a SmoothedPhase);

impl PhasedScorer<'_> {
    /// (place, gradient through phase `at`) of each test of `numbers` that is in a batch of the phase, with the place
    /// of the test in `numbers`; tests with an error are omitted.
    pub(super) fn score_in_batches(
        &self,
        at: usize,
        ensemble: ScoredEnsemble<'_>,
        numbers: &[usize],
        known: &[TestScore],
    ) -> Vec<(usize, Gradient)> {
        let Some(filtered) = ensemble.filtered else { return Vec::new() };
        let (members, batches) = filtered.phase(at);
        let rows = |&number: &usize| self.reducer.rows_of(at, &ensemble.tests[number]).expect("members have rows");
        let rows: Vec<&Test> = members.iter().map(rows).collect();
        let mut places = vec![NOT_REQUESTED; ensemble.tests.len()];
        numbers.iter().enumerate().for_each(|(place, &number)| places[number] = place);
        let lane = |(lane, member): (usize, usize)| {
            let place = places[members[member]];
            Some((lane, place, known.get(place)?.phases.get(at)?))
        };
        let batch = |room: &mut ScoreWorkspace<'_>, batch: FilteredBatch<'_>| {
            let lane_starts: Vec<LaneStart<'_>> = batch.tests().filter_map(lane).collect();
            self.phases[at].batch(at, (&lane_starts, &rows), batch, room)
        };
        batches.map_init(|| self.room(), batch).flatten_iter().collect()
    }
}

impl Scorer<'_> {
    fn batch(
        &self,
        at: usize,
        (lane_starts, rows): (&[LaneStart<'_>], &[&Test]),
        batch: FilteredBatch<'_>,
        room: &mut ScoreWorkspace<'_>,
    ) -> Vec<(usize, Gradient)> {
        let Some(columns) = lane_starts.iter().map(|(.., smooth)| smooth.moments.columns).max() else {
            return Vec::new();
        };
        let padded: Vec<Moments> =
            lane_starts.iter().map(|(.., smooth)| smooth.moments.clone().widened(columns)).collect();
        let later: Vec<TerminalAdjoint> = match lane_starts.iter().any(|(.., smooth)| smooth.later.is_some()) {
            true => lane_starts.iter().map(|(.., smooth)| self.ending(smooth, columns)).collect(),
            false => Vec::new(),
        };
        // lanes of tests that are not requested get a copy of the first moments, and are not read
        let mut moments: Vec<&Moments> = vec![&padded[0]; batch.layout.tests.len()];
        lane_starts.iter().zip(&padded).for_each(|(&(lane, ..), padded)| moments[lane] = padded);
        let mut endings: Vec<&TerminalAdjoint> = later.first().map_or(Vec::new(), |first| vec![first; moments.len()]);
        lane_starts.iter().zip(&later).for_each(|(&(lane, ..), later)| endings[lane] = later);
        let (filter, shape, wanted) = (&batch.values.batch_filter, &batch.layout.design, self.wanted());
        let (moments, endings) = (&*moments, &*endings);
        let pass =
            BatchBackward { block: &filter.block, designs: &filter.design_batch, shape, moments, endings, wanted };
        let mut bars = filter.block.width().run(pass);
        let pulled = self.pullback.pull(batch, rows, &mut bars);
        let (adjoints, work) = (&mut room.adjoints[at], &room.work.phases[at]);
        let score = |&(lane, place, _): &LaneStart<'_>| {
            Some((place, adjoints.of_lane((batch, &bars, &pulled), lane, rows, work).ok()?))
        };
        lane_starts.iter().filter_map(score).collect()
    }
}
