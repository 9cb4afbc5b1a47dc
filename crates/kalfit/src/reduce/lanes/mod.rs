//! Tests side by side, one in each lane: of one design, whose data passes are one; or of designs of one shape, whose design passes
//! are one too.
//!
//! What a lane holds never depends on the others, and a short test by itself goes the same way with the other lanes empty: it is
//! reduced to the same bits whatever else is in its batch. A long one by itself takes the data pass with one lane ([`innovations`]). Which way a test
//! goes depends on its design alone ([`is_short`], [`fits`]); only long records of a fit that are known to be alike go side by side
//! ([`LongDesignClasses`](crate::reduce::LongDesignClasses)), which depends on the ensemble.

mod batch_filter;
mod data_block;
mod design_batch;
mod interleaved;
mod numbers;
mod pass;
mod squares;
mod workspace;

pub(crate) use batch_filter::{BatchColumns, BatchFilter};
pub(crate) use data_block::DataBlock;
pub(crate) use design_batch::DesignBatch;
pub(crate) use interleaved::Interleaved;
pub(crate) use numbers::at;
pub(crate) use pass::{InnovationObserver, innovations, solve};
pub(crate) use workspace::DataWorkspace;

use crate::reduce::data::FEW;
use crate::reduce::design::Design;
use crate::reduce::gains::Gains;

/// Whether the design pass is one for lanes: long uniform records have passes of their own.
pub(crate) fn is_short(design: &Design) -> bool {
    design.rows() > 0 && design.runs.iter().all(|run| run.count <= FEW)
}

/// Whether the data pass of a class is one for lanes: square-root arrays have another.
pub(crate) fn fits(design: &Design, gains: &Gains) -> bool {
    gains.turns.is_none() && is_short(design)
}

#[cfg(test)]
mod tests;
