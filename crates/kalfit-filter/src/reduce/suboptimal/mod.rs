//! Information in the estimates of suboptimal filters (theory §8, the paper's section 4).
//!
//! ```text
//! Test ── FilterRunner ──> Estimates          the truth and the filter propagated together: ŝ, s̄, S, φ_K, a root of Γ
//! Estimates ── EstimateReducer ──> Reduction + Terminal
//! ```
//!
//! Estimates that were made elsewhere enter at the second arrow. Nothing after that arrow depends on where the
//! estimates were made.

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
