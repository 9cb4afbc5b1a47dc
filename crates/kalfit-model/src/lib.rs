//! Models, rows of data, and the evidence of each phase of a test.
//!
//! ```text
//! Model::builder ── build ──> PhasedModel ┐
//! rows of data ── Test ───────────────────┴─ PhasedModel::split ──> PhasedTest { Evidence of each phase }
//! ```
//!
//! The crate contains no filter: `kalfit-filter` makes the values of [`Reduction`]. The crate `kalfit` exports these
//! modules to users.

pub mod build;
pub mod ensemble;
pub mod evidence;
pub mod model;
pub mod remote;

pub use ensemble::*;
pub use evidence::*;
pub use model::*;
