//! Scores of replicates, tests of one design class.

use rayon::prelude::*;

use crate::reduce::{FilteredPhases, ReduceError, Reductions, same_bits};
use crate::score::InitialLaw;
use crate::score::Scorer;
use crate::score::classes::ClassMember;
use crate::score::phased::{PhasedScorer, Plans, ScoreWorkspace};
use crate::score::pullback::{Gradient, add};
use crate::score::smoother::SmoothedPhase;
use kalfit_model::PhasedTest;

/// Number of tests whose starts one thread prepares at a time.
const TESTS_PER_TASK: usize = 64;

/// (index of a test, score of the test).
pub(super) type Score = (usize, Result<Gradient, ReduceError>);

/// An ensemble under a law of ξ.
#[derive(Clone, Copy)]
pub(super) struct ScoredEnsemble<'a> {
    pub(super) tests: &'a [PhasedTest],
    pub(super) reductions: &'a Reductions,
    pub(super) law: &'a InitialLaw,
    pub(super) plans: &'a Plans,
    /// Batches of tests that the filters have passed.
    pub(super) filtered: Option<&'a FilteredPhases>,
}

/// The start of the score of one test of a class: (x̂, r of the last state) of each phase, and the gradient through the
/// carries.
struct MemberStart {
    phases: Vec<(Vec<f64>, Vec<f64>)>,
    carry_gradient: Gradient,
}

impl PhasedScorer<'_> {
    /// Scores of the tests of a class, in one pass where that is possible, otherwise one by one.
    pub(super) fn score_class(
        &self,
        ensemble: ScoredEnsemble<'_>,
        numbers: &[usize],
        room: &mut ScoreWorkspace<'_>,
    ) -> Vec<Score> {
        match self.together(ensemble, numbers, room) {
            Ok(Some(scores)) => numbers.iter().copied().zip(scores.into_iter().map(Ok)).collect(),
            // one by one, an error is reported for the test that has it
            Ok(None) | Err(_) => self.score_unclassed(ensemble, numbers),
        }
    }

    /// Scores of a class in one pass; `None` where one pass would save nothing, or where the tests must be scored one
    /// by one.
    pub(super) fn together(
        &self,
        ensemble: ScoredEnsemble<'_>,
        numbers: &[usize],
        room: &mut ScoreWorkspace<'_>,
    ) -> Result<Option<Vec<Gradient>>, ReduceError> {
        let first = numbers[0];
        let first_smoothed = self.begin(ensemble, first, &mut room.work)?;
        let begin = |numbers: &[usize]| {
            let mut room = self.room();
            numbers
                .iter()
                .map(|&number| self.member_start(ensemble, (first, number), &first_smoothed, &mut room))
                .collect::<Vec<_>>()
        };
        let member_start: Vec<Result<Option<MemberStart>, ReduceError>> = if numbers.len() <= TESTS_PER_TASK {
            begin(numbers)
        } else {
            numbers.par_chunks(TESTS_PER_TASK).flat_map_iter(begin).collect()
        };
        let Some(mut member_start) =
            member_start.into_iter().collect::<Result<Option<Vec<MemberStart>>, ReduceError>>()?
        else {
            return Ok(None);
        };
        let mut scores: Vec<Gradient> =
            member_start.iter_mut().map(|member_start| std::mem::take(&mut member_start.carry_gradient)).collect();
        for (at, smooth) in first_smoothed.iter().enumerate() {
            if self.reducer.rows_of(at, &ensemble.tests[first]).is_none() {
                continue;
            }
            let members = |(&number, member_start): (&usize, &mut MemberStart)| {
                let test = self.reducer.rows_of(at, &ensemble.tests[number]).expect("alike tests have the same phases");
                let (mean, ending) = std::mem::take(&mut member_start.phases[at]);
                ClassMember { test, mean, ending }
            };
            let members: Vec<ClassMember<'_>> = numbers.iter().zip(&mut member_start).map(members).collect();
            let scorer = &self.phases[at];
            let ending = scorer.ending_of(smooth);
            let work = (&mut room.work.phases[at], &mut room.backward, &mut room.adjoints[at]);
            let Some(own) = scorer.score_class(&members, (&smooth.moments, ending.as_ref()), work)? else {
                return Ok(None);
            };
            scores.iter_mut().zip(&own).for_each(|(score, own)| add(score, own));
        }
        Ok(Some(scores))
    }

    /// The start of the score of a test; `None` where the smoother results of the test and of the first test of the
    /// class differ in more than the data-dependent part.
    fn member_start(
        &self,
        ensemble: ScoredEnsemble<'_>,
        (first, number): (usize, usize),
        first_smoothed: &[SmoothedPhase],
        room: &mut ScoreWorkspace<'_>,
    ) -> Result<Option<MemberStart>, ReduceError> {
        let (test, reduction) = (&ensemble.tests[number], ensemble.reductions.get(number));
        let alike = self.model.is_single() && !ensemble.law.is_restricted() && !ensemble.law.has_posteriors();
        if let ([smooth], true) = (first_smoothed, alike) {
            let same = same_bits(reduction.factor, ensemble.reductions.factor(first));
            let phases = || vec![(smooth.moments.mean_of(reduction, ensemble.law), Vec::new())];
            return Ok(same.then(|| MemberStart { phases: phases(), carry_gradient: Gradient::new() }));
        }
        let own = self.begin(ensemble, number, &mut room.work)?;
        if own.len() != first_smoothed.len() || !own.iter().zip(first_smoothed).all(|(a, b)| a.same_design(b)) {
            return Ok(None);
        }
        let carry_gradient = self.carry_gradient(test, &own, room)?;
        let phase = |(scorer, smooth): (&Scorer<'_>, SmoothedPhase)| {
            let ending = scorer.ending_of(&smooth).map_or(Vec::new(), |ending| ending.r);
            (smooth.moments.mean, ending)
        };
        Ok(Some(MemberStart { phases: self.phases.iter().zip(own).map(phase).collect(), carry_gradient }))
    }
}

impl SmoothedPhase {
    /// Whether the data-independent parts of both results are equal bit for bit.
    fn same_design(&self, other: &SmoothedPhase) -> bool {
        let later = match (&self.later, &other.later) {
            (Some(a), Some(b)) => {
                same_bits(a.rho.as_slice(), b.rho.as_slice()) && same_bits(a.N.as_slice(), b.N.as_slice())
            }
            (None, None) => true,
            _ => false,
        };
        later && self.moments.columns == other.moments.columns && same_bits(&self.moments.root, &other.moments.root)
    }
}
