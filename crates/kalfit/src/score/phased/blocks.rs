//! Scores of tests that are kept side by side.

#[cfg(test)]
mod tests;

use rayon::prelude::*;

use crate::ensemble::Test;
use crate::reduce::{Blocks, Filtered, FilteredBlock, PhasedTest};
use crate::score::Companies;
use crate::score::backward::Abreast;
use crate::score::moments::{Moments, moments};
use crate::score::phased::together::{Ensemble, Score};
use crate::score::phased::{PhasedScorer, Room};

impl PhasedScorer<'_> {
    /// The tests that have no company, where they can be kept side by side.
    pub(crate) fn blocks(&self, tests: &[PhasedTest], companies: &Companies) -> Option<Blocks> {
        let shared: Vec<usize> = companies.companies.iter().map(|company| company[0]).collect();
        self.reducer.blocks(tests, &companies.alone, &shared)
    }

    /// The scores of tests in blocks; those with which something is wrong are scored by themselves.
    pub(super) fn in_blocks(&self, of: Ensemble<'_>, filtered: &Filtered) -> Vec<Score> {
        let rows = |test| self.rows_of(0, test).expect("tests in blocks have rows");
        let tests: Vec<&Test> = of.tests.iter().map(rows).collect();
        let block = |room: &mut Room<'_>, block: FilteredBlock<'_>| self.block(of, &tests, block, room);
        let all: Vec<(usize, Option<Score>)> =
            filtered.blocks().map_init(|| self.room(), block).flatten_iter().collect();
        let odd: Vec<usize> = all.iter().filter(|(_, score)| score.is_none()).map(|(number, _)| *number).collect();
        let mut scores: Vec<Score> = all.into_iter().filter_map(|(_, score)| score).collect();
        scores.extend(self.apart(of, &odd));
        scores
    }

    fn block(
        &self,
        of: Ensemble<'_>,
        tests: &[&Test],
        block: FilteredBlock<'_>,
        room: &mut Room<'_>,
    ) -> Vec<(usize, Option<Score>)> {
        let own: Vec<(usize, usize)> = block.tests().collect();
        let told: Vec<Moments> = own.iter().map(|&(_, number)| moments(of.reductions.get(number), of.law)).collect();
        let Some(columns) = told.iter().map(|moments| moments.columns).max() else { return Vec::new() };
        let told: Vec<Moments> = told.into_iter().map(|moments| moments.widened(columns)).collect();
        // lanes of other tests are not looked at
        let mut lanes: Vec<&Moments> = vec![&told[0]; block.layout.tests.len()];
        own.iter().zip(&told).for_each(|(&(lane, _), moments)| lanes[lane] = moments);
        let (kept, scorer) = (&block.values.kept, &self.phases[0]);
        let (longest, wanted) = (&block.layout.design, scorer.wanted());
        let pass = Abreast { block: &kept.block, gained: &kept.gained, longest, moments: &lanes, endings: &[], wanted };
        let bars = pass.pass();
        let pulled = scorer.chain.pull(block, &bars);
        let (adjoints, work) = (&mut room.adjoints[0], &room.work.phases[0]);
        let mut score = |(lane, number): (usize, usize)| {
            let gradient = adjoints.of_lane((block, &bars, &pulled), lane, tests, work).ok();
            (number, gradient.map(|gradient| (number, Ok(gradient))))
        };
        own.iter().map(|&own| score(own)).collect()
    }
}
