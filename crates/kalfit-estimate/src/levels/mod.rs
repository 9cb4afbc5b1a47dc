//! Tests of one unit, level by level (theory §11).
//!
//! ξ of a test is μ and what each of its groups adds and its own: ξ_j = μ_j + β_u + γ_j, independent of each other. A level is a map from
//! reductions to reductions: with what is its own integrated out, a test (J, y) says of the mean m of its group
//!
//! ```text
//! W = (I+JΣ)⁻¹J      s = (I+JΣ)⁻¹y      c - ½log|I+JΣ| + ½y'Σs
//! ```
//!
//! and the group says of the next level's mean what its members say together, J = ΣW and y = Σs. Back from the outermost level, with the
//! posterior (m̂, V) of the mean of a group, each member has
//!
//! ```text
//! r = s - Wm̂      W̄ = W - WVW      ∂ℓ/∂Σ of its level: ½(rr' - W̄)
//! m̂ + Σr          (I-ΣW)V(I-WΣ) + Σ - ΣWΣ                        the posterior of its own ξ, the mean of its own members
//! ```
//!
//! Reductions are kept as square roots on the way ([`walk`]), and tests come together as groups by design: groups whose members have
//! the same designs cost one pass over matrices ([`Units`]), others stand side by side in lanes. Second derivatives are those of the scores, along each element of each Σ
//! ([`tangents`]).
//!
//! In [`Elements`](kalfit_algebra::elements::Elements) what the groups of a level add stands like a further phase: block 0 is the tests' own
//! level, the next one the innermost level of groups.

mod batch_data;
mod batches;
mod design;
mod moments;
mod pass;
mod posterior;
mod tangents;
#[cfg(test)]
mod tests;
mod totals;
mod trees;
mod units;
mod walk;

pub(crate) use pass::{each_unit, pass};
pub use posterior::LevelPosteriors;
pub use posterior::ScaledGroupPosterior;
pub use posterior::TestPosterior;
pub use posterior::posteriors;
pub use units::Units;
pub(crate) use units::stacked;
