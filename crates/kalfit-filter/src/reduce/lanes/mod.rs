//! Tests side by side, one in each lane: of one design, whose data passes are one; or of designs of one shape, whose design passes
//! are one too.
//!
//! What a lane holds never depends on the others, and a test by itself goes the same way in a lane of its own
//! ([`Isa::alone`](kalfit_lanes::Isa::alone)): it is reduced to the same bits whatever else is in its batch.

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
