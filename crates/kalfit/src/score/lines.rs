//! Tests with designs of their own that wait for others of the same shape, to be scored side by side.

use crate::ensemble::Test;
use crate::reduce::{self, Design, Fault, ReduceError, Waits, Workspace, filters, same_shape};
use crate::score::backward::{Abreast, BackwardWork, Ending, StepBars, fits};
use crate::score::chain::{Adjoints, Gradient};
use crate::score::moments::Moments;
use crate::score::{Onward, Scorer};

/// A test with the moments of its ξ and what later phases say of its last state.
#[derive(Debug)]
pub(crate) struct Asked<'t> {
    /// What its score is known by.
    pub(crate) number: usize,
    pub(crate) test: &'t Test,
    pub(crate) moments: Moments,
    pub(crate) ending: Option<Ending>,
}

/// One of them, evaluated.
#[derive(Debug)]
struct Waiting<'t> {
    asked: Asked<'t>,
    work: Workspace,
}

/// Lines of tests whose designs have one shape each.
#[derive(Debug, Default)]
pub(crate) struct Lines<'t> {
    lines: reduce::Lines<Waiting<'t>>,
    /// Room that was used before.
    spare: Vec<Workspace>,
    bars: StepBars,
}

/// (number, score).
pub(crate) type Answer = (usize, Result<Gradient, ReduceError>);

/// What one thread works with.
pub(crate) type Room<'r, 'a> = (&'r mut Workspace, &'r mut BackwardWork, &'r mut Adjoints<'a>);

impl Waits for Waiting<'_> {
    fn length(&self) -> usize {
        self.work.design.runs.len()
    }

    fn goes_with(&self, other: &Self) -> bool {
        let (a, b) = (&self.work.design, &other.work.design);
        let together = match (&self.asked.ending, &other.asked.ending) {
            (None, None) => true,
            // what later phases say is said where the lanes end
            (Some(_), Some(_)) => a.runs.len() == b.runs.len(),
            _ => false,
        };
        together && self.asked.moments.columns == other.asked.moments.columns && same_shape(a, b)
    }
}

impl Scorer<'_> {
    /// Takes a test; gives the scores of those whose turn has come.
    pub(crate) fn ask<'t>(
        &self,
        asked: Asked<'t>,
        lines: &mut Lines<'t>,
        room: Room<'_, '_>,
        answers: &mut Vec<Answer>,
    ) {
        let mut work = lines.spare.pop().unwrap_or_else(|| self.reducer.workspace());
        if let Err(fault) = self.reducer.preparer().prepare(asked.test, &mut work) {
            answers.push((asked.number, Err(self.reducer.named(*fault, asked.test))));
            lines.spare.push(work);
            return;
        }
        let mut own = Waiting { asked, work };
        if self.reducer.is_unfrozen() || !fits(&own.work.design, own.asked.moments.columns, self.wanted()) {
            answers.push(self.alone(&mut own, (room.1, room.2)));
            lines.spare.push(own.work);
            return;
        }
        if let Some(line) = lines.lines.push(own) {
            self.answer(line, lines, room, answers);
        }
    }

    /// The scores of all that wait.
    pub(crate) fn answer_all(&self, lines: &mut Lines<'_>, room: Room<'_, '_>, answers: &mut Vec<Answer>) {
        let (work, backward, adjoints) = room;
        while let Some(line) = lines.lines.find(|_| true) {
            self.answer(line, lines, (work, backward, adjoints), answers);
        }
    }

    /// The scores of a line, which is empty then.
    fn answer(&self, line: usize, lines: &mut Lines<'_>, room: Room<'_, '_>, answers: &mut Vec<Answer>) {
        let (work, backward, adjoints) = room;
        let mut waiting = lines.lines.take(line);
        let bars = {
            let all: Vec<_> = waiting.iter().map(|own| (&own.work.design, &own.work.data)).collect();
            let longest: &Design = filters(&all, work);
            let moments: Vec<&Moments> = waiting.iter().map(|own| &own.asked.moments).collect();
            let endings: Vec<&Ending> = waiting.iter().filter_map(|own| own.asked.ending.as_ref()).collect();
            let Workspace { block, gained, .. } = &*work;
            let (moments, endings, wanted) = (&*moments, &*endings, self.wanted());
            Abreast { block, gained, longest, moments, endings, wanted }.pass()
        };
        for (lane, own) in waiting.iter_mut().enumerate() {
            // square-root arrays have a pass of their own
            if work.gained.found[lane].is_none() {
                answers.push(self.alone(own, (backward, adjoints)));
                continue;
            }
            let Waiting { asked: Asked { number, test, .. }, work } = own;
            let mut onward = Onward { adjoints, test, work };
            let sent = bars.send(lane, &work.design, &mut lines.bars, &mut onward);
            // what is left of one in error must go too
            let score = adjoints.finish(test, work);
            let score = sent.and(score).map_err(|fault: Box<Fault>| self.reducer.named(*fault, test));
            answers.push((*number, score));
        }
        lines.spare.extend(waiting.into_iter().map(|own| own.work));
    }

    fn alone(&self, own: &mut Waiting<'_>, (backward, adjoints): (&mut BackwardWork, &mut Adjoints<'_>)) -> Answer {
        let Waiting { asked: Asked { number, test, moments, ending }, work } = own;
        (*number, self.prepared(test, (moments, ending.as_ref()), (work, backward, adjoints)))
    }
}
