//! Memory that a fit needs, said before the work begins: second derivatives by all elements of Σ take matrices over those elements, and
//! there are half as many of them as states squared.

use kalfit::estimate::memory;
use kalfit_data::memory_left;
use kalfit_spec::Spec;

use crate::failure::Failure;

/// What no machine is asked about.
const SMALL: u64 = 256 << 20;

/// What the least of all work takes, with its threads.
const LEAST: usize = 64 << 20;

/// An error where there is not even room for a small job: memory that runs out later ends the process in the middle of the work.
///
/// # Errors
/// There is no room.
pub fn is_there() -> Result<(), Failure> {
    let tried = Vec::<u8>::new().try_reserve_exact(LEAST);
    tried.map_err(|_| Failure::NoRoom { needed: LEAST as u64 })
}

/// An error where a fit of the model needs more memory than there is, as far as that can be known.
pub(crate) fn suffices(spec: &Spec) -> Result<(), Failure> {
    let blocks: Vec<usize> = spec.model.blocks().map(|(_, states)| states.len()).collect();
    let needed = memory(&blocks);
    if needed < SMALL {
        return Ok(());
    }
    match memory_left() {
        Some(available) if needed > available => {
            Err(Failure::Memory { states: spec.model.dimension(), needed, available })
        }
        _ => Ok(()),
    }
}
