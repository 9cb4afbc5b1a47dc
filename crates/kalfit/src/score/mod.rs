//! dℓ/dα of a test, exactly, by one backward pass (theory §6), whatever the number of parameters.
//!
//! ```text
//! Test at α, moments (x̂, V) of ξ ── backward ──> adjoints of φ, Q, M, R, b, d, a, P0 ── chain ──> dℓ/dα
//! ```

mod backward;
mod chain;
mod moments;
mod slots;

use rayon::prelude::*;

use crate::ensemble::Test;
use crate::reduce::{ReduceError, Reducer};
use backward::{BackwardWork, Run, Wanted};

pub use slots::{Slot, Slots};

pub(crate) use chain::{Chain, Gradient};
pub(crate) use moments::{Moments, moments};

/// Scores of tests at the α of a reducer.
#[derive(Debug)]
pub(crate) struct Scorer<'a> {
    reducer: &'a Reducer,
    chain: Chain<'a>,
}
