//! The transition that leads to a step of a test. A transition with a matrix exponential is computed once for each step
//! length and set of coefficients; any other transition is computed every time, which takes less time than a look-up.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::reduce::digest::Digest;
use crate::reduce::error::ReduceErrorKind;
use crate::reduce::motion::Moves;
use crate::reduce::prepare::{Preparer, StepRows, Workspace};
use crate::reduce::shared_store::StoreEntry;
use crate::reduce::subject::{Fault, ModelAt, Subject};
use kalfit_model::Test;

/// Largest number of transitions whose memory is reused.
const MOST_REUSABLE: usize = 1 << 12;

/// The moves of a step, as an entry of the store of transitions.
type KnownMoves = StoreEntry<Vec<u64>, Result<Moves, Box<Fault>>>;

/// The moves to the last step, with the key that identifies the moves: length and coefficients of the step.
#[derive(Debug)]
pub(super) enum LastMoves {
    Own(Vec<u64>, Moves),
    /// An entry of the store, without a fault.
    Shared(Arc<KnownMoves>),
}

impl LastMoves {
    pub(super) fn key(&self) -> &[u64] {
        match self {
            LastMoves::Own(key, _) => key,
            LastMoves::Shared(moved) => &moved.key,
        }
    }

    pub(super) fn moves(&self) -> &Moves {
        match self {
            LastMoves::Own(_, moves) => moves,
            LastMoves::Shared(moved) => moved.value().as_ref().expect("the last one is sound"),
        }
    }
}

impl Workspace {
    /// Empties the design; the memory of unshared transitions is reused for the transitions of the next test.
    pub(super) fn clear_design(&mut self) {
        let Workspace { design, reusable, .. } = self;
        let mut used = design.moves.drain(..);
        while reusable.len() < MOST_REUSABLE
            && let Some(mut transition) = used.next()
        {
            if Arc::get_mut(&mut transition).is_some() {
                reusable.push(transition);
            }
        }
        drop(used);
        design.clear();
    }
}

impl Preparer {
    /// Sets `work.last` to the transition that leads to a step, and appends the inputs of the step to the data.
    pub(super) fn transition(
        &self,
        at: &ModelAt<'_>,
        test: &Test,
        moment: &StepRows,
        work: &mut Workspace,
    ) -> Result<(), Box<Fault>> {
        let (row, dt) = (moment.rows.start, moment.dt);
        let continuous = !self.dynamics.components.is_empty();
        if continuous && dt.is_nan() {
            return Err(Fault::new(Subject::Transition, ReduceErrorKind::UnknownFirstStep).on(row));
        }
        if self.fixed_dynamics
            && let Some(last) = &work.last
            && last.key()[0] == if continuous { dt.to_bits() } else { 0 }
        {
            self.plan.inputs(last.moves(), &work.replay.inputs, &mut work.data.inputs);
            return Ok(());
        }
        self.evaluate(at, test, moment, work, |all, scope, out| {
            all.values(scope, out)?;
            all.inputs(scope, out)
        })?;
        work.key.clear();
        work.key.push(if continuous { dt.to_bits() } else { 0 });
        work.key.extend(self.dynamics.table.varying.iter().map(|(slot, ..)| work.replay.values[*slot].to_bits()));
        if work.last.as_ref().is_none_or(|last| last.key() != work.key) {
            if self.without_exponentials {
                self.compute_moves(work, dt).map_err(|fault| fault.on(row))?;
            } else {
                let shared = self.cached_moves(work, dt);
                shared.value().as_ref().map_err(|fault| fault.clone().on(row))?;
                work.last = Some(LastMoves::Shared(shared));
            }
        }
        let Workspace { last, replay, data, .. } = work;
        let last = last.as_ref().expect("there is one");
        self.plan.inputs(last.moves(), &replay.inputs, &mut data.inputs);
        Ok(())
    }

    /// Computes the moves of a step of length `dt` into `work.last`.
    fn compute_moves(&self, work: &mut Workspace, dt: f64) -> Result<(), Box<Fault>> {
        let Workspace { key, replay, filled, reusable, last, .. } = work;
        let moves = self.plan.moves(&self.dynamics, &replay.values, dt, (filled, reusable.pop()))?;
        // the memory of the old key serves for the next one
        if let Some(LastMoves::Own(before, _)) = last.replace(LastMoves::Own(std::mem::take(key), moves)) {
            *key = before;
        }
        Ok(())
    }

    fn cached_moves(&self, work: &mut Workspace, dt: f64) -> Arc<KnownMoves> {
        let mut digest = Digest::new();
        work.key.iter().for_each(|&word| digest.word(word));
        let Workspace { key, replay, filled, .. } = work;
        self.transitions.get(
            digest.finish(),
            |known| known == key,
            || key.clone(),
            |_| {
                self.computed.fetch_add(1, Ordering::Relaxed);
                self.plan.moves(&self.dynamics, &replay.values, dt, (filled, None))
            },
            |key, moves| {
                let numbers = moves.as_ref().map_or(0, |m| m.transition.phi.len() + m.transition.q.len());
                8 * (key.len() + numbers) + 300
            },
        )
    }
}
