//! One test → one reduction (theory §2, the paper's (38), (39)).
//!
//! The filter runs once per test with ξ = 0 and propagates the sensitivity Ψ of the filtered state to ξ. The result is
//! a [`Reduction`], which holds all the information of the test about ξ.
//!
//! With x_0 = a + Aξ + ζ, the prediction at step k is x̂ + Ψξ, and the innovation is e - Tξ with variance S:
//!
//! ```text
//! e = z - d - M x̂,  T = MΨ,  S = MPM' + R,  K = PM'S⁻¹          innovations of any ξ are e - Tξ                 (38)
//! log p(z | ξ) = c + y'ξ - ½ ξ'Jξ                               the likelihood, the paper's (39)
//! J = Σ T'S⁻¹T,  y = Σ T'S⁻¹e,  c = -½ Σ (log|2πS| + e'S⁻¹e)    sums over the steps
//! ```
//!
//! J is the inverse of the paper's P(j) and may be singular; it is stored as a triangular root and never inverted.
//!
//! ```text
//! Model at α ── Reducer::new ──> Preparer                dynamics, start, motion, observe: coefficients at α
//! Test ── prepare ──> Design + Data                      steps; matrix exponentials once per length and coefficients
//! Design ── design_pass, else root ──> Gains             S, K, T, P, J: once per design class
//! Gains + Data ── lanes (pass, least_squares) ──> Reduction    e, x̂, y, then d: once per test
//! ```
//!
//! The covariance equations are in `kernel` (`predict`, `sensitivity`, `update`, `correct`, `inform`), for single
//! numbers and for lanes; `root` has separate square-root equations for P and J. A `covariance_filter` applies the
//! equations step by step: to one design in `design_pass`, to designs of one shape in `lanes` (`design_batch`). `lanes`
//! also computes innovations, x̂ and y, of one test or of many; `scan` handles equal steps. A test gives the same bits
//! alone and in a lane. Designs for which plain covariances lose digits go through `root`.
//!
//! A test in several phases is reduced phase by phase, in the entering coordinates of each phase, and then as a whole
//! (theory §7):
//!
//! ```text
//! rows ── PhasedModel::split ──> PhasedTest              rows, estimates or a reduction of each phase
//! each phase ── Reducer (part, carry) ──> PhaseReduction its factor, its last state (end), what it inherits
//! all phases ── stack ──> Reduction with its Chain       tests of one shape in lanes
//! ```
//!
//! The reductions of an ensemble are stored by column ([`Reductions`]). Many tests are reduced in lanes (batch_reducer,
//! [`kalfit_lanes`]). Tests that differ only in measured values and covariates are grouped first (replicates): one of
//! them is evaluated, and all share one data pass (exemplar, lanes). Tests with per-test designs are evaluated,
//! filtered and whitened in lanes (batches): the steps of such a test follow from the cells of the test (skeleton),
//! whatever α is, and during a search for α these tests stay in lanes for all values of α. No bit of a result depends
//! on what else is in the batch.
//!
//! Long uniform records cost little: a long stretch of equal steps is cut into segments that start from known states,
//! so that all of them share one covariance filter and their data run in lanes (segments). Shorter stretches, and rows
//! that are wanted one by one, have gains of their own: S, K and T are stored once from the step on at which S, K and T
//! no longer change (settling), and the data pass is a linear scan (scan).

mod batch_reducer;
mod batches;
mod carry;
mod cell_mask;
mod chunk_size;
mod class;
mod covariance_filter;
mod data;
mod data_memory;
mod design;
mod design_pass;
mod digest;
mod dynamics;
mod entries;
mod equal_steps;
mod error;
mod exact_design;
mod exemplar;
mod flops;
mod gains;
mod groups;
mod instances;
mod kernel;
mod known_steps;
mod lanes;
mod measured_cells;
mod moment_path;
mod motion;
mod observe;
mod order;
mod outcome;
mod part;
mod phased;
mod plain;
mod plain_order;
mod plain_reduction;
mod prepare;
mod reduced_tests;
mod reducer;
mod reductions;
mod replicates;
mod root;
mod scan;
mod schedule;
pub(crate) mod segments;
mod semidefinite;
mod settling;
mod shared_store;
mod stack;
mod start;
mod steps;
mod subject;
mod suboptimal;
mod sums;
mod terminal;

pub use kalfit_model::{
    Chain, ChainPhase, Estimates, Evidence, ExactRows, Inherited, Link, Path, PhaseReduction, PhasedTest, Phases,
    Reduction, ReductionRef, SplitError, Terminal,
};

pub use error::{Cell, ReduceError, ReduceErrorKind};
pub(crate) use exemplar::MAX_ROWS_IN_LANES;
pub use flops::reduction_flops;
pub use groups::{GroupingError, grouping, grouping_of, groups_of};
pub use phased::PhasedReducer;
pub use plain::{Plain, StepMatrices};
pub use reducer::{Reducer, Work};
pub use reductions::{Reductions, Rows};
pub use suboptimal::{EstimateReducer, FilterRunner, Lost, LostError, lost};

pub(crate) use batches::FilteredBatch;
pub(crate) use batches::batch_workspace::{BatchWorkspace, EnteringMoments};
pub(crate) use carry::InheritanceTerm;
pub(crate) use chunk_size::{CACHED_ROWS, chunk_size};
pub use data::Data;
pub use design::{Design, DesignStep, Pattern, StateFrame, Stretch, Transition, TransitionView, same_bits};
pub use dynamics::{Component, Table};
pub(crate) use entries::{Common, Entries, SideBySide};
pub(crate) use error::{check_shape, refuse};
pub use gains::{GainSpan, Gains};
pub(crate) use instances::Instance;
pub(crate) use kernel::{advance, correct_mean, innovation, mirror, predict, update};
pub(crate) use known_steps::KnownSteps;
pub(crate) use lanes::{DataBlock, DataView, DataWorkspace, DesignBatch, Numbers, at};
pub(crate) use measured_cells::MeasuredCells;
pub(crate) use moment_path::MomentPath;
pub use motion::{Evaluated, Filled, MotionPullback, Moves};
pub(crate) use observe::Unwhitened;
pub use part::PhaseReducer;
pub use phased::{FilteredPhases, PhaseReplicates, PhasedBatches, PhasedWork};
pub use prepare::{Preparer, Replay, Skeleton, Workspace};
pub use reducer::single_test_innovations;
pub(crate) use replicates::Replicates;
pub(crate) use scan::{InvariantStep, Scan, with_states};
pub use semidefinite::ldl;
pub(crate) use settling::{SteadyState, SteadyStateMonitor};
pub(crate) use shared_store::SharedStore;
pub(crate) use start::{LawAdjoint, StartAdjoint};
pub(crate) use steps::GatheredCells;
pub use subject::{Coefficient, Fault, ModelAt, Subject, Uses};
#[cfg(test)]
pub(crate) use {
    design::DENSE, design_pass::information_gains, outcome::outcome, root::root_gains, schedule::GainsWork,
};
