//! Long stretches of equal steps as ensembles of segments.
//!
//! A stretch of equal steps is cut into segments of L rows, each of which starts from a *known* state: P = 0 and Ψ = I.
//! All segments then have one covariance filter, that of a [`Prefix`] of L rows, whatever the records are; the data run
//! many segments in lanes, on all threads ([`strands`]); and a chain joins the segments exactly ([`stretch`] for
//! covariances, [`chain`] for means), as theory §7 joins phases.
//!
//! ```text
//! steps ── Prefix ──> K, T, S, P, Ψ, J of rows 1..L          once for equal steps
//! P, Ψ before the stretch ── SegmentedStretch ──> P, Ψ and gains of each segment, J of ξ          once for each design
//! data ── strands ──> y, e'e/S and the last state of each segment ── chain ──> x̂ of each segment, y of ξ
//! ```

pub(crate) mod chain;
mod lanes;
pub(crate) mod prefix;
mod root;
pub(crate) mod rows;
pub(crate) mod strands;
pub(crate) mod stretch;

use std::sync::Arc;

use nalgebra::{SMatrix, SVector};

use crate::reduce::design::Design;
use prefix::Prefix;

pub(crate) use lanes::{FilteredStretch, TestsInLanes};
pub(crate) use prefix::Prefixes;
pub(crate) use stretch::{SegmentFilter, SegmentedStretch};

/// N × N.
pub(crate) type Square<const N: usize> = SMatrix<f64, N, N>;

/// N numbers.
pub(crate) type Vector<const N: usize> = SVector<f64, N>;

/// ½(A + A').
pub(crate) fn symmetric<const N: usize>(a: &Square<N>) -> Square<N> {
    (a + a.transpose()) * 0.5
}

/// Largest number of states of a segment, for which kernels of fixed size exist.
pub(crate) const MAX_STATES: usize = 6;

/// Number of equal steps up to which a stretch is not cut into segments: its segments would not fill the lanes. (At 300
/// to 1000 rows, fits of tests of one design took 1.3 to 1.6 times as long with segments.)
const MAX_UNCUT_STEPS: usize = 2048;

/// Least and largest number of rows of a segment.
const MIN_ROWS: usize = 256;
const MAX_ROWS: usize = 4096;

/// Ratio of the number of rows to the square of the number of rows of a segment: a row of a prefix costs as much as some
/// rows of data in lanes, and a link as much as some rows of a prefix. From 500 to 4000 rows of a segment, the time of a
/// million rows hardly changes.
const ROWS_PER_LINK: usize = 3;

/// Number of rows of the segments of `rows` equal steps: a power of two, so that records of other lengths share them.
fn segment_rows(rows: usize) -> usize {
    (ROWS_PER_LINK * rows).isqrt().next_power_of_two().clamp(MIN_ROWS, MAX_ROWS)
}

/// Whether a run of a design is cut into segments, if its steps allow that.
fn is_cut(design: &Design, run: usize) -> bool {
    let count = design.runs[run].count;
    count > MAX_UNCUT_STEPS && design.is_long(count) && design.stretch(run).lines.len() == 1
}

/// Whether some runs of a design may be cut into segments.
pub(crate) fn has_segments(design: &Design) -> bool {
    (0..design.runs.len()).any(|run| is_cut(design, run))
}

/// The prefix of each run of a design that is cut into segments; `None` for all other runs.
pub(crate) fn prefixes(design: &Design, known: &Prefixes) -> Vec<Option<Arc<Prefix>>> {
    let runs = 0..design.runs.len();
    // (first run of such steps, prefix)
    let mut found: Vec<(usize, Option<Arc<Prefix>>)> = Vec::new();
    let mut prefix = |run: usize| {
        if !is_cut(design, run) {
            return None;
        }
        if let Some((_, prefix)) = found.iter().find(|(first, _)| design.same_steps(*first, run)) {
            return prefix.clone();
        }
        let alike = |other: &usize| is_cut(design, *other) && design.same_steps(run, *other);
        let rows = segment_rows(runs.clone().filter(alike).map(|other| design.runs[other].count).sum());
        let prefix = known.of(design, &design.stretch(run), rows);
        found.push((run, prefix.clone()));
        prefix
    };
    runs.clone().map(&mut prefix).collect()
}
