//! One test → one reduction (theory §2, the paper's (38), (39)).
//!
//! The filter runs once per test with ξ = 0 and carries the sensitivity Ψ of the filtered state to ξ. What it leaves
//! is a [`Reduction`]: all that the test says about ξ.

mod reduction;

pub use reduction::{Path, Reduction};
