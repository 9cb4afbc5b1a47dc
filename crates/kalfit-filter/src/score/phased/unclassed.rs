//! Scores of tests that are in no class, phase by phase: in lanes for tests in batches, one by one for all other tests.

use rayon::prelude::*;

use crate::reduce::ReduceError;
use crate::score::phased::design_classes::{Score, ScoredEnsemble};
use crate::score::phased::{PhasedScorer, ScoreWorkspace};
use crate::score::pullback::{Gradient, add};
use crate::score::smoother::SmoothedPhase;

/// The parts of one test's score that are known so far.
#[derive(Debug, Default)]
pub(super) struct TestScore {
    /// Results of the smoother for each phase, from which the passes over the phase start.
    pub(super) phases: Vec<SmoothedPhase>,
    /// Gradient through each phase, then the gradient through the carries.
    parts: Vec<Gradient>,
    /// The error of the first phase that failed; `None` where no phase has failed.
    error: Option<ReduceError>,
}

impl TestScore {
    fn take(&mut self, at: usize, score: Result<Gradient, ReduceError>) {
        match score {
            Ok(gradient) => self.parts[at] = gradient,
            Err(error) => self.error = self.error.take().or(Some(error)),
        }
    }

    fn score(self) -> Result<Gradient, ReduceError> {
        if let Some(error) = self.error {
            return Err(error);
        }
        let mut parts = self.parts.into_iter();
        let mut sum = parts.next().unwrap_or_default();
        parts.for_each(|part| add(&mut sum, &part));
        Ok(sum)
    }
}

impl PhasedScorer<'_> {
    /// The scores of the tests with the indices `numbers`.
    pub(super) fn score_unclassed(&self, ensemble: ScoredEnsemble<'_>, numbers: &[usize]) -> Vec<Score> {
        let begin = |room: &mut ScoreWorkspace<'_>, &number: &usize| self.start_test(ensemble, number, room);
        let mut known: Vec<TestScore> = numbers.par_iter().map_init(|| self.room(), begin).collect();
        for at in 0..self.phases.len() {
            let mut remaining: Vec<bool> = known.iter().map(|known| known.error.is_none()).collect();
            for (place, gradient) in self.score_in_batches(at, ensemble, numbers, &known) {
                remaining[place] = false;
                known[place].parts[at] = gradient;
            }
            let remaining: Vec<usize> = (0..numbers.len()).filter(|&place| remaining[place]).collect();
            for (place, score) in self.score_one_by_one(at, ensemble, (numbers, remaining), &known) {
                known[place].take(at, score.map_err(|error| self.reducer.phases()[at].named(error)));
            }
        }
        numbers.iter().copied().zip(known.into_iter().map(TestScore::score)).collect()
    }

    fn start_test(&self, ensemble: ScoredEnsemble<'_>, number: usize, room: &mut ScoreWorkspace<'_>) -> TestScore {
        let mut known = TestScore { parts: vec![Gradient::new(); self.phases.len() + 1], ..TestScore::default() };
        let mut begin = || {
            let phases = self.begin(ensemble, number, &mut room.work)?;
            let carry_gradient = self.carry_gradient(&ensemble.tests[number], &phases, room)?;
            Ok((phases, carry_gradient))
        };
        match begin() {
            Ok((phases, carry_gradient)) => {
                known.phases = phases;
                known.parts[self.phases.len()] = carry_gradient;
            }
            Err(error) => known.error = Some(error),
        }
        known
    }

    /// (place, gradient through phase `at`) of each test at `places` in `numbers`, computed test by test.
    fn score_one_by_one(
        &self,
        at: usize,
        ensemble: ScoredEnsemble<'_>,
        (numbers, places): (&[usize], Vec<usize>),
        known: &[TestScore],
    ) -> Vec<(usize, Result<Gradient, ReduceError>)> {
        let alone = |room: &mut ScoreWorkspace<'_>, place: usize| {
            let rows = self.reducer.rows_of(at, &ensemble.tests[numbers[place]])?;
            let (scorer, smooth) = (&self.phases[at], &known[place].phases[at]);
            let ending = scorer.ending_of(smooth);
            let work = (&mut room.work.phases[at], &mut room.backward, &mut room.adjoints[at]);
            Some((place, scorer.alone(rows, (&smooth.moments, ending.as_ref()), work)))
        };
        places.into_par_iter().map_init(|| self.room(), alone).flatten_iter().collect()
    }
}
