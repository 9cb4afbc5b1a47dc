//! What is assumed of every test, and what is given of it: models, rows of data, and the evidence of each phase.
//!
//! ```text
//! Model::builder ── build ──> PhasedModel ┐
//! rows of data ── Test ───────────────────┴─ PhasedModel::split ──> PhasedTest { Evidence of each phase }
//! ```
//!
//! The crate holds no filter: a [`Reduction`] is a value here, and `kalfit-filter` makes it. Users meet all of it as
//! modules of the crate `kalfit`.

pub mod build;
pub mod ensemble;
pub mod evidence;
pub mod model;
pub mod remote;

pub use ensemble::*;
pub use evidence::*;
pub use model::*;
