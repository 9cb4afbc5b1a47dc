//! Maximum-likelihood error models from an ensemble of non-identical tests.
//!
//! Every test obeys a linear state-space model whose initial state differs from test to test. This crate finds
//! the mean μ and the covariance Σ of that initial state over the population, under constraints. The flow has one
//! direction, and each arrow is one public function:
//!
//! ```text
//! Model + Test ── reduce ──> Reduction ── estimate ──> Estimate ── infer ──> Inference ──> FitRecord
//! ```
//!
//! The crate is pure: it knows nothing of files, model-file syntax, tables, clocks or the terminal.

pub mod along;
pub mod compare;
pub mod datasheet;
mod face;
pub mod guide;
pub mod shards;
pub mod time_unit;
pub mod validate;

pub use kalfit_apply::{allan, apply, export, plan, predict};
pub use kalfit_estimate as estimate;
pub use kalfit_filter::{innovations, reduce, simulate};
pub use kalfit_infer as infer;
pub use kalfit_model::{build, ensemble, model, remote};
pub use kalfit_record as record;

/// The dynamic parameters α: their search and what is known of them.
pub mod dynamic {
    pub use kalfit_infer::dynamic::*;
    pub use kalfit_search::*;
}

pub use ensemble::{Group, Grouping, Label, Labels, Layout, Source, Test, TestBatch, TestId, TestKey};
pub use face::{
    Ensemble, EnsembleError, Figure, Fit, MeanProfiles, Options, UnknownName, fit, fit_matrices, fit_reductions,
};
pub use kalfit_lanes::{Isa, UnknownInstructions};
pub use model::{Alpha, Expression, Model, PhasedModel, Population};
pub use record::{FitRecord, Provenance};
pub use reduce::{Evidence, PhasedTest, Reduction, ReductionRef, Reductions};

/// The README's example, compiled and run.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct ReadmeDoctests;
