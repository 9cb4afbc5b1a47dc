//! Tests in groups, level by level (theory §11). A unit is a group of the outermost level.
//!
//! ξ of a test is μ plus the effects of its groups plus a per-test effect, all independent: ξ_j = μ_j + β_u + γ_j. A
//! level maps reductions to reductions: a test (J, y) whose per-test effect is integrated out gives, on the mean m of
//! the test's group,
//!
//! ```text
//! W = (I+JΣ)⁻¹J      s = (I+JΣ)⁻¹y      c - ½log|I+JΣ| + ½y'Σs
//! ```
//!
//! and the reduction of the group is the sum over its members, J = ΣW and y = Σs, to which the next level applies. Back
//! from the outermost level, with the posterior (m̂, V) of the mean of a group, each member has
//!
//! ```text
//! r = s - Wm̂      W̄ = W - WVW      ∂ℓ/∂Σ of its level: ½(rr' - W̄)
//! m̂ + Σr          (I-ΣW)V(I-WΣ) + Σ - ΣWΣ             posterior of a test's ξ, or of the mean of a group's members
//! ```
//!
//! Reductions are square roots throughout ([`walk`]). Units with the same designs share one pass over matrices
//! ([`Units`]), other units are evaluated in lanes. Second derivatives are the derivatives of the scores along each
//! element of each Σ ([`tangents`]).
//!
//! In [`Elements`](crate::linalg::elements::Elements) each level is a block, like a further phase: block 0 is the level
//! of the tests, block 1 the innermost level of groups.

mod batch_data;
mod batches;
mod crossed;
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
pub use posterior::TestPosterior;
pub use posterior::posteriors;
pub use posterior::{ScaledEffectCovariance, ScaledGroupPosterior};
pub use units::Units;
pub(crate) use units::stacked;
