//! Tests in lanes, one test per lane. Tests of one design share the data pass; tests whose designs have one shape share
//! the design pass too.
//!
//! The numbers of a lane never depend on the other lanes, and a single test is filtered in one lane
//! ([`Isa::alone`](kalfit_lanes::Isa::alone)): the reduction of a test has the same bits whatever else is in the batch.

mod batch_filter;
mod data_block;
mod design_batch;
mod least_squares;
mod numbers;
mod pass;
mod workspace;

pub(crate) use batch_filter::{BatchColumns, BatchFilter};
pub(crate) use data_block::DataBlock;
pub(crate) use design_batch::DesignBatch;
pub(crate) use numbers::{DataView, Numbers, at};
pub(crate) use pass::{InnovationObserver, innovations, pass_alone};
pub(crate) use workspace::DataWorkspace;

#[cfg(test)]
mod tests;
