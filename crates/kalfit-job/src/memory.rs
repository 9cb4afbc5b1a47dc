//! Memory that a fit needs, said before the work begins: second derivatives by all elements of Σ take matrices over those elements, and
//! there are half as many of them as states squared.

use kalfit::estimate::memory;
use kalfit::infer::TestsChoice;
use kalfit_data::{accepted_rows, memory_left};
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

/// Refuses a variable `KALFIT_MOST_ROWS` that is no number.
///
/// # Errors
/// What it holds.
pub fn check_rows_variable() -> Result<(), Failure> {
    accepted_rows().map(|_| ()).map_err(|found| Failure::RowsVariable { found })
}

/// Bytes that the work on a test takes after it was read, and its results: measured at one and four states, with 50 000 and
/// 150 000 tests of two rows (325 and 485 bytes without results, 1 135 and 977 with them).
const PER_TEST: u64 = 280;
const PER_TEST_AND_STATE: u64 = 50;
const PER_RESULT: u64 = 800;

/// An error where the work on tests that were read needs more memory than there is.
pub(crate) fn suffices_for(tests: usize, spec: &Spec, wanted: TestsChoice) -> Result<(), Failure> {
    let (tests, states) = (tests as u64, spec.model.dimension() as u64);
    let of_result = if wanted == TestsChoice::Each { PER_RESULT } else { 0 };
    let needed = tests.saturating_mul(PER_TEST + PER_TEST_AND_STATE * states + of_result);
    match memory_left().filter(|_| needed > SMALL) {
        Some(available) if needed > available => Err(Failure::MemoryOfTests { tests, needed, available }),
        _ => Ok(()),
    }
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
