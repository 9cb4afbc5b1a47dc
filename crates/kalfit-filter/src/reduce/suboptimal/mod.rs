//! Suboptimal filters: the information in the estimates that they make (theory §8, the paper's section 4).
//!
//! ```text
//! Test ── FilterRunner ──> Estimates          the truth and the filter propagated together: ŝ, s̄, S, φ_K, a root of Γ
//! Estimates ── EstimateReducer ──> Reduction + Terminal
//! ```
//!
//! Estimates that were made elsewhere enter at the second arrow. Nothing after it depends on where a reduction came
//! from.

mod believed;
mod conditioned;
mod folded;
mod jacobi;
mod joint;
mod known;
mod lost;

mod matrices;
mod reducer;
mod run;

pub use lost::{Lost, LostError, lost};
pub use reducer::EstimateReducer;
pub use run::FilterRunner;
