//! Exchange files: what filters made of each phase of a test, so that data need not travel.
//!
//! Both kinds are Parquet files with one row for each test and phase. `book/src/guide/exchange.md` has the schemas and a program that
//! writes an estimates file by hand.
//!
//! * **Reductions** (`kalfit-reductions/1`) hold [`PhaseReduction`](kalfit::reduce::PhaseReduction)s: everything that the
//!   data say of a model at one α, to the last bit. They are of use to that model and that α only, and carry digests of both.
//! * **Estimates** (`kalfit-estimates/1`) hold [`Estimates`](kalfit::reduce::Estimates): what any filter made of a phase, with
//!   the sensitivity and the covariance of its error. They may come from any program; metadata are not needed.
//!
//! [`sort`] tells such files from tables of rows, [`read_reductions`] and [`read_estimates`] read them a few hundred rows at a
//! time, [`TestAssembly`] puts the phases of each test together, and [`ReductionWriter`] and [`EstimatesWriter`] write them.

mod alpha;
mod assembly;
mod constants;
mod content;
mod error;
mod estimates;
mod keys;
mod lists;
mod metadata;
mod reductions;
mod schema;
mod sheet;
mod write;

pub use alpha::{AlphaDifference, ParameterValue, difference, merge};
pub use assembly::{ExchangeEntry, TestAssembly, twice};
pub use content::{ExchangeFile, InputContent, SortedInputs, sort};
pub use error::ExchangeError;
pub use estimates::read_estimates;
pub use metadata::ExchangeMetadata;
pub use reductions::read_reductions;
pub use write::{EstimatesWriter, ReductionWriter};
