//! Scores of tests that are alike, of one design class.

use rayon::prelude::*;

use crate::reduce::{FilteredPhases, ReduceError, Reductions, same_bits};
use crate::score::InitialLaw;
use crate::score::Scorer;
use crate::score::classes::ClassMember;
use crate::score::phased::{PhasedScorer, Plans, ScoreWorkspace};
use crate::score::pullback::{Gradient, add};
use crate::score::smoother::SmoothedPhase;
use kalfit_model::PhasedTest;

/// Tests that one thread begins at a time.
const SHARE: usize = 64;

/// (number of the test, its score).
pub(super) type Score = (usize, Result<Gradient, ReduceError>);

/// An ensemble under a law of ξ.
#[derive(Clone, Copy)]
pub(super) struct ScoredEnsemble<'a> {
    pub(super) tests: &'a [PhasedTest],
    pub(super) reductions: &'a Reductions,
    pub(super) law: &'a InitialLaw,
    pub(super) plans: &'a Plans,
    /// Those that are kept side by side, after their filters.
    pub(super) filtered: Option<&'a FilteredPhases>,
}

/// What one test alone has of each of its phases: x̂ and r, and what goes through the carries.
struct MemberStart {
    phases: Vec<(Vec<f64>, Vec<f64>)>,
    carried: Gradient,
}

impl PhasedScorer<'_> {
    /// Alike tests; one by one where they turn out to be so in their rows alone.
    pub(super) fn of_class(
        &self,
        of: ScoredEnsemble<'_>,
        numbers: &[usize],
        room: &mut ScoreWorkspace<'_>,
    ) -> Vec<Score> {
        match self.together(of, numbers, room) {
            Ok(Some(scores)) => numbers.iter().copied().zip(scores.into_iter().map(Ok)).collect(),
            // what is wrong is said of the test that it is wrong with
            Ok(None) | Err(_) => self.apart(of, numbers),
        }
    }

    /// `None` where there is nothing to gain, or where the tests must be looked at one by one.
    pub(super) fn together(
        &self,
        of: ScoredEnsemble<'_>,
        numbers: &[usize],
        room: &mut ScoreWorkspace<'_>,
    ) -> Result<Option<Vec<Gradient>>, ReduceError> {
        let first = numbers[0];
        let like = self.begin(of, first, &mut room.work)?;
        let begin = |numbers: &[usize]| {
            let mut room = self.room();
            numbers.iter().map(|&number| self.begun(of, (first, number), &like, &mut room)).collect::<Vec<_>>()
        };
        let begun: Vec<Result<Option<MemberStart>, ReduceError>> = if numbers.len() <= SHARE {
            begin(numbers)
        } else {
            numbers.par_chunks(SHARE).flat_map_iter(begin).collect()
        };
        let Some(mut begun) = begun.into_iter().collect::<Result<Option<Vec<MemberStart>>, ReduceError>>()? else {
            return Ok(None);
        };
        let mut scores: Vec<Gradient> = begun.iter_mut().map(|begun| std::mem::take(&mut begun.carried)).collect();
        for (at, smooth) in like.iter().enumerate() {
            if self.reducer.rows_of(at, &of.tests[first]).is_none() {
                continue;
            }
            let told = |(&number, begun): (&usize, &mut MemberStart)| {
                let test = self.reducer.rows_of(at, &of.tests[number]).expect("alike tests have the same phases");
                let (mean, ending) = std::mem::take(&mut begun.phases[at]);
                ClassMember { test, mean, ending }
            };
            let told: Vec<ClassMember<'_>> = numbers.iter().zip(&mut begun).map(told).collect();
            let scorer = &self.phases[at];
            let ending = scorer.ending_of(smooth);
            let work = (&mut room.work.phases[at], &mut room.backward, &mut room.adjoints[at]);
            let Some(own) = scorer.of_class(&told, (&smooth.moments, ending.as_ref()), work)? else {
                return Ok(None);
            };
            scores.iter_mut().zip(&own).for_each(|(score, own)| add(score, own));
        }
        Ok(Some(scores))
    }

    /// What a test begins with; `None` where more than that differs from the first one of its class.
    fn begun(
        &self,
        of: ScoredEnsemble<'_>,
        (first, number): (usize, usize),
        like: &[SmoothedPhase],
        room: &mut ScoreWorkspace<'_>,
    ) -> Result<Option<MemberStart>, ReduceError> {
        let (test, reduction) = (&of.tests[number], of.reductions.get(number));
        let alike = self.model.is_single() && !of.law.is_restricted() && !of.law.is_of_each();
        if let ([smooth], true) = (like, alike) {
            let same = same_bits(reduction.factor, of.reductions.factor(first));
            let phases = || vec![(smooth.moments.mean_of(reduction, of.law), Vec::new())];
            return Ok(same.then(|| MemberStart { phases: phases(), carried: Gradient::new() }));
        }
        let own = self.begin(of, number, &mut room.work)?;
        if own.len() != like.len() || !own.iter().zip(like).all(|(a, b)| a.same_design(b)) {
            return Ok(None);
        }
        let carried = self.carried(test, &own, room)?;
        let phase = |(scorer, smooth): (&Scorer<'_>, SmoothedPhase)| {
            let ending = scorer.ending_of(&smooth).map_or(Vec::new(), |ending| ending.r);
            (smooth.moments.mean, ending)
        };
        Ok(Some(MemberStart { phases: self.phases.iter().zip(own).map(phase).collect(), carried }))
    }
}

impl SmoothedPhase {
    /// All but what the data say is the same bit for bit.
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
