//! dℓ/dα of a test, exactly, by one backward pass (theory §6), whatever the number of parameters.
//!
//! ```text
//! Test at α, moments (x̂, V) of ξ ── backward ──> adjoints of φ, Q, M, R, b, d, a, P0 ── chain ──> dℓ/dα
//! ```

#[cfg_attr(not(test), expect(dead_code, reason = "the backward pass uses it"))]
mod chain;
mod slots;

pub use slots::{Slot, Slots};
