//! Figures as files, without a browser: SVG, or PNG at twice the resolution of a screen.
//!
//! What is drawn is what the report draws, from the same rows. A figure is a scene of a few kinds of shapes, which both formats are
//! made from (docs/decisions/0023-figures.md).

mod axis;
mod canvas;
mod ellipses;
mod error;
mod forest;
mod influence;
mod picture;
mod png;
mod records;
mod svg;

use kalfit::FitRecord;
use kalfit::record::AlongRecord;

pub use crate::plot::error::PlotError;
pub use crate::plot::picture::PlotFormat;

use crate::plot::ellipses::EllipsePlot;
use crate::plot::forest::ForestPlot;
use crate::plot::influence::InfluencePlot;
use crate::plot::picture::DrawablePlot;
use crate::plot::records::RecordPlot;

/// Widths of a figure, in points of a screen.
pub const WIDTHS: std::ops::RangeInclusive<u32> = 300..=3000;

/// What a figure shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlotKind {
    /// Means, standard deviations and free parameters with their 95 % intervals.
    Forest,
    /// Each pair of states: the population, and the tests in it.
    Ellipses,
    /// How far the estimates move when a test is left out.
    Influence,
    /// A test along its record: measured and predicted values, innovations.
    Records,
}

/// A figure of a fit, as a whole file. `along` and `test` are for [`PlotKind::Records`] alone: what is known along the records, and the
/// test to show, by default the least probable.
///
/// # Errors
/// [`PlotError`].
pub fn plot(
    record: &FitRecord,
    what: PlotKind,
    (along, test): (Option<&AlongRecord>, Option<&str>),
    (format, width): (PlotFormat, u32),
) -> Result<Vec<u8>, PlotError> {
    let width = width.clamp(*WIDTHS.start(), *WIDTHS.end());
    match what {
        PlotKind::Forest => ForestPlot::of(record)?.put(record, format, width),
        PlotKind::Ellipses => EllipsePlot::of(record)?.put(record, format, width),
        PlotKind::Influence => InfluencePlot::of(record)?.put(record, format, width),
        PlotKind::Records => RecordPlot::of(along, test)?.put(record, format, width),
    }
}
