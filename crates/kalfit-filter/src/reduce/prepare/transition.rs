//! The transition that leads to a step of a test: where it calls for a matrix exponential, made once for each length of step and
//! set of coefficients; else made again, which takes less time than to look for it.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::reduce::digest::Digest;
use crate::reduce::error::ReduceErrorKind;
use crate::reduce::motion::Moves;
use crate::reduce::prepare::{Preparer, StepRows, Workspace};
use crate::reduce::shared_store::StoreEntry;
use crate::reduce::subject::{Fault, ModelAt, Subject};
use kalfit_model::Test;

/// Transitions whose memory is kept for others.
const SPARE: usize = 1 << 12;

/// What leads to a step, in the store.
type KnownMoves = StoreEntry<Vec<u64>, Result<Moves, Box<Fault>>>;

/// What led to the last step, with the key it is known again by: the step's length and coefficients.
#[derive(Debug)]
pub(super) enum Last {
    Own(Vec<u64>, Moves),
    /// A sound one.
    Shared(Arc<KnownMoves>),
}

impl Last {
    pub(super) fn key(&self) -> &[u64] {
        match self {
            Last::Own(key, _) => key,
            Last::Shared(moved) => &moved.key,
        }
    }

    pub(super) fn moves(&self) -> &Moves {
        match self {
            Last::Own(_, moves) => moves,
            Last::Shared(moved) => moved.value().as_ref().expect("the last one is sound"),
        }
    }
}

impl Workspace {
    /// Empties the design; the memory of transitions that nobody else has is kept for those of the next test.
    pub(super) fn clear_design(&mut self) {
        let Workspace { design, spare, .. } = self;
        let mut used = design.moves.drain(..);
        while spare.len() < SPARE
            && let Some(mut transition) = used.next()
        {
            if Arc::get_mut(&mut transition).is_some() {
                spare.push(transition);
            }
        }
        drop(used);
        design.clear();
    }
}

impl Preparer {
    /// Makes the transition that leads to a step the last one of the work space; its inputs go to the data.
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
        if self.steady
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
            if self.quick {
                self.own_moves(work, dt).map_err(|fault| fault.on(row))?;
            } else {
                let shared = self.shared_moves(work, dt);
                shared.value().as_ref().map_err(|fault| fault.clone().on(row))?;
                work.last = Some(Last::Shared(shared));
            }
        }
        let Workspace { last, replay, data, .. } = work;
        let last = last.as_ref().expect("there is one");
        self.plan.inputs(last.moves(), &replay.inputs, &mut data.inputs);
        Ok(())
    }

    /// Makes the moves of a step, in place of the last ones.
    fn own_moves(&self, work: &mut Workspace, dt: f64) -> Result<(), Box<Fault>> {
        let Workspace { key, replay, filled, spare, last, .. } = work;
        let moves = self.plan.moves(&self.dynamics, &replay.values, dt, (filled, spare.pop()))?;
        // the memory of the key before is that of the next
        if let Some(Last::Own(before, _)) = last.replace(Last::Own(std::mem::take(key), moves)) {
            *key = before;
        }
        Ok(())
    }

    fn shared_moves(&self, work: &mut Workspace, dt: f64) -> Arc<KnownMoves> {
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
