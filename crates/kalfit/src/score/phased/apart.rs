//! Scores of tests by themselves, those with designs of one shape side by side.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::reduce::{ReduceError, share};
use crate::score::chain::{Gradient, add};
use crate::score::lines::{Answer, Asked, Lines};
use crate::score::phased::together::{Ensemble, Score};
use crate::score::phased::{PhasedScorer, Room};

/// What is known of one test so far.
#[derive(Debug, Default)]
struct Known {
    /// By phase; last, what goes through the carries.
    parts: Vec<Gradient>,
    /// Of several errors, that of the first phase.
    error: Option<(usize, ReduceError)>,
}

impl Known {
    fn new(phases: usize) -> Known {
        Known { parts: vec![Gradient::new(); phases + 1], error: None }
    }

    fn take(&mut self, at: usize, score: Result<Gradient, ReduceError>) {
        match score {
            Ok(gradient) => self.parts[at] = gradient,
            Err(error) if self.error.as_ref().is_none_or(|(before, _)| at < *before) => self.error = Some((at, error)),
            Err(_) => {}
        }
    }

    fn score(self) -> Result<Gradient, ReduceError> {
        if let Some((_, error)) = self.error {
            return Err(error);
        }
        let mut parts = self.parts.into_iter();
        let mut sum = parts.next().unwrap_or_default();
        parts.for_each(|part| add(&mut sum, &part));
        Ok(sum)
    }
}

impl PhasedScorer<'_> {
    /// The scores of tests with these numbers.
    pub(super) fn apart(&self, of: Ensemble<'_>, numbers: &[usize]) -> Vec<Score> {
        let rows = numbers.iter().map(|&number| of.tests[number].row_count()).sum();
        let room = || (self.room(), self.phases.iter().map(|_| Lines::default()).collect::<Vec<_>>());
        numbers
            .par_chunks(share(numbers.len(), rows))
            .map_init(room, |(room, lines), numbers| self.share_of(of, numbers, (room, lines)))
            .flatten_iter()
            .collect()
    }

    fn share_of<'t>(
        &self,
        of: Ensemble<'t>,
        numbers: &[usize],
        (room, lines): (&mut Room<'_>, &mut [Lines<'t>]),
    ) -> Vec<Score> {
        let mut known: Vec<Known> = numbers.iter().map(|_| Known::new(self.phases.len())).collect();
        let mut answers = Vec::new();
        for (place, &number) in numbers.iter().enumerate() {
            if let Err(error) = self.ask(of, (place, number), (room, lines), (&mut known, &mut answers)) {
                known[place].take(0, Err(error));
            }
        }
        for (at, lines) in lines.iter_mut().enumerate() {
            let work = (&mut room.work.phases[at], &mut room.backward, &mut room.adjoints[at]);
            self.phases[at].answer_all(lines, work, &mut answers);
            self.keep(at, &mut answers, &mut known);
        }
        numbers.iter().copied().zip(known.into_iter().map(Known::score)).collect()
    }

    /// Asks for the scores of a test, phase by phase.
    fn ask<'t>(
        &self,
        of: Ensemble<'t>,
        (place, number): (usize, usize),
        (room, lines): (&mut Room<'_>, &mut [Lines<'t>]),
        (known, answers): (&mut [Known], &mut Vec<Answer>),
    ) -> Result<(), ReduceError> {
        let (test, reduction) = (&of.tests[number], of.reductions.get(number));
        let phases = self.begin(test, reduction, (of.law, of.plans), &mut room.work)?;
        for (at, smooth) in phases.into_iter().enumerate() {
            let Some(rows) = self.rows_of(at, test) else { continue };
            if let Some(bar) = &smooth.inherited {
                let mut carried = BTreeMap::new();
                self.carried((at, rows), bar, room, &mut carried)?;
                add(&mut known[place].parts[self.phases.len()], &carried.into_iter().collect());
            }
            let ending = smooth.later.as_ref().map(|later| self.phases[at].ending(later));
            let asked = Asked { number: place, test: rows, moments: smooth.moments, ending };
            let work = (&mut room.work.phases[at], &mut room.backward, &mut room.adjoints[at]);
            self.phases[at].ask(asked, &mut lines[at], work, answers);
            self.keep(at, answers, known);
        }
        Ok(())
    }

    /// Takes the scores of a phase.
    fn keep(&self, at: usize, answers: &mut Vec<Answer>, known: &mut [Known]) {
        for (place, score) in answers.drain(..) {
            known[place].take(at, score.map_err(|error| self.reducer.phases()[at].named(error)));
        }
    }
}
