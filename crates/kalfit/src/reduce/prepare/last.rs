//! What led to the last step.

use std::sync::Arc;

use crate::reduce::motion::Moves;
use crate::reduce::shared::StoreEntry;
use crate::reduce::subject::Fault;

/// What leads to a step, in the store.
pub(super) type KnownMoves = StoreEntry<Vec<u64>, Result<Moves, Box<Fault>>>;

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
